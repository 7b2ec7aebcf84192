"""The stretches of a run placed on one track, so that effects keep their memory over a gap.

A log with a gap has two stretches, but the sensor was in operation between them. Signals are taken
as straight lines over the gap; columns are built along the whole track, and then cut to the samples
that were logged. No sample of a gap is compared with anything.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.bridges import find_chains, lay
from zerodrift.dataset.runs import Run
from zerodrift.physics.effect import Arrivals, Feature, Signals
from zerodrift.physics.signals import SignalPlan, read_signals
from zerodrift.physics.terms import Term, build_columns

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
