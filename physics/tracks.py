"""The stretches of a run laid on one track, so that what has a memory keeps it over a gap.

A log with a gap comes as two stretches, and the sensor lived on in between. Signals are taken for
straight lines over the gap; columns are built along the whole track, and only what was logged is
cut out of them again. No sample of a gap is ever compared with anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.physics.effect import Feature, Signals
from zerodrift.physics.signals import SignalPlan, read_signals
from zerodrift.physics.terms import Term, build_columns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """One run from its first stretch on, gaps bridged."""

    signals: Signals[Array]
    places: tuple[tuple[int, int], ...]
    """(stretch, its first sample on the track), in the order of time."""


def lay_tracks(runs: Sequence[Run], plan: SignalPlan, block: int = 1) -> list[Track]:
    """Return the tracks on which the stretches lie; a run without a gap is one by itself.

    A bridge has as many samples as the gap, but no more than all stretches before it: what lies
    longer ago than that is as good as settled.

    Args:
        runs: stretches of runs.
        plan: their signals.
        block: each stretch begins at a multiple of so many samples.
    """
    index = {(run.group, run.part): i for i, run in enumerate(runs)}
    tracks: list[Track] = []
    laid: set[int] = set()
    for i in sorted(range(len(runs)), key=lambda i: -runs[i].part):
        if i in laid:
            continue
        chain = list_chain(runs[i])
        signals, starts = _join([read_signals(run, plan) for run in chain], chain, block)
        places = []
        for run, start in zip(chain, starts, strict=True):
            # A stretch may stand alone, without those before it.
            at = i if run is runs[i] else index.get((run.group, run.part))
            if at is not None and at not in laid and len(runs[at]) == len(run):
                places.append((at, start))
                laid.add(at)
        tracks.append(Track(signals, tuple(places)))
    return sorted(tracks, key=lambda track: track.places[0])


def list_chain(run: Run) -> list[Run]:
    """Return the stretches of a run up to this one, the first one first."""
    chain = [run]
    while chain[0].before is not None:
        chain.insert(0, chain[0].before)
    return chain


def build_stretches(
    runs: Sequence[Run], plan: SignalPlan, terms: Sequence[Term], order: Sequence[str]
) -> list[list[Feature[Array]]]:
    """Return each stretch's columns [n], the constant first, built along the runs' tracks.

    Raises:
        InputError: a run lacks a channel, or an effect gives what is no column.
    """
    built: list[list[Feature[Array]]] = [[] for _ in runs]
    for track in lay_tracks(runs, plan):
        columns = build_columns(track.signals, terms, order, plan.sample_period_s)
        for i, start in track.places:
            rows = slice(start, start + len(runs[i]))
            built[i] = [replace(column, signal=column.signal[rows]) for column in columns]
    return built


def _join(
    parts: Sequence[Signals[Array]], chain: Sequence[Run], block: int
) -> tuple[Signals[Array], list[int]]:
    """Return the signals laid end to end, gaps bridged, and where each part begins."""
    if len(parts) == 1:
        return parts[0], [0]
    bridges, starts = [], [0]
    for before, after in pairwise(chain):
        end = starts[-1] + len(before)
        gap_s = float(after.time_s[0] - before.time_s[-1])
        missing = min(max(round(gap_s / before.sample_period_s) - 1, 0), end)
        missing += -(end + missing) % block
        bridges.append(missing)
        starts.append(end + missing)

    def lay(values: Sequence[Array]) -> Array:
        pieces = [values[0]]
        for now, missing in zip(values[1:], bridges, strict=True):
            line = np.linspace(pieces[-1][-1], now[0], missing + 2)[1:-1]
            pieces += [line, now]
        return np.concatenate(pieces)

    first = parts[0]
    return (
        replace(
            first,
            temperature_degC=lay([part.temperature_degC for part in parts]),
            elapsed_s=lay([part.elapsed_s for part in parts]),
            clock_s=lay([part.clock_s for part in parts]),
            load={name: lay([part.load[name] for part in parts]) for name in first.load},
            saturated={
                name: lay([part.saturated[name] for part in parts]) for name in first.saturated
            },
            channels={
                name: lay([part.channels[name] for part in parts]) for name in first.channels
            },
        ),
        starts,
    )
