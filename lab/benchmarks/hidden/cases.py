"""The simulated projects: what each hides, its recipe, and its logs as the loader reads them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.dataset.runs import Dataset, Run
from zerodrift_lab.twin.logger import SimulatedRun
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.simulate import Simulation

SIZES = (0.3, 1.0, 3.0, 10.0)
"""RMS of the hidden effect beyond what the told model can absorb, over the noise RMS."""
LISTED = (
    *("zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient", "warm_up"),
    *("thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"),
    *("supply_sensitivity", "humidity", "ambient_light", "inertial_load", "ageing"),
    *("clock_delay", "adc_saturation"),
)
OUTSIDE = ("beat", "jump", "random_walk", "threshold", "load_rate")
CHANNEL_OF = {
    "supply_sensitivity": ("supply",),
    "humidity": ("humidity",),
    "ambient_light": ("ambient_light",),
    "inertial_load": ("acceleration_x", "acceleration_y", "acceleration_z"),
}


@dataclass(frozen=True)
class Case:
    """One simulated project."""

    purpose: str
    """one | pair | complete | outside | no channel."""
    hidden: tuple[str, ...]
    size: float
    runs: int
    seed: int


def list_cases(seed: int, quick: bool) -> list[Case]:
    """Return the cases, every one with a sensor of its own."""
    rng = np.random.default_rng(seed)
    cases: list[Case] = []

    def add(purpose: str, hidden: tuple[str, ...], size: float, runs: int) -> None:
        cases.append(Case(purpose, hidden, size, runs, int(rng.integers(2**31))))

    repeats = 1 if quick else 3
    for effect in LISTED:
        for size in (1.0,) if quick else SIZES:
            for _ in range(repeats):
                add("one", (effect,), size, 8 if quick else int(rng.integers(8, 13)))
        if not quick:
            add("one", (effect,), 2.0, int(rng.integers(4, 8)))
    for _ in range(6 if quick else 40):
        add("complete", (), 0.0, int(rng.integers(4, 13)))
    for effect in OUTSIDE:
        for size in (1.0,) if quick else (1.0, 3.0, 10.0):
            for _ in range(repeats):
                add("outside", (effect,), size, int(rng.integers(8, 13)))
    for effect in CHANNEL_OF:
        for size in (1.0,) if quick else (1.0, 5.0):
            for _ in range(1 if quick else 2):
                add("no channel", (effect,), size, int(rng.integers(8, 13)))
    seen: set[tuple[str, ...]] = set()
    while len(seen) < (4 if quick else 40):
        pair = tuple(sorted(str(name) for name in rng.choice(LISTED[2:], 2, replace=False)))
        if pair not in seen:
            seen.add(pair)
            add("pair", pair, float(rng.uniform(1.0, 4.0)), int(rng.integers(8, 13)))
    # Shuffled, so that the first N of them are a fair sample of all.
    return [cases[int(place)] for place in rng.permutation(len(cases))]


def make_recipe(case: Case) -> Recipe:
    """Return the recipe of a case: mostly chamber runs, some of other kinds."""
    rng = np.random.default_rng(case.seed)
    others = ("heating", "cooling", "cold_start", "load_steps", "walking")
    kinds = ["chamber"] * case.runs
    if case.runs >= 8:
        for place in range(int(rng.integers(0, 3))):
            kinds[-1 - place] = str(rng.choice(others))
    told: tuple[str, ...] = ("zero_tempco", "dark_current")
    if "dark_current" in case.hidden:
        told = ("zero_tempco",)
    if "zero_tempco" in case.hidden:
        told = ("dark_current",)
    channels = Recipe().channels
    if case.purpose == "no channel":
        channels = tuple(c for c in channels if c not in CHANNEL_OF[case.hidden[0]])
    return Recipe(
        seed=case.seed,
        train=tuple(kinds),
        told=tuple(EffectChoice(name) for name in told),
        hidden=tuple(EffectChoice(name) for name in case.hidden),
        size=case.size or None,
        channels=channels,
    )


def read_simulation(simulation: Simulation) -> Dataset:
    """Return the runs as the loader would have read them from the simulated logs."""

    def read(run: SimulatedRun) -> Run:
        return Run(
            name=run.name,
            group=run.name,
            part=0,
            source=Path(f"{run.name}.csv"),
            sample_period_s=simulation.recipe.sample_period_s,
            time_s=run.time_s,
            temperature_degC=run.temperature_degC,
            measured=run.measured,
            reference=run.reference,
            inputs=dict(run.channels),
        )

    return Dataset(
        train=tuple(read(run) for run in simulation.select("train")),
        test=(),
        dwell=tuple(read(run) for run in simulation.select("dwell")),
        outputs=tuple(OUTPUTS),
        units=tuple(UNITS),
        full_scale=tuple(float(value) for value in FULL_SCALE),
    )
