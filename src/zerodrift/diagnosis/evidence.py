"""What counts as evidence: errors on runs left out, and signs of whole runs flipped.

Within a run samples are correlated; runs are independent. So a model is judged by runs
that it was not fitted to, and chance is judged by flipping the signs of whole runs' gains.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from zerodrift.base.arrays import Array
from zerodrift.physics.campaign import Sums
from zerodrift.physics.reduction import MEANS
from zerodrift.physics.search import Coordinate, invert_scaled, solve, step_values, weigh

FOLD_STEPS = 2
"""Gauss-Newton steps of the shared values within each fold, from the optimum over all runs."""
MOST_MOVE = 0.5
"""Largest move of a coordinate within a fold; the slopes hold no further."""
SURE_NATS = 25.0
"""Gain in likelihood of an effect that follows a signal, above which few runs are enough, or one
(`python -m benchmarks.study_evidence` prints what chance gains)."""
FEWEST_COEFFICIENTS = 8
"""Octaves whose coefficients are fewer share a variance with the next faster one."""
MOST_FLIPS = 4096
"""All sign patterns up to twelve runs; beyond, as many drawn at random."""


@dataclass(frozen=True)
class Errors:
    """Squared errors of each piece of time."""

    squares: Array
    """[G, L, K] sums of squares per piece, octave and output."""
    counts: Array
    """[G, L]."""

    def score(self, weights: Array) -> Array:
        """Return the weighted squared error [G] of each piece, in noise units."""
        return np.asarray(np.einsum("glk,lk->g", self.squares, weights))

    def mean_squares(self, means: NDArray[np.bool_]) -> Array:
        """Return the mean square [K] over all octaves that `means` does not mark."""
        return np.asarray(self.squares[:, ~means].sum(axis=(0, 1)) / self.counts[:, ~means].sum())


def hold_out(
    sums: Sums,
    weights: Array,
    coordinates: Sequence[Coordinate],
    position: Array,
    unit_of_piece: NDArray[np.int64],
) -> Errors:
    """Return the errors of every unit of evidence, predicted from all the others.

    Args:
        sums: with slopes along all coordinates.
        weights: [L, K].
        coordinates: the shared values.
        position: [P] where they are.
        unit_of_piece: [G] the unit (run) that each piece belongs to.
    """
    weighted = weigh(sums, weights)
    total = weighted.sum(axis=0)
    units = np.unique(unit_of_piece)
    own = np.stack([weighted[unit_of_piece == unit].sum(axis=0) for unit in units])
    folds = total[None] - own
    count = len(coordinates)
    shift: Array | None = None
    solution = solve(sums, folds)
    if count:
        bounds = np.array([c.bounds for c in coordinates])
        low = np.maximum(bounds[:, 0] - position, -MOST_MOVE)
        high = np.minimum(bounds[:, 1] - position, MOST_MOVE)
        shift = np.zeros((units.size, count))
        for _ in range(FOLD_STEPS):
            gradient, normal = step_values(sums, folds, solution, count, shift)
            normal = (
                normal
                + 1e-6 * np.eye(count) * np.trace(normal, axis1=-2, axis2=-1)[..., None, None]
            )
            step = (invert_scaled(normal) @ gradient[..., None])[..., 0]
            shift = np.clip(shift + step, low, high)
            solution = solve(sums, folds, shift)
    squares = np.empty((unit_of_piece.size, *weights.shape))
    for fold, unit in enumerate(units):
        mine = unit_of_piece == unit
        squares[mine] = _square(solution.residual[fold], sums.products[mine])
    return Errors(squares, sums.counts)


def hold_in(sums: Sums, weights: Array) -> Errors:
    """Return the errors of every piece that a fit to all of them leaves.

    Args:
        sums: the sums of products.
        weights: [L, K] of the fit.
    """
    solution = solve(sums, weigh(sums, weights).sum(axis=0))
    return Errors(_square(solution.residual, sums.products), sums.counts)


def _square(residual: Array, products: Array) -> Array:
    """Return the squares [G, L, K] of residuals [K, C], from sums of products [G, L, C, C]."""
    moved = residual @ products
    return np.asarray(np.maximum(np.einsum("glkc,kc->glk", moved, residual), 0.0))


def compare_likelihoods(
    before: Errors, after: Errors, levels: NDArray[np.int64], unjudged: NDArray[np.bool_]
) -> float:
    """Return the gain in log-likelihood, nats, with the noise of each octave its own either time.

    A missing effect and slow noise both enlarge the slow octaves. So neither model's noise is
    fixed: each octave's variance is what that model leaves there, and what counts is by how much
    the variances fall, coefficient by coefficient. A wandering that an effect follows by chance
    leaves most of what it was; an effect that is there leaves the fast octaves' noise. The slowest
    octaves have few coefficients and share one variance.

    Args:
        before: held-out errors of the model as it is.
        after: those with the effect.
        levels: [L] octaves' numbers.
        unjudged: [L] octaves that do not count.
    """
    counts = before.counts.sum(axis=0)
    old, new = before.squares.sum(axis=0), after.squares.sum(axis=0)
    # From slow to fast: the pieces' means are the slowest.
    order = sorted(
        np.flatnonzero(~unjudged & (counts > 0.0)).tolist(),
        key=lambda i: (levels[i] != MEANS, -levels[i]),
    )
    gain, start = 0.0, 0
    for stop in range(1, len(order) + 1):
        band = order[start:stop]
        count = float(counts[band].sum())
        if count < FEWEST_COEFFICIENTS and stop < len(order):
            continue
        was, now = old[band].sum(axis=0), new[band].sum(axis=0)
        alive = (was > 0.0) & (now > 0.0)
        gain += 0.5 * count * float(np.log(was[alive] / now[alive]).sum())
        start = stop
    return gain


def flip_signs(gains: Array) -> Array:
    """Return the p-value [M] of each candidate's total gain, against the best of all by chance.

    If nothing were to be gained, each run's gain could as well have had the other sign, for all
    candidates at once. The p-value is the share of sign patterns in which some candidate gains at
    least as much; with R runs it cannot be less than 2^-R.

    Args:
        gains: [M, R] held-out gain of each candidate in each run, noise units.
    """
    runs = gains.shape[1]
    if 2**runs <= MOST_FLIPS:
        signs = np.array(list(itertools.product((1.0, -1.0), repeat=runs)))
    else:
        signs = np.random.default_rng(0).choice((1.0, -1.0), size=(MOST_FLIPS, runs))
        signs[0] = 1.0
    # A candidate that fails badly in a run has lost there, and tells nothing about what chance
    # could gain: its losses count for no more than its largest gain.
    largest = np.maximum(gains.max(axis=1, keepdims=True), 0.0)
    best = (signs @ np.maximum(gains, -largest).T).max(axis=1)
    observed = gains.sum(axis=1)
    return np.asarray(
        (best[None, :] >= observed[:, None] - 1e-9 * np.abs(observed[:, None])).mean(axis=1)
    )


def compare_runs(better: Array, worse: Array) -> float:
    """Return the one-sided p-value that `better` is no better than `worse`, over runs [R]."""
    difference = better - worse
    runs = difference.size
    spread = float(np.std(difference, ddof=1)) if runs > 1 else 0.0
    if runs < 2 or spread == 0.0:
        return 0.5
    return float(stdtr(runs - 1, -difference.mean() / (spread / np.sqrt(runs))))
