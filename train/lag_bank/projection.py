"""Variable projection: the linear part exactly, everything else by Levenberg-Marquardt.

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); Kaufman, BIT 15 (1975).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array

Places = NDArray[np.int64]

DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-9, 1e6
RAISE, LOWER = 4.0, 6.0
LONGEST_STEP = 1.0
CONVERGED = 1e-5
"""A step that lowers the cost by less than this share is the last one."""
JITTER = 1e-11
"""Added to a normal matrix of unit diagonal, so that equal columns do not stop the solution."""


@dataclass(frozen=True)
class Columns:
    """The linear part's columns at some theta, and how they change with it."""

    phi: Array  # [m, J]
    slopes: Array  # [m, S]
    of_theta: Places
    """[S] the theta that a slope belongs to."""
    of_column: Places
    """[S] the column that it is the slope of."""


@dataclass(frozen=True)
class ProjectionProblem:
    """y = phi(theta) C + noise, with a ridge on C and a Gaussian prior on theta."""

    build: Callable[[Array], Columns]
    """Columns at theta, rows already weighted."""
    targets: Array
    """[m, K], rows already weighted."""
    ridge: Array
    """[J] added to the diagonal of the normal matrix."""
    prior: Array
    """[P] weight of (theta - prior_mean)^2."""
    prior_mean: Array


@dataclass(frozen=True)
class _ProjectionState:
    cost: float
    gradient: Array
    curvature: Array


def solve_ridge(normal: Array, right: Array, ridge: Array) -> Array:
    """Return (normal + diag(ridge))^-1 right.

    Args:
        normal: normal matrices [..., J, J].
        right: [..., J, K].
        ridge: [..., J].
    """
    size = normal.shape[-1]
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1) + ridge
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
    scaled = normal * scale[..., :, None] * scale[..., None, :]
    places = np.arange(size)
    scaled[..., places, places] = diagonal * scale**2 + JITTER
    return np.asarray(scale[..., None] * np.linalg.solve(scaled, scale[..., None] * right))


def minimise(problem: ProjectionProblem, theta: Array, most_steps: int) -> Array:
    """Return the theta of least cost that is reached from a start [P]."""
    damping = DAMPING
    state = _evaluate(problem, theta)
    for _ in range(most_steps):
        before = state.cost
        while True:
            diagonal = np.diag(np.diag(state.curvature) + 1e-12)
            step = np.linalg.solve(state.curvature + damping * diagonal, state.gradient)
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))
            tried = _evaluate(problem, theta + step)
            if tried.cost < before or damping > MOST_DAMPING:
                break
            damping *= RAISE
        if tried.cost >= before:
            break
        theta, state = theta + step, tried
        damping = max(damping / LOWER, LEAST_DAMPING)
        if before - tried.cost < CONVERGED * before:
            break
    return theta


def _evaluate(problem: ProjectionProblem, theta: Array) -> _ProjectionState:
    columns = problem.build(theta)
    phi, slopes, y = columns.phi, columns.slopes, problem.targets
    outputs = y.shape[1]
    across = np.concatenate([phi.T @ y, phi.T @ slopes], axis=1)
    solved = solve_ridge(phi.T @ phi, across, problem.ridge)
    c, projected = solved[:, :outputs], solved[:, outputs:]
    residual = y - phi @ c
    offset = theta - problem.prior_mean
    cost = float(np.vdot(residual, residual) + problem.ridge @ np.sum(c**2, axis=1))
    cost += float(problem.prior @ offset**2)
    pull = np.sum((slopes.T @ residual) * c[columns.of_column], axis=1)
    curved = slopes.T @ slopes - across[:, outputs:].T @ projected
    curved *= (c @ c.T)[np.ix_(columns.of_column, columns.of_column)]
    collect = np.zeros((theta.size, columns.of_theta.size))
    collect[columns.of_theta, np.arange(columns.of_theta.size)] = 1.0
    return _ProjectionState(
        cost,
        collect @ pull - problem.prior * offset,
        collect @ curved @ collect.T + np.diag(problem.prior),
    )
