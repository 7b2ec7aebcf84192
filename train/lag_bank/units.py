"""A few tanh units beside the linear part: several starts, each by Levenberg-Marquardt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.train.lag_bank.projection import Columns, ProjectionProblem, minimise, solve_ridge
from zerodrift.train.lag_bank.search import Rows

PRIOR = 1e-5
"""Weight per row of a unit's own weights squared: units that are not needed stay straight."""
HEAD_RIDGE = 1e-6
"""Weight per row of what units add to an output squared, in units of what is left to them."""
SPREAD = 0.7
"""Of a unit's first weights on features of unit variance."""
FOLDS = 4
STEPS = 50


@dataclass(frozen=True)
class Member:
    """One fit: tanh units, and everything that is linear beside them."""

    weights: Array
    """[U, I + 1], the bias last."""
    linear: Array
    """[J, K] of the linear columns."""
    head: Array
    """[U, K]."""

    def predict(self, columns: Array, features: Array) -> Array:
        """Return [m, K] for linear columns [m, J] and features [m, I]."""
        hidden = np.tanh(features @ self.weights[:, :-1].T + self.weights[:, -1])
        return np.asarray(columns @ self.linear + hidden @ self.head)


def fit_linear(rows: Rows, columns: Array, ridge: float, some: NDArray[np.bool_]) -> Member:
    """Return the linear part alone, fitted to some of the rows."""
    part = rows.take(some)
    f, y = (part.prepare(part.cut(x)) for x in (columns, rows.targets))
    linear = solve_ridge(f.T @ f, f.T @ y, ridge * np.sum(f**2, axis=0))
    return Member(np.zeros((0, 1)), linear, np.zeros((0, y.shape[1])))


def fit_member(
    rows: Rows,
    columns: Array,
    features: Array,
    ridge: float,
    count: int,
    seed: Sequence[int],
    some: NDArray[np.bool_],
    steps: int = STEPS,
) -> Member:
    """Return `count` units and the linear part beside them, fitted from one random start.

    Args:
        rows: the rows of the whole fit.
        columns: [m, J] of the linear part.
        features: [m, I] what the units see, of unit variance.
        ridge: of the linear part, as a share of each column's square.
        count: number of units.
        seed: of the start.
        some: [m] rows to learn from.
        steps: of Levenberg-Marquardt, at most.
    """
    part = rows.take(some)
    f, y = (part.prepare(part.cut(x)) for x in (columns, rows.targets))
    linear_ridge = ridge * np.sum(f**2, axis=0)
    basis = np.linalg.qr(np.concatenate([f, np.diag(np.sqrt(linear_ridge))]))[0]

    def project(x: Array) -> Array:
        """Return rows without what the linear part explains of them, its ridge included."""
        left = basis @ -(basis[: len(f)].T @ x)
        left[: len(f)] += x
        return np.asarray(left)

    left = project(y)
    scale = np.sqrt(np.maximum(np.sum(left**2, axis=0) / part.weight, 1e-300))
    x = part.cut(np.concatenate([features, np.ones((len(features), 1))], axis=1))
    inputs = x.shape[1]
    places = np.arange(count * inputs)

    def build(theta: Array) -> Columns:
        hidden = np.tanh(x @ theta.reshape(count, inputs).T)
        bent = (1.0 - hidden**2)[:, :, None] * x[:, None, :]
        both = project(part.prepare(np.concatenate([hidden, bent.reshape(len(x), -1)], axis=1)))
        return Columns(both[:, :count], both[:, count:], places, places // inputs)

    start = np.random.default_rng(seed).normal(size=(count, inputs)) * SPREAD
    problem = ProjectionProblem(
        build,
        left / scale,
        np.full(count, HEAD_RIDGE * part.weight),
        np.full(count * inputs, PRIOR * part.weight),
        np.zeros(count * inputs),
    )
    weights = minimise(problem, start.ravel(), steps).reshape(count, inputs)
    both = np.concatenate([f, part.prepare(np.tanh(x @ weights.T))], axis=1)
    strength = np.concatenate([linear_ridge, np.full(count, HEAD_RIDGE * part.weight)])
    solved = solve_ridge(both.T @ both, both.T @ y, strength)
    return Member(weights, solved[: f.shape[1]], solved[f.shape[1] :])


def split_folds(rows: Rows) -> list[NDArray[np.bool_]]:
    """Return which rows [m] each of a few folds leaves out; whole groups, spread evenly."""
    groups = np.arange(rows.data.groups)
    return [np.isin(rows.data.group, groups[i::FOLDS]) for i in range(min(FOLDS, rows.data.groups))]


def measure_left_out(rows: Rows, fit: Callable[[NDArray[np.bool_]], Callable[[], Array]]) -> float:
    """Return the RMSE in units on covered rows of folds left out, every run counting once.

    Infinite where no row is covered.

    Runs have equal weight: by samples, hours in the chamber would hide the gain of units in a short
    run under a lamp.

    Args:
        rows: the rows.
        fit: rows to learn from -> a function that predicts all rows [m, K].
    """
    data, found = rows.data, []
    for left_out in split_folds(rows):
        judged = left_out & data.covered
        if not judged.any():
            continue
        errors = np.sum(rows.prepare(rows.targets - fit(~left_out)(), judged) ** 2, axis=1)
        group, samples = data.group[judged], data.counts[judged]
        found += [
            float(errors[group == g].sum() / samples[group == g].sum()) for g in np.unique(group)
        ]
    return float(np.sqrt(np.mean(found) / rows.unit.size)) if found else np.inf
