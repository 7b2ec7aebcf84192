"""Which lags and how strong a ridge: by leaving runs out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.train.lag_bank.data import DEGREE, BankData, Lag

# Variable projection: the linear part exactly, everything else by Levenberg-Marquardt.
#
# Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); Kaufman, BIT 15 (1975).


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
    of_theta: IntArray
    """[S] the theta that a slope belongs to."""
    of_column: IntArray
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


# Which lags and how strong a ridge: by leaving runs out.

GRID = 14
"""Time constants that are tried per thermometer, evenly spaced in the logarithm."""
SHORTEST_STEPS = 3.0
"""A lag shorter than this many samples shows the thermometer's noise more than its slope."""
SHORTEST_S, LONGEST_S = 4.0, 3000.0
LONGEST_SHARE = 0.25
"""A lag longer than this share of the longest run cannot be told from a slow drift."""
MOST_LAGS = 4
EARNS_ITS_PLACE = 0.95
"""A larger bank must bring the error on runs left out below this multiple of a smaller one's."""
HELPS = 0.999
"""The search ends where no lag more brings that error below this multiple of what it was."""
RIDGES = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Shares of each column's own square."""
NEAR_START = 1e-3
"""A time constant e times the one that the grid found costs this share of the squared error."""
REFINE_STEPS = 12
DIGITS = 4


@dataclass(frozen=True)
class Rows:
    """The rows of a fit: data, weights, and whether runs have offsets of their own."""

    data: BankData
    weight: Array
    """[m]."""
    tared: bool
    unit: Array
    """[K] what errors are measured in."""

    @cached_property
    def targets(self) -> Array:
        """[m, K] targets in units."""
        return np.asarray(self.data.targets / self.unit)

    @cached_property
    def fixed(self) -> Array:
        """[m, J] columns of every bank: constant, others, all thermometers' levels."""
        data = self.data
        ones = np.ones((len(self.weight), 1))
        levels = [data.level(s) for s in range(len(data.sources))]
        return np.concatenate([ones, data.others, *levels], axis=1)

    @property
    def everything(self) -> Mask:
        """[m] all rows."""
        return np.ones(len(self.weight), dtype=bool)

    def columns(self, lags: Sequence[Lag], degree: int = DEGREE) -> Array:
        """Return the columns of the linear part [m, J], with so many powers of each lag."""
        own = [self.data.lag(lag)[:, :degree] for lag in lags]
        return np.concatenate([self.fixed, *own], axis=1)

    def take(self, some: Mask) -> "RowsPart":
        """Return the part of a fit that some rows [m] are."""
        return RowsPart(self, some)

    def prepare(self, columns: Array, some: Mask) -> Array:
        """Return some rows of columns [m, J], centred where runs are tared, weighted."""
        part = self.take(some)
        return part.prepare(part.cut(columns))


class RowsPart:
    """Some rows of a fit, and what centres and weights them.

    Args:
        rows: the rows of the whole fit.
        some: [m] which of them.
    """

    def __init__(self, rows: Rows, some: Mask) -> None:
        self._places = slice(None) if some.all() else np.flatnonzero(some)
        weight = rows.weight[self._places]
        self.weight = float(weight.sum())
        """Of all rows together."""
        self._root = np.sqrt(weight)[:, None]
        self._tared = rows.tared
        if self._tared and len(weight):
            run = rows.data.run_group[self._places]
            self._weight = weight[:, None]
            self._starts = np.flatnonzero(np.diff(run, prepend=-1))
            _, stretch_run = np.unique(run[self._starts], return_inverse=True)
            self._same = stretch_run[:, None] == np.arange(stretch_run.max() + 1)
            self._row_run = np.repeat(stretch_run, np.diff(self._starts, append=len(run)))
            total = self._same.T @ np.add.reduceat(weight, self._starts)
            self._total = np.maximum(total, 1e-300)[:, None]

    def cut(self, x: Array) -> Array:
        """Return the part's rows of x [m, ...]."""
        return np.asarray(x[self._places])

    def prepare(self, x: Array) -> Array:
        """Return the part's rows [p, J], centred where runs are tared, weighted."""
        if self._tared and len(x):
            sums = self._same.T @ np.add.reduceat(self._weight * x, self._starts, axis=0)
            x = x - (sums / self._total)[self._row_run]
        return np.asarray(x * self._root)


@dataclass(frozen=True)
class Bank:
    """Chosen lags and ridge."""

    lags: tuple[Lag, ...]
    ridge: float
    error: float
    """RMSE on runs left out, in units."""


@dataclass(frozen=True)
class Products:
    """Sums of products of columns and targets, group by group; T sets of columns side by side."""

    learnt: Array
    """[..., G, J + K, J + K] of all rows of a group."""
    judged: Array
    """[..., G, J + K, J + K] of those that judge."""


class LeftOutJudge:
    """Judges linear parts on groups left out, by sums of products."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        group = rows.data.group
        learnt = [group == g for g in range(rows.data.groups)]
        self._learnt = [rows.take(own) for own in learnt]
        self._judged = [rows.take(own & rows.data.covered) for own in learnt]
        self._weight = sum(part.weight for part in self._judged)

    def sum_products(self, columns: Array) -> Products:
        """Return the products of columns [m, J] and targets."""
        x = np.concatenate([columns, self._rows.targets], axis=1)
        return Products(
            *(
                np.stack([own.T @ own for own in (part.prepare(part.cut(x)) for part in parts)])
                for parts in (self._learnt, self._judged)
            )
        )

    def sum_each(self, base: Array, more: Sequence[Array]) -> Products:
        """Return the products [T, G, ...] of a base [m, J] with one of T sets [m, L] after it."""
        wide = base.shape[1]
        x = np.concatenate([base, self._rows.targets, *more], axis=1)
        outputs, each = self._rows.unit.size, more[0].shape[1]
        known = wide + outputs
        sets = np.arange(len(more))[:, None] * each + np.arange(each) + known  # [T, L]
        head, tail = np.arange(wide), np.arange(wide, known)
        places = np.stack([np.concatenate([head, own, tail]) for own in sets])  # [T, J + L + K]
        found = []
        for parts in (self._learnt, self._judged):
            sums = []
            for part in parts:
                own = part.prepare(part.cut(x))
                product = np.zeros((x.shape[1], x.shape[1]))
                product[:known] = own[:, :known].T @ own
                product[known:, :known] = product[:known, known:].T
                for i in sets:
                    product[np.ix_(i, i)] = own[:, i].T @ own[:, i]
                sums.append(product[places[:, :, None], places[:, None, :]])
            found.append(np.stack(sums, axis=1))
        return Products(*found)

    def measure(self, products: Products, ridge: Array) -> Array:
        """Return the RMSE on the groups, each predicted by a fit to the others, [...].

        Args:
            products: of the columns.
            ridge: shares of each column's own square; broadcast with the sets of columns.
        """
        whole, judged = products.learnt, products.judged
        outputs = self._rows.unit.size
        j = whole.shape[-1] - outputs
        rest = whole.sum(axis=-3, keepdims=True) - whole
        strength = ridge[..., None, None] * np.diagonal(rest, axis1=-2, axis2=-1)[..., :j]
        c = solve_ridge(rest[..., :j, :j], rest[..., :j, j:], strength)  # [..., G, J, K]
        squares = np.trace(judged[..., j:, j:], axis1=-2, axis2=-1) + np.sum(
            c * (judged[..., :j, :j] @ c - 2.0 * judged[..., :j, j:]), axis=(-2, -1)
        )
        total = np.maximum(squares.sum(axis=-1), 0.0)
        return np.asarray(np.sqrt(total / max(self._weight * outputs, 1e-300)))

    def choose_ridge(self, lags: Sequence[Lag]) -> Bank:
        """Return these lags with the ridge that does best."""
        products = self.sum_products(self._rows.columns(lags))
        errors = self.measure(products, np.array(RIDGES))
        error, ridge = min(zip(errors.tolist(), RIDGES, strict=True))
        return Bank(tuple(lags), ridge, error)


def choose_bank(rows: Rows, most: int = MOST_LAGS) -> list[Bank]:
    """Return the best bank found of each size: no lag, and as many as help, up to `most`."""
    data, judge = rows.data, LeftOutJudge(rows)
    grid = np.geomspace(*span_of(data), GRID)
    tries = [(s, float(tau_s)) for s in range(len(data.sources)) for tau_s in grid]
    columns = [data.lag(lag) for lag in tries]
    banks = [judge.choose_ridge(())]
    while len(banks) <= most:
        last = banks[-1]
        products = judge.sum_each(rows.columns(last.lags), columns)
        errors = judge.measure(products, np.array(last.ridge))
        error, lag = min(zip(errors.tolist(), tries, strict=True))
        if error > HELPS * last.error:
            break
        found = (*last.lags, lag)
        options = [judge.choose_ridge(o) for o in (found, refine(rows, found, last.ridge))]
        banks.append(min(options, key=lambda bank: bank.error))
    return banks


def pick(banks: Sequence[Bank]) -> Bank:
    """Return the smallest bank that no larger one beats by enough."""
    for i, bank in enumerate(banks):
        if all(other.error > EARNS_ITS_PLACE * bank.error for other in banks[i + 1 :]):
            return bank
    return banks[-1]


def span_of(data: BankData) -> tuple[float, float]:
    """Return the shortest and the longest time constant that these logs can tell, seconds."""
    shortest = max(SHORTEST_STEPS * data.dt_s, SHORTEST_S)
    return shortest, max(min(LONGEST_SHARE * data.longest_s, LONGEST_S), 2.0 * shortest)


def refine(rows: Rows, lags: Sequence[Lag], ridge: float) -> tuple[Lag, ...]:
    """Return the lags with their time constants at the least squares."""
    data, part = rows.data, rows.take(rows.everything)
    fixed = part.prepare(rows.fixed)
    low, high = np.log(span_of(data))

    def decode(theta: Array) -> list[Lag]:
        taus = np.exp(np.clip(theta, low, high))
        return [(s, float(tau_s)) for (s, _), tau_s in zip(lags, taus, strict=True)]

    def build(theta: Array) -> Columns:
        now = decode(theta)
        found = [data.lag_and_slope(lag) for lag in now]
        columns = part.prepare(np.concatenate([lag for lag, _ in found], axis=1))
        slopes = part.prepare(np.concatenate([slope for _, slope in found], axis=1))
        return Columns(
            np.concatenate([fixed, columns], axis=1),
            slopes,
            np.repeat(np.arange(len(lags)), DEGREE),
            fixed.shape[1] + np.arange(DEGREE * len(lags)),
        )

    start = np.log([tau_s for _, tau_s in lags])
    targets = part.prepare(rows.targets)
    phi = build(start).phi
    strength = ridge * np.sum(phi**2, axis=0)
    residual = targets - phi @ solve_ridge(phi.T @ phi, phi.T @ targets, strength)
    hold = np.full(len(lags), NEAR_START * float(np.sum(residual**2)))
    problem = ProjectionProblem(build, targets, strength, hold, start)
    theta = minimise(problem, start, REFINE_STEPS)
    return tuple((s, float(f"{tau_s:.{DIGITS}g}")) for s, tau_s in decode(theta))
