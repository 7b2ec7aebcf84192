"""Simulated sensors to which a plan is done, and how large the effect is that each hides.

The sensors are those of `lab/zerodrift_lab/twin`, which shares no code with what plans.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.plan import Planned, Question, plan_experiment
from zerodrift.discovery.programme import SetProgramme
from zerodrift.discovery.summary import list_protocols
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin.logger import SimulatedRun
from zerodrift_lab.twin.played import play_protocols
from zerodrift_lab.twin.project import render_config, to_dataset, to_run
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS
from zerodrift_lab.twin.simulate import Simulation, simulate
from zerodrift_lab.twin.six_axis.protocol import parse_protocol

AS_LARGE = 0.03
"""How near, as a logarithm, a sensor's effect comes to the size that the plan was told, ..."""
SCALINGS = 6
"""... within so many corrections."""
PERIOD_S = 2.0
REST_S = 180.0
"""After each log, in either programme."""
CAMPAIGN_H = 8
"""Hours of the twin's own chamber programme over which a sensor's effect has its size, whatever is
recorded of it."""
LOOKED_AT = ("Fz", "Mx")
"""Outputs of the six that are logged, which saves time."""
TARGET = 0.0001
"""The twin's noise is about 0.01 % of full scale."""
LIMITS = """
[experiment]
temperature_degC = [-20, 60]
heating_K_per_min = 6
cooling_K_per_min = 6
start_degC = 23
log_min = 10
rest_min = 3
noise_pct = 0.012

[experiment.loads]
Fz = { range = [-400, 400], change_s = 3, hold_s = 100 }
Mx = { range = [-2.8, 2.8], change_s = 3, hold_s = 100 }

[experiment.inputs]
supply = { range = [4.75, 5.25], change_s = 2, hold_s = 150 }
ambient_light = { range = [0, 900], change_s = 2, hold_s = 100 }
humidity = { range = [15, 85], change_s = 90, hold_s = 400 }
"""


def make_sensor(
    pair: Sequence[str], truth: str, size: float, seed: int, hours: int, log_s: float = 3600.0
) -> Simulation:
    """Return a sensor that hides one effect, with so many logs of the default programme.

    Over these, what the model leaves of the effect has the size, RMS over that of the noise.
    """
    told = [name for name in ("zero_tempco", "dark_current") if name not in pair]
    if "zero_tempco" in pair:
        told = ["zero_tempco"]
    hidden = EffectChoice(truth)
    recipe = Recipe(
        seed=seed,
        train=("chamber",) * hours,
        duration_s=log_s,
        test=(),
        told=tuple(EffectChoice(name) for name in told if name != truth),
        hidden=(hidden,),
        size=size,
        sample_period_s=PERIOD_S,
    )
    return simulate(recipe)


@cache
def make_whole(pair: tuple[str, ...], truth: str, size: float, seed: int) -> Simulation:
    """Return a sensor that hides one effect, with the whole of the default programme.

    Its numbers are those of this campaign, however much of it is recorded, and whatever else is
    done to the sensor.
    """
    return make_sensor(pair, truth, size, seed, CAMPAIGN_H, 3600.0 - REST_S)


def record_default(simulation: Simulation, hours: float) -> Dataset:
    """Return the first logs of the default programme, rests counted, the last one cut short."""
    dataset = to_dataset(simulation)
    kept = []
    for number, run in enumerate(dataset.train):
        left_s = min(3600.0 * (hours - number), 3600.0) - REST_S
        if left_s > 0.0:
            kept.append(run.take(slice(0, round(left_s / PERIOD_S))))
    return replace(dataset, train=tuple(kept))


def list_effects(pair: Sequence[str]) -> list[EffectConfig]:
    """Return the model: straight zero shift, and dark current unless that is asked for."""
    names = ["zero_tempco"] if "dark_current" in pair else ["zero_tempco", "dark_current"]
    return [EffectConfig(name) for name in names]


@cache
def make_config(pair: tuple[str, ...]) -> Config:
    """Return the project of a pair before its first log."""
    base = Recipe(seed=0, train=("chamber",), test=(), sample_period_s=PERIOD_S)
    text = render_config(simulate(replace(base, duration_s=300.0)))
    head = text.split("\n[[effect]]\n")[0] + "\n"
    for name in set(OUTPUTS) - set(LOOKED_AT):
        head = re.sub(rf"\[outputs\.{name}\]\n(.+\n)+", "", head)
    effects = "".join(f'[[effect]]\nkind = "{e.kind}"\n' for e in list_effects(pair))
    return parse_config(head + effects + LIMITS, Path("/bench/zerodrift.toml"))


@cache
def make_plan(pair: tuple[str, ...], hours: float, size: float, budget_s: float) -> Planned:
    """Return a plan before the first log."""
    question = Question(hours, pair, TARGET * size, budget_s)
    return plan_experiment(make_config(pair), None, load_catalogue(), question)


def play(
    simulation: Simulation, programme: SetProgramme, limits: Limits
) -> tuple[SimulatedRun, ...]:
    """Return the logs of a sensor to which a programme is done."""
    units = dict(zip(OUTPUTS, UNITS, strict=True))
    texts = list_protocols(programme, limits, units)
    protocols = {
        f"planned_{end.removesuffix('.txt')}": parse_protocol(text, f"plan_{end}", "planned")
        for end, text in texts.items()
    }
    return play_protocols(simulation, protocols)


def measure(simulation: Simulation, planned: Planned) -> float:
    """Return how large the hidden effect is where all moves, over what the plan was asked for.

    RMS over the outputs that are looked at of what the model leaves, its dark current doubling
    every 10 K, and an offset for each log, in shares of full scale; no noise.
    """
    kept = [OUTPUTS.index(name) for name in LOOKED_AT]
    full_scale = np.array(to_dataset(simulation).full_scale)[kept]
    left, base = [], []
    has_current = "dark_current" in {effect.kind for effect in list_effects(planned.kinds)}
    for run in play(simulation, planned.sized, planned.limits):
        t = run.temperature_degC - 25.0
        for rows, x in (
            (left, run.hidden_drift[:, kept] / full_scale),
            (base, np.stack([t, 2.0 ** (t / 10.0)][: 1 + has_current], axis=1)),
        ):
            rows.append(x - x.mean(axis=0))
    y, x = np.concatenate(left), np.concatenate(base)
    rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)) / (planned.question.target or 1.0))


def make_as_large(
    pair: tuple[str, ...], truth: str, size: float, seed: int, planned: Planned
) -> Simulation:
    """Return a sensor whose hidden effect is as large as the plan was asked to expect.

    Raises:
        InputError: no sensor of this seed can be that.
    """
    asked = size
    for _ in range(SCALINGS):
        simulation = make_sensor(pair, truth, asked, seed, 2)
        found = measure(simulation, planned)
        if abs(np.log(found)) < AS_LARGE:
            return simulation
        asked /= found
    raise InputError(f"seed {seed}: {truth} cannot be made {size:g} in that programme")


def record_plan(simulation: Simulation, planned: Planned) -> Dataset:
    """Return the logs of a sensor to which a plan is done, with the dwell."""
    runs = play(simulation, planned.programme, planned.limits)
    dataset = to_dataset(simulation)
    return replace(dataset, train=tuple(to_run(run, simulation.recipe) for run in runs))


def keep_outputs(dataset: Dataset) -> Dataset:
    """Return the logs of those outputs alone that the bench looks at."""
    kept = [OUTPUTS.index(name) for name in LOOKED_AT]

    def take(runs: Sequence[Run]) -> tuple[Run, ...]:
        return tuple(
            replace(run, measured=run.measured[:, kept], reference=run.reference[:, kept])
            for run in runs
        )

    return replace(
        dataset,
        train=take(dataset.train),
        dwell=take(dataset.dwell),
        outputs=LOOKED_AT,
        units=tuple(dataset.units[k] for k in kept),
        full_scale=tuple(dataset.full_scale[k] for k in kept),
    )
