"""The next experiment: the one of a few simple ones that would tell two explanations apart.

Both models are simulated through each experiment on the menu, within the temperatures and loads
that the logs have seen; the experiment is best in which their predictions differ most
(discrimination design, Atkinson and Fedorov, Biometrika 62 (1975)).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.effect import Signals
from zerodrift.physics.projection import Solution
from zerodrift.physics.signals import SignalPlan
from zerodrift.physics.terms import Term, build_features

STEPS = 7200
"""Simulated seconds of each experiment."""
WORTHWHILE = 1.0
"""Predictions must differ by this many times the noise for an experiment to be worth doing."""


NEARLY = 0.95
"""An experiment that tells this share of what the best one tells will do."""


@dataclass(frozen=True)
class Experiment:
    """One item of the menu: what to do, and what the signals would then be."""

    name: str
    instruction: str
    temperature_degC: Array
    load_share: Array
    """[n] of each output's largest load in the logs."""
    channel_share: Mapping[str, Array]
    """Channel -> [n] share of its range in the logs, 0..1."""

    @property
    def effort(self) -> int:
        """How many things have to be moved."""
        moves_temperature = bool(np.ptp(self.temperature_degC) > 0.0)
        return int(moves_temperature) + int(self.load_share.any()) + len(self.channel_share)


def list_experiments(lowest_degC: float, highest_degC: float) -> list[Experiment]:
    """Return the menu, within a range of temperatures."""
    t = np.arange(STEPS, dtype=np.float64)
    middle = 0.5 * (lowest_degC + highest_degC)
    rest = np.full(STEPS, middle)
    none = np.zeros(STEPS)
    half = np.full(STEPS, 0.5)
    reach = highest_degC - lowest_degC

    def ramps(*knots: tuple[float, float]) -> Array:
        times, shares = zip(*knots, strict=True)
        return np.asarray(lowest_degC + reach * np.interp(t / STEPS, times, shares))

    two_rates = ramps((0.0, 0.2), (0.1, 0.2), (0.15, 0.8), (0.45, 0.8), (0.8, 0.2), (1.0, 0.2))
    loop = ramps((0.0, 0.5), (0.05, 0.5), (0.3, 1.0), (0.7, 0.0), (0.95, 0.5), (1.0, 0.5))
    hold = ((t > 0.1 * STEPS) & (t < 0.5 * STEPS)).astype(np.float64)
    stairs = np.minimum(np.floor(t / STEPS * 20.0), 20.0 - np.floor(t / STEPS * 20.0)) / 10.0
    switched = (np.floor(t / STEPS * 8.0) % 2.0).astype(np.float64)
    return [
        Experiment(
            "two ramp rates",
            "ramp the temperature once fast and once slowly, with dwells between, unloaded",
            two_rates,
            none,
            {},
        ),
        Experiment(
            "heating and cooling loop",
            "run one full loop of temperature, warm, cold and back, slowly and unloaded",
            loop,
            none,
            {},
        ),
        Experiment(
            "step and hold of the load",
            "at constant temperature put a load on, hold it for an hour, take it off, wait",
            rest,
            hold,
            {},
        ),
        Experiment(
            "stairs of the load",
            "at constant temperature raise the load in ten steps and lower it by the same steps",
            rest,
            stairs,
            {},
        ),
        Experiment(
            "load at several temperatures",
            "hang the same load on and off while the temperature ramps",
            loop,
            switched,
            {},
        ),
        Experiment(
            "cold power-on",
            "switch the power on at constant temperature after hours off, and log two hours "
            "without taring",
            rest,
            none,
            {},
        ),
        *(
            Experiment(name, instruction, rest, none, {channel: share})
            for name, instruction, channel, share in (
                (
                    "light off and on",
                    "at rest switch the light off and on, several times",
                    "ambient_light",
                    switched,
                ),
                (
                    "supply steps",
                    "at rest step the supply up and down, several times",
                    "supply",
                    switched,
                ),
                (
                    "humidity step",
                    "at constant temperature step the humidity once and wait",
                    "humidity",
                    hold,
                ),
                (
                    "six attitudes",
                    "turn the unloaded sensor through six attitudes",
                    "acceleration_z",
                    half * 2.0 * switched,
                ),
            )
        ),
    ]


def choose_experiment(
    plan: SignalPlan,
    runs: Sequence[Run],
    order: Sequence[str],
    one: tuple[Sequence[Term], Solution],
    other: tuple[Sequence[Term], Solution],
    noise: Array,
) -> tuple[Experiment, float] | None:
    """Return the experiment in which two fitted models differ most, and by how many noise RMS.

    Args:
        plan: the project's signals.
        runs: the logs, for the ranges of temperature, loads and channels.
        order: the catalogue's order.
        one: terms and coefficients of a model.
        other: the same of another.
        noise: [K] RMS.

    Returns:
        None where no experiment on the menu would separate them.
    """
    lowest = min(float(run.temperature_degC.min()) for run in runs)
    highest = max(float(run.temperature_degC.max()) for run in runs)
    found: list[tuple[Experiment, float]] = []
    for experiment in list_experiments(lowest, highest):
        if any(channel not in plan.channels for channel in experiment.channel_share):
            continue
        if experiment.load_share.any() and not plan.loaded:
            continue
        signals = _simulate(experiment, plan, runs)
        difference = _predict(signals, plan, order, *one) - _predict(signals, plan, order, *other)
        difference -= difference.mean(axis=0)
        apart = float(np.sqrt(np.mean((difference / noise) ** 2)))
        found.append((experiment, apart))
    most = max((apart for _, apart in found), default=0.0)
    if most < WORTHWHILE:
        return None
    # Of experiments that tell about as much, the one that moves least is the easiest.
    return min(
        (entry for entry in found if entry[1] >= NEARLY * most),
        key=lambda entry: (entry[0].effort, -entry[1]),
    )


def _simulate(experiment: Experiment, plan: SignalPlan, runs: Sequence[Run]) -> Signals[Array]:
    """Return the signals of an experiment at one sample per second."""
    elapsed_s = np.arange(STEPS, dtype=np.float64)
    load = {}
    for name in plan.loaded:
        k = plan.outputs.index(name)
        largest = max((run.reference[:, k] for run in runs), key=lambda x: float(np.abs(x).max()))
        load[name] = experiment.load_share * float(largest[np.abs(largest).argmax()])
    channels = {}
    for name in plan.channels:
        low = min(float(run.inputs[name].min()) for run in runs)
        high = max(float(run.inputs[name].max()) for run in runs)
        middle = np.full(STEPS, 0.5)
        channels[name] = low + (high - low) * experiment.channel_share.get(name, middle)
    return Signals(
        temperature_degC=experiment.temperature_degC,
        elapsed_s=elapsed_s,
        clock_s=elapsed_s,
        load=load,
        saturated={name: np.zeros(STEPS) for name in plan.saturated},
        channels=channels,
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )


def _predict(
    signals: Signals[Array],
    plan: SignalPlan,
    order: Sequence[str],
    terms: Sequence[Term],
    solution: Solution,
) -> Array:
    """Return the drift [n, K] that a model predicts for simulated signals."""
    plan = replace(plan, sample_period_s=1.0)
    ops = NumpyOperations(plan.sample_period_s, signals.temperature_degC.shape)
    features = build_features(ops, signals, terms, order)[1:]
    total = np.zeros((STEPS, len(plan.outputs)))
    for feature, row in zip(features, solution.coefficients.T, strict=True):
        total += feature.signal[:, None] * row
    return total
