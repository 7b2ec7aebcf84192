"""A run with gaps as one stretch: straight lines stand for what was not logged."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from zerodrift.dataset.runs import Array, Run


def list_chain(run: Run) -> list[Run]:
    """Return the stretches of a run up to this one, the first one first."""
    chain = [run]
    while chain[0].before is not None:
        chain.insert(0, chain[0].before)
    return chain


def plan_bridges(chain: Sequence[Run], block: int = 1) -> tuple[list[int], list[int]]:
    """Return the samples of each bridge, and where each stretch begins once they are laid.

    A bridge has as many samples as the gap, but no more than all stretches before it: what lies
    longer ago than that is as good as settled.

    Args:
        chain: a run's stretches.
        block: each stretch begins at a multiple of so many samples.
    """
    bridges, starts = [], [0]
    for before, after in pairwise(chain):
        end = starts[-1] + len(before)
        gap_s = float(after.time_s[0] - before.time_s[-1])
        missing = min(max(round(gap_s / before.sample_period_s) - 1, 0), end)
        missing += -(end + missing) % block
        bridges.append(missing)
        starts.append(end + missing)
    return bridges, starts


def lay(values: Sequence[Array], bridges: Sequence[int]) -> Array:
    """Return the stretches' values [n] or [n, K] end to end, straight lines between them."""
    pieces = [values[0]]
    for now, missing in zip(values[1:], bridges, strict=True):
        line = np.linspace(pieces[-1][-1], now[0], missing + 2)[1:-1]
        pieces += [line, now]
    return np.concatenate(pieces)


def predict_along(predict: Callable[[Run], Array], run: Run) -> Array:
    """Return what `predict` gives for a stretch [n, K] when it begins at the run's first one."""
    if run.before is None:
        return predict(run)
    chain = list_chain(run)
    bridges, starts = plan_bridges(chain)
    whole = replace(
        chain[0],
        time_s=lay([part.time_s for part in chain], bridges),
        temperature_degC=lay([part.temperature_degC for part in chain], bridges),
        measured=lay([part.measured for part in chain], bridges),
        reference=lay([part.reference for part in chain], bridges),
        inputs={name: lay([part.inputs[name] for part in chain], bridges) for name in run.inputs},
    )
    return predict(whole)[starts[-1] :]
