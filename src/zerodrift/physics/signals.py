"""The signals that effects see: from a run as arrays, or for the exporter as named nodes."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.outliers import take_medians
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.graph import Node
from zerodrift.physics.effect import Effect, Signals
from zerodrift.physics.rails import find_rails

LATEST_RELATIVE_TIME_S = 1e7
"""A log whose clock starts below this may count seconds since power-on; above, calendar time."""


EARLIEST_S = 1.0
"""A log that begins later than this, and than one sample, may have missed power-on."""
FEWEST_IN_ORDER = 3
"""As many runs that follow one another in time share a clock that runs on."""


@dataclass(frozen=True)
class SignalPlan:
    """The signals of a project: fixed when its model is fitted, and unchanged from then on."""

    outputs: tuple[str, ...]
    full_scale: tuple[float, ...]
    sample_period_s: float
    loaded: tuple[str, ...]
    """Outputs whose reference varies, so that load-driven effects can be fitted."""
    saturated: tuple[str, ...]
    """Outputs whose converter stands at a rail in some run."""
    channels: tuple[str, ...]
    """Inputs that every run has."""
    reference_temperature_degC: float
    """T0."""
    clock_origin_s: float
    """Start of the `clock` channel; 0 without one."""
    starts_at_first_row: bool = False
    """Whether power came on at each run's first row; else where the log's time is zero."""


def plan_signals(
    runs: Sequence[Run], outputs: Sequence[str], full_scale: Sequence[float]
) -> SignalPlan:
    """Return the plan for these runs: T0 is their mean temperature in whole degrees."""
    samples = sum(len(run) for run in runs)
    mean_degC = sum(float(run.temperature_degC.sum()) for run in runs) / samples
    loaded = [
        name
        for k, name in enumerate(outputs)
        if len({bound for run in runs for bound in _range_of(run.reference[:, k])}) > 1
    ]
    saturated = [
        name
        for name in outputs
        if any(_find_rails(run, list(outputs).index(name)).any() for run in runs)
    ]
    channels = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)]
    clocks = [float(run.inputs["clock"][0]) for run in runs if "clock" in run.inputs]
    return SignalPlan(
        outputs=tuple(outputs),
        full_scale=tuple(full_scale),
        sample_period_s=runs[0].sample_period_s,
        loaded=tuple(loaded),
        saturated=tuple(saturated),
        channels=tuple(channels),
        reference_temperature_degC=float(round(mean_degC)),
        clock_origin_s=min(clocks) if len(clocks) == len(runs) else 0.0,
        starts_at_first_row=_start_at_first_row(runs),
    )


def _start_at_first_row(runs: Sequence[Run]) -> bool:
    """Return whether the log's time does not count from power-on; the first row then is power-on.

    That is so where no run begins near zero, and where one clock continues from run to run.
    """
    starts = {run.group: _start_of(run) for run in runs}
    ends = {run.group: float(run.time_s[-1]) for run in runs}
    if min(starts.values()) > max(runs[0].sample_period_s, EARLIEST_S):
        return True
    in_order = sorted(starts, key=lambda group: starts[group])
    goes_on = all(starts[b] >= ends[a] for a, b in itertools.pairwise(in_order))
    return goes_on and len(starts) >= FEWEST_IN_ORDER


def _start_of(run: Run) -> float:
    return float(run.time_s[0]) if run.start_s is None else run.start_s


def _find_rails(run: Run, k: int) -> Array:
    measured = run.measured[:, k]
    if run.outliers is not None:
        # A spike beyond the rail would be the extreme; its neighbours show what was measured.
        light = run.outliers.weights[:, k] < 1.0
        if light.any():
            measured = np.where(light, take_medians(measured), measured)
    return find_rails(measured, run.reference[:, k])


def _range_of(x: Array) -> tuple[float, float]:
    return float(x.min()), float(x.max())


def read_signals(run: Run, plan: SignalPlan) -> Signals[Array]:
    """Return the signals of one run.

    Raises:
        InputError: the run lacks a channel that the plan has.
    """
    for name in plan.channels:
        if name not in run.inputs:
            raise InputError(
                f"{run.source}: run '{run.name}' has no input '{name}', which the model was fitted "
                "with; add the column to the log or refit without it."
            )
    elapsed_s = run.time_s
    if plan.starts_at_first_row or not 0.0 <= elapsed_s[0] < LATEST_RELATIVE_TIME_S:
        elapsed_s = elapsed_s - _start_of(run)
    clock_s = run.inputs["clock"] - plan.clock_origin_s if "clock" in plan.channels else elapsed_s
    return Signals(
        temperature_degC=run.temperature_degC,
        elapsed_s=elapsed_s,
        clock_s=clock_s,
        load={name: run.reference[:, plan.outputs.index(name)] for name in plan.loaded},
        saturated={name: _find_rails(run, plan.outputs.index(name)) for name in plan.saturated},
        channels={name: run.inputs[name] for name in plan.channels},
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )


def name_signals(ops: GraphOperations, plan: SignalPlan) -> Signals[Node]:
    """Return the signals as the input nodes of a graph."""
    return Signals(
        temperature_degC=ops.input("temperature_degC"),
        elapsed_s=ops.input("elapsed_s"),
        clock_s=ops.input("clock_s"),
        load={name: ops.input(f"load:{name}") for name in plan.loaded},
        saturated={name: ops.input(f"saturated:{name}") for name in plan.saturated},
        channels={name: ops.input(name) for name in plan.channels},
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )


def graph_inputs(signals: Signals[Array]) -> Mapping[str, Array]:
    """Return the arrays under the names that `name_signals` gives to input nodes."""
    return {
        "temperature_degC": signals.temperature_degC,
        "elapsed_s": signals.elapsed_s,
        "clock_s": signals.clock_s,
        **{f"load:{name}": load for name, load in signals.load.items()},
        **{f"saturated:{name}": flag for name, flag in signals.saturated.items()},
        **signals.channels,
    }


def explain_missing(effect: Effect, plan: SignalPlan, signal: str = "") -> str:
    """Return why these logs cannot feed the effect, or an empty string when they can.

    Args:
        effect: the effect.
        plan: the project's signals.
        signal: the thermometer asked for by `signal = "..."`; empty for the chip's.
    """
    if signal and signal not in plan.channels:
        return f"no input '{signal}'{nearest(signal, plan.channels)}"
    for need in effect.needs:
        if need in ("temperature", "elapsed", "clock"):
            continue
        if need == "load":
            if not plan.loaded:
                return "no output has a reference that varies, so the load is unknown"
        elif need == "saturated":
            if not plan.saturated:
                return "no output ever stands still at an extreme"
        elif not any(name in plan.channels for name in need.split("|")):
            return f"no input '{need.split('|')[0]}'"
    return ""
