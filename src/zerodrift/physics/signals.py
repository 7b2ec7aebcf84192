"""The signals that effects see: from a run as arrays, or for the exporter as named nodes."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.outliers import take_medians
from zerodrift.dataset.runs import Run, find_chains, lay
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.operation import Node
from zerodrift.physics.effect import Arrivals, Effect, Feature, Signals
from zerodrift.physics.rails import find_rails
from zerodrift.physics.terms import Term, build_columns

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


# The stretches of a run placed on one track, so that effects keep their memory over a gap.
#
# A log with a gap has two stretches, but the sensor was in operation between them. Signals are
# taken as straight lines over the gap; columns are built along the whole track, and then cut to the
# samples that were logged. No sample of a gap is compared with anything.

FAR_K = 1e5
"""From so far away a run's temperature comes: beyond every play's width."""


@dataclass(frozen=True)
class Track:
    """One run from its first stretch on, gaps bridged."""

    signals: Signals[Array]
    places: tuple[tuple[int, int], ...]
    """(stretch, its first sample on the track), in the order of time."""


def lay_tracks(runs: Sequence[Run], plan: SignalPlan, block: int = 1) -> list[Track]:
    """Return the tracks on which the stretches lie; a run without a gap is one by itself.

    Args:
        runs: stretches of runs.
        plan: their signals.
        block: each stretch begins at a multiple of so many samples.
    """
    return [
        Track(
            _join([read_signals(run, plan) for run in chain.stretches], chain.bridges),
            chain.places,
        )
        for chain in find_chains(runs, block)
    ]


def tell_arrival(arrivals: Arrivals, first: Run) -> float:
    """Return the height, in K, of the spike at the first sample of a track.

    Args:
        arrivals: from where runs came to their first temperature.
        first: the track's first stretch; a later part of a run does not begin there.
    """
    return FAR_K * dict(arrivals).get(first.group, 0) if first.part == 0 else 0.0


def build_stretches(
    runs: Sequence[Run], plan: SignalPlan, terms: Sequence[Term], order: Sequence[str]
) -> list[list[Feature[Array]]]:
    """Return each stretch's columns [n], the constant first, built along the runs' tracks.

    Raises:
        InputError: a run lacks a channel, or an effect gives what is no column.
    """
    built: list[list[Feature[Array]]] = [[] for _ in runs]
    for track in lay_tracks(runs, plan):
        signals = _let_arrive(track.signals, runs[track.places[0][0]])
        columns = build_columns(signals, terms, order, plan.sample_period_s)
        for i, start in track.places:
            rows = slice(start, start + len(runs[i]))
            built[i] = [replace(column, signal=column.signal[rows]) for column in columns]
    return built


def _let_arrive(signals: Signals[Array], first: Run) -> Signals[Array]:
    """Return the signals of a track that can tell from where its temperature came."""

    def arrive(arrivals: Arrivals) -> Array:
        spike = np.zeros_like(signals.temperature_degC)
        spike[0] = tell_arrival(arrivals, first)
        return spike

    return replace(signals, arrivals=arrive)


def _join(parts: Sequence[Signals[Array]], bridges: Sequence[int]) -> Signals[Array]:
    """Return the signals laid end to end, gaps bridged."""
    if len(parts) == 1:
        return parts[0]

    def lay_all(of_parts: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        return {name: lay([part[name] for part in of_parts], bridges) for name in of_parts[0]}

    return replace(
        parts[0],
        temperature_degC=lay([part.temperature_degC for part in parts], bridges),
        elapsed_s=lay([part.elapsed_s for part in parts], bridges),
        clock_s=lay([part.clock_s for part in parts], bridges),
        load=lay_all([part.load for part in parts]),
        saturated=lay_all([part.saturated for part in parts]),
        channels=lay_all([part.channels for part in parts]),
    )
