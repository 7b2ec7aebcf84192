"""Which of many starting values are worth a look octave by octave.

A search follows the best few points of a grid. Where every octave has the same weight, the squared
error does not depend on how the samples are taken apart (the change of basis is orthonormal), so
that all points can be compared by plain products of the samples, in one matrix product. What comes
near the best is then looked at as ever, so that the answer is the same to the bit.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.terms import Term

MARGIN = 1e-3
"""By how much more than the last of the best, in the sum of the logarithms of squared errors, a
point may cost and still be looked at; round-off is a millionth of it."""
LEAST_LEFT = 1e-6
"""Where a point leaves less of the drift's squares than this share, round-off might decide."""
LEAST_EIGENVALUE = 1e-6
"""The same of the columns of a point that are nearly alike."""

MOST_AT_ONCE, LEAST_PART = 50_000, 16
"""Products in a part, and samples at least."""


def find_promising(
    campaign: Campaign, choices: Sequence[Sequence[Term]], weights: Array, count: int
) -> list[int] | None:
    """Return the places of all choices that may be among the best, in their order.

    Args:
        campaign: the runs.
        choices: the terms at several values.
        weights: [L, K] per octave and output.
        count: how many of the best are wanted.

    Returns:
        None where that cannot be told so, and all have to be looked at.
    """
    if len(choices) <= count or not bool((weights == 1.0).all()):
        return None
    built = [campaign.build(terms) for terms in choices]
    drift = campaign.lay_drift()
    nodes = {id(f.signal): f.signal for features in built for f in features}
    width = len(built[0])
    if (
        drift is None
        or width == 0
        or any(len(features) != width for features in built)
        or any(f.output is not None for features in built for f in features)
        or any(campaign.rates.find_fast(node) for node in nodes.values())
    ):
        return None
    places = {key: i for i, key in enumerate(nodes)}
    with np.errstate(all="ignore"):
        table = np.stack([campaign.rates.lay(node) for node in nodes.values()])
        costs = _compare(
            campaign.level(table),
            campaign.level(drift),
            np.array([[places[id(f.signal)] for f in features] for features in built]),
        )
    if costs is None:
        return None
    limit = np.partition(costs, count - 1)[count - 1] + MARGIN
    return np.flatnonzero(costs <= limit).tolist()


def _compare(table: Array, drift: Array, points: NDArray[np.int64]) -> Array | None:
    """Return the cost [S] of each point; None where round-off might count.

    Args:
        table: [U, n] all columns, levelled.
        drift: [K, n] likewise.
        points: [S, J] the columns of each point.
    """
    gram, right = _multiply(table, table), _multiply(table, drift)
    squares = (drift * drift).sum(axis=1)
    size = np.sqrt(np.diag(gram))
    if not np.isfinite(gram).all() or not (size > 0.0).all():
        return None
    gram, right = gram / (size[:, None] * size), right / size[:, None]
    normal = gram[points[:, :, None], points[:, None, :]]
    if float(np.linalg.eigvalsh(normal)[:, 0].min()) < LEAST_EIGENVALUE:
        return None
    own = right[points]
    left = squares - (own * np.linalg.solve(normal, own)).sum(axis=1)
    if not (left > LEAST_LEFT * squares).all():
        return None
    return np.asarray(np.log(left).sum(axis=1))


def _multiply(one: Array, other: Array) -> Array:
    """Return the products [U, V] of rows [U, n] and [V, n], part by part.

    In one piece it would be worth several threads to BLAS, which cost more than they save.
    """
    size = max(LEAST_PART, MOST_AT_ONCE // (len(one) * len(other)))
    end = one.shape[1] // size * size
    parts = [x[:, :end].reshape(len(x), -1, size).swapaxes(0, 1) for x in (one, other)]
    whole = (parts[0] @ parts[1].swapaxes(1, 2)).sum(axis=0)
    return np.asarray(whole + one[:, end:] @ other[:, end:].T)
