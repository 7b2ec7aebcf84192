"""A run with gaps as one stretch: straight lines fill the gaps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run


@dataclass(frozen=True)
class Chain:
    """The stretches of a run, from its first one on, and the samples that fill its gaps."""

    stretches: tuple[Run, ...]
    bridges: tuple[int, ...]
    """Samples that fill each gap."""
    places: tuple[tuple[int, int], ...]
    """(stretch of those asked for, its first sample in the whole), in the order of time."""


def list_chain(run: Run) -> list[Run]:
    """Return the stretches of a run up to this one, the first one first."""
    chain = [run]
    while chain[0].before is not None:
        chain.insert(0, chain[0].before)
    return chain


def plan_bridges(chain: Sequence[Run], block: int = 1) -> tuple[list[int], list[int]]:
    """Return the samples of each bridge, and the first sample of each stretch once they are in
    place.

    Args:
        chain: a run's stretches.
        block: each stretch begins at a multiple of so many samples.
    """
    return plan_spans([run.time_s for run in chain], chain[0].sample_period_s, block)


def plan_spans(
    times_s: Sequence[Array], sample_period_s: float, block: int = 1
) -> tuple[list[int], list[int]]:
    """Return the samples of each bridge, and the first sample of each stretch once they are in
    place.

    A bridge has as many samples as the gap, but no more than all stretches before it: by then the
    model's state hardly depends on the length of the gap.

    Args:
        times_s: times [n] in s of each stretch of a run.
        sample_period_s: their period in s.
        block: each stretch begins at a multiple of so many samples.
    """
    bridges, starts = [], [0]
    for before_s, after_s in pairwise(times_s):
        end = starts[-1] + before_s.size
        gap_s = float(after_s[0] - before_s[-1])
        missing = min(max(round(gap_s / sample_period_s) - 1, 0), end)
        missing += -(end + missing) % block
        bridges.append(missing)
        starts.append(end + missing)
    return bridges, starts


def lay(values: Sequence[Array], bridges: Sequence[int]) -> Array:
    """Return the stretches' values [n] or [n, K] end to end, with straight lines in the gaps."""
    pieces = [values[0]]
    for now, missing in zip(values[1:], bridges, strict=True):
        line = np.linspace(pieces[-1][-1], now[0], missing + 2)[1:-1]
        pieces += [line, now]
    return np.concatenate(pieces)


def predict_along(predict: Callable[[Run], Array], run: Run) -> Array:
    """Return the prediction [n, K] for a stretch, started at the first stretch of its run."""
    if run.before is None:
        return predict(run)
    chain = list_chain(run)
    bridges, starts = plan_bridges(chain)
    return predict(_lay_run(chain, bridges))[starts[-1] :]


def join_stretches(runs: Sequence[Run]) -> tuple[list[Run], list[NDArray[np.bool_]]]:
    """Return runs in one piece each, and which samples [n] of each are those of `runs`.

    Args:
        runs: whole runs or stretches of them. Earlier stretches that are not among them are joined
            too, but not marked.
    """
    joined, logged = [], []
    for chain in find_chains(runs):
        whole = _lay_run(chain.stretches, chain.bridges)
        marks = np.zeros(len(whole), dtype=bool)
        for i, start in chain.places:
            marks[start : start + len(runs[i])] = True
        joined.append(whole)
        logged.append(marks)
    return joined, logged


def predict_all(predict: Callable[[Run], Array], runs: Sequence[Run]) -> list[Array]:
    """Return `predict_along` [n, K] of every run; each chain of stretches is predicted once."""
    answers = [np.zeros((0, 0))] * len(runs)
    for chain in find_chains(runs):
        answer = predict(_lay_run(chain.stretches, chain.bridges))
        for i, start in chain.places:
            answers[i] = answer[start : start + len(runs[i])]
    return answers


def find_chains(runs: Sequence[Run], block: int = 1) -> list[Chain]:
    """Return the chains that the stretches `runs` lie in; a run without a gap is one by itself.

    Args:
        runs: stretches; earlier stretches of the same run need not be among them.
        block: each stretch begins at a multiple of so many samples.
    """
    index = {(run.group, run.part): i for i, run in enumerate(runs)}
    laid: set[int] = set()
    chains = []
    for i in sorted(range(len(runs)), key=lambda i: -runs[i].part):
        if i in laid:
            continue
        stretches = list_chain(runs[i])
        bridges, starts = plan_bridges(stretches, block)
        places = []
        for run, start in zip(stretches, starts, strict=True):
            # A stretch may stand alone, without those before it.
            at = i if run is runs[i] else index.get((run.group, run.part))
            if at is not None and at not in laid and len(runs[at]) == len(run):
                places.append((at, start))
                laid.add(at)
        chains.append(Chain(tuple(stretches), tuple(bridges), tuple(places)))
    return sorted(chains, key=lambda chain: chain.places[0])


def _lay_run(chain: Sequence[Run], bridges: Sequence[int]) -> Run:
    """Return the stretches of a run as one, at rest before it."""
    if len(chain) == 1:
        return chain[0]
    return replace(
        chain[0],
        time_s=lay([part.time_s for part in chain], bridges),
        temperature_degC=lay([part.temperature_degC for part in chain], bridges),
        measured=lay([part.measured for part in chain], bridges),
        reference=lay([part.reference for part in chain], bridges),
        inputs={
            name: lay([part.inputs[name] for part in chain], bridges) for name in chain[0].inputs
        },
    )
