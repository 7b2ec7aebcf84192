"""The linear part of what physics leaves, solved exactly before the network sees anything.

A network needs units and epochs to approximate a straight line, and bends where the training data
end. So the part of the residual that is linear in the network's features is first removed by least
squares, and the network learns only the non-linear part. It is kept where it predicts runs left out
better than nothing does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run

BLOCKS = 5
"""A single run is left out in this many blocks of time."""
RIDGE = 1e-6
"""Share of each column's own square that is added to the normal equations."""
HELPS = 0.97
"""The linear part is kept if the error on runs left out falls below this multiple."""


@dataclass(frozen=True)
class Moments:
    """Sums of products of columns and targets, by what is left out together."""

    by_group: Array
    """[G, J + K, J + K]."""
    width: int
    """Number of columns J."""
    samples: int
    """Number of samples times outputs."""


@dataclass(frozen=True)
class FeatureTable:
    """Columns and targets of all samples, each group without its mean."""

    group: NDArray[np.int64]
    """[m]."""
    rows: Array
    """[m, J + K]."""
    width: int


def stack_centred(
    runs: Sequence[Run], columns: Sequence[Array], targets: Sequence[Array]
) -> FeatureTable:
    """Return columns [n, J] and targets [n, K] of all runs as one table.

    A group's mean is taken off, since its offset may be that of a tare. A single run is cut into
    blocks of time, which keep the run's mean.
    """
    names = list(dict.fromkeys(run.group for run in runs))
    rows = np.concatenate(
        [np.concatenate(pair, axis=1) for pair in zip(columns, targets, strict=True)]
    )
    if len(names) > 1:
        group = np.concatenate([np.full(len(run), names.index(run.group)) for run in runs])
        for g in range(len(names)):
            rows[group == g] -= rows[group == g].mean(axis=0)
    else:
        rows -= rows.mean(axis=0)
        group = np.arange(len(rows)) * BLOCKS // len(rows)
    return FeatureTable(group, rows, columns[0].shape[1])


def collect_moments(table: FeatureTable) -> Moments:
    """Return the sums of products of a table."""
    groups = [table.rows[table.group == g] for g in range(int(table.group.max()) + 1)]
    by_group = np.stack([rows.T @ rows for rows in groups])
    outputs = table.rows.shape[1] - table.width
    return Moments(by_group, table.width, len(table.rows) * outputs)


def score_left_out(moments: Moments) -> float:
    """Return the RMSE of the linear model on each group when it is fitted to the others."""
    total = moments.by_group.sum(axis=0)
    j = moments.width
    squares = 0.0
    for own in moments.by_group:
        solution = _solve(total - own, j)
        squares += float(
            np.trace(own[j:, j:])
            - 2.0 * np.sum(solution * own[:j, j:])
            + np.sum(solution * (own[:j, :j] @ solution))
        )
    return float(np.sqrt(max(squares, 0.0) / moments.samples))


def fit_linear(runs: Sequence[Run], features: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return the coefficients [I, K] of the features, or zeros where they do not help.

    Args:
        runs: training runs.
        features: [n, I] per run.
        residuals: [n, K] per run, drift that physics leaves, in multiples of each output's scale.
    """
    moments = collect_moments(stack_centred(runs, features, residuals))
    total = moments.by_group.sum(axis=0)
    nothing = float(np.sqrt(np.trace(total[moments.width :, moments.width :]) / moments.samples))
    if score_left_out(moments) > HELPS * nothing:
        return np.zeros((moments.width, residuals[0].shape[1]))
    return _solve(total, moments.width)


def _solve(moment: Array, width: int) -> Array:
    """Return the least-squares coefficients [J, K] of moments [J + K, J + K]."""
    normal = moment[:width, :width]
    ridge = RIDGE * np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(width)
    return np.asarray(np.linalg.solve(normal + ridge, moment[:width, width:]))
