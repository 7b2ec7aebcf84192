"""A simulated sensor with every input there is, and compensators of known effects for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.projects import render_toml

from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.model import FittedTerm, PhysicalModel
from zerodrift.physics.signals import SignalPlan, plan_signals, read_signals
from zerodrift.physics.terms import Term, build_columns, start_term
from zerodrift.train.compensator import Compensator, calibrate

Array = NDArray[np.float64]

OUTPUTS, UNITS, FULL_SCALE = ("Fz", "Mx"), ("N", "Nm"), (2000.0, 14.0)
CLOCK_START_S = 1_760_000_000.0
DRIFT_SHARE = 0.02
"""Each feature makes a drift of this share of full scale at its largest."""
SLACK_SHARE = 0.1
"""And the slack of a load hysteresis, which is never large, of this share of that: more would be a
drift that takes most of each small change of the load."""
LOGS = '[logs]\ntrain = ["*.csv"]\n'


def make_config(period_s: float = 1.0) -> Config:
    """Return the project's configuration; its files do not exist."""
    return parse_config(render_toml(LOGS, "bench", period_s), Path("/nowhere/zerodrift.toml"))


def draw_run(name: str, seed: int, length: int = 3000, period_s: float = 1.0) -> Run:
    """Return a simulated run without drift: slow temperature, stepped load, all other inputs."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(length) * period_s

    def wander(low: float, high: float, knots: int) -> Array:
        """Return smooth noise within low .. high, both nearly reached."""
        places = np.linspace(0, length - 1, knots)
        ends = rng.permutation(np.linspace(low, high, knots))
        smooth = np.interp(np.arange(length), places, ends)
        width = max(length // (4 * knots), 1)
        padded = np.pad(smooth, width, mode="edge")
        return np.convolve(padded, np.ones(width) / width, mode="same")[width:-width]

    def step(largest: float) -> Array:
        edges = np.sort(rng.integers(0, length, 12))
        levels = np.append(0.0, rng.uniform(-largest, largest, 12))
        return levels[np.searchsorted(edges, np.arange(length), side="right")]

    temperature = np.round(wander(12.0, 48.0, 9) * 128.0) / 128.0
    reference = np.stack([step(1200.0), step(9.0)], axis=1)
    return Run(
        name=name,
        group=name,
        part=0,
        source=Path(f"{name}.csv"),
        sample_period_s=period_s,
        time_s=time_s,
        temperature_degC=temperature,
        measured=reference.copy(),
        reference=reference,
        inputs={
            "supply": 5.0 + 0.2 * step(1.0),
            "humidity": wander(30.0, 80.0, 5),
            "ambient_light": np.maximum(step(400.0), 0.0),
            "pressure": 1013.0 + step(8.0),
            "turn_on": np.full(length, 0.5 + rng.normal()),
            "acceleration_x": step(9.81),
            "acceleration_z": 9.81 + step(2.0),
            "body_temperature": wander(14.0, 46.0, 9),
            "clock": CLOCK_START_S + 3.0 * 86400.0 * seed + np.floor(time_s),
        },
    )


def draw_runs(count: int = 2, length: int = 3000, period_s: float = 1.0) -> tuple[Run, ...]:
    """Return several runs without drift."""
    return tuple(draw_run(f"run_{i}", i, length, period_s) for i in range(count))


def make_physics(
    effects: list[EffectConfig], runs: tuple[Run, ...], catalogue: Catalogue | None = None
) -> PhysicalModel:
    """Return a physical model of these effects at typical values, with drawn coefficients."""
    catalogue = catalogue or load_catalogue()
    plan = plan_signals(runs, OUTPUTS, FULL_SCALE)
    terms = [start_term(catalogue, effect) for effect in effects]
    order = tuple(catalogue)
    features = _list_features(runs, plan, terms, order)
    names, units, largest, wanted = features
    rng = np.random.default_rng(7)
    signs = rng.uniform(0.4, 1.0, (len(names), len(OUTPUTS)))
    signs *= rng.choice([-1.0, 1.0], signs.shape)
    coefficients = signs * wanted * DRIFT_SHARE * np.array(FULL_SCALE) / largest[:, None]
    slack = np.array(["slack" in name and "load" in name for name in names])
    coefficients[slack] *= SLACK_SHARE
    return PhysicalModel(
        plan=plan,
        units=UNITS,
        terms=tuple(FittedTerm(term) for term in terms),
        feature_names=names,
        feature_units=units,
        coefficients=coefficients,
        std_errors=np.zeros_like(coefficients),
        offsets={},
        tared=False,
        order=order,
    )


def _list_features(
    runs: tuple[Run, ...], plan: SignalPlan, terms: list[Term], order: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...], Array, Array]:
    """Return names, units, the largest values [J] over the runs and who sees them [J, K]."""
    largest = np.zeros(0)
    for run in runs:
        columns = build_columns(read_signals(run, plan), terms, order, plan.sample_period_s)
        reach = np.array([np.abs(column.signal).max() for column in columns])
        largest = reach if largest.size == 0 else np.maximum(largest, reach)
    wanted = np.array([[c.output in (None, name) for name in OUTPUTS] for c in columns])
    names = tuple(c.name for c in columns)
    return names, tuple(c.unit for c in columns), np.maximum(largest, 1e-12), wanted.astype(float)


def make_compensator(
    physics: PhysicalModel, runs: tuple[Run, ...]
) -> tuple[Compensator, tuple[Run, ...]]:
    """Return the compensator of a physical model alone, and the runs with its drift in them."""
    drifting = tuple(_add_drift(run, physics.predict(run)) for run in runs)
    predictions = [physics.predict(run) for run in drifting]
    return (
        Compensator(
            physics=physics,
            outputs=OUTPUTS,
            units=UNITS,
            sample_period_s=runs[0].sample_period_s,
            calibration=calibrate(drifting, [], predictions),
        ),
        drifting,
    )


def _add_drift(run: Run, drift: Array) -> Run:
    return replace(run, measured=run.reference + drift)


def make_dataset(runs: tuple[Run, ...]) -> Dataset:
    """Return the runs as training logs."""
    return Dataset(runs, (), (), OUTPUTS, UNITS, FULL_SCALE)
