"""Which lags and how strong a ridge: by leaving runs out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zerodrift.train.lag_bank.data import DEGREE, BankData, Lag
from zerodrift.train.lag_bank.projection import Columns, Problem, minimise, solve_ridge

Array = NDArray[np.float64]

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
    def everything(self) -> NDArray[np.bool_]:
        """[m] all rows."""
        return np.ones(len(self.weight), dtype=bool)

    def columns(self, lags: Sequence[Lag]) -> Array:
        """Return the columns of the linear part [m, J]."""
        return np.concatenate([self.fixed, *(self.data.lag(lag) for lag in lags)], axis=1)

    def prepare(self, columns: Array, some: NDArray[np.bool_]) -> Array:
        """Return some rows of columns [m, J], centred where runs are tared, weighted."""
        weight, x = self.weight[some], columns[some]
        if self.tared:
            group = self.data.run_group[some]
            sums = np.zeros((int(group.max()) + 1, x.shape[1]))
            np.add.at(sums, group, weight[:, None] * x)
            total = np.bincount(group, weight)
            x = x - (sums / np.maximum(total, 1e-300)[:, None])[group]
        return np.asarray(x * np.sqrt(weight)[:, None])


@dataclass(frozen=True)
class Bank:
    """Chosen lags and ridge."""

    lags: tuple[Lag, ...]
    ridge: float
    error: float
    """RMSE on runs left out, in units."""


class LeftOut:
    """Judges linear parts on groups left out, by sums of products."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        group = rows.data.group
        self._learnt = [group == g for g in range(rows.data.groups)]
        self._judged = [own & rows.data.covered for own in self._learnt]
        self._weight = float(sum(rows.weight[own].sum() for own in self._judged))

    def sum_products(self, columns: Array) -> tuple[Array, Array]:
        """Return sums of products of columns and targets by group [G, C, C]: all, and judged."""
        together = np.concatenate([columns, self._rows.targets], axis=1)
        whole, judged = (
            np.stack([x.T @ x for x in (self._rows.prepare(together, some) for some in parts)])
            for parts in (self._learnt, self._judged)
        )
        return whole, judged

    def measure(self, products: tuple[Array, Array], ridge: float) -> float:
        """Return the RMSE on the groups, each predicted by a fit to the others."""
        whole, judged = products
        outputs = self._rows.unit.size
        total = whole.sum(axis=0)
        j = total.shape[0] - outputs
        squares = 0.0
        for own, seen in zip(whole, judged, strict=True):
            rest = total - own
            c = solve_ridge(rest[:j, :j], rest[:j, j:], ridge * np.diag(rest)[:j])
            squares += float(
                np.trace(seen[j:, j:])
                - 2.0 * np.sum(c * seen[:j, j:])
                + np.sum(c * (seen[:j, :j] @ c))
            )
        return float(np.sqrt(max(squares, 0.0) / max(self._weight * outputs, 1e-300)))

    def choose_ridge(self, lags: Sequence[Lag]) -> Bank:
        """Return these lags with the ridge that does best."""
        products = self.sum_products(self._rows.columns(lags))
        error, ridge = min((self.measure(products, ridge), ridge) for ridge in RIDGES)
        return Bank(tuple(lags), ridge, error)


def choose_bank(rows: Rows, most: int = MOST_LAGS) -> list[Bank]:
    """Return the best bank found of each size, from none to `most` lags."""
    data, judge = rows.data, LeftOut(rows)
    grid = np.geomspace(*span_of(data), GRID)
    banks = [judge.choose_ridge(())]
    while len(banks) <= most:
        last = banks[-1]
        base = rows.columns(last.lags)
        tries = []
        for source in range(len(data.sources)):
            for tau_s in grid:
                lag = (source, float(tau_s))
                products = judge.sum_products(np.concatenate([base, data.lag(lag)], axis=1))
                tries.append((judge.measure(products, last.ridge), lag))
        found = (*last.lags, min(tries)[1])
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
    data, some = rows.data, rows.everything
    fixed = rows.prepare(rows.fixed, some)
    low, high = np.log(span_of(data))

    def decode(theta: Array) -> list[Lag]:
        taus = np.exp(np.clip(theta, low, high))
        return [(s, float(tau_s)) for (s, _), tau_s in zip(lags, taus, strict=True)]

    def build(theta: Array) -> Columns:
        now = decode(theta)
        columns = rows.prepare(np.concatenate([data.lag(lag) for lag in now], axis=1), some)
        slopes = rows.prepare(np.concatenate([data.slope(lag) for lag in now], axis=1), some)
        return Columns(
            np.concatenate([fixed, columns], axis=1),
            slopes,
            np.repeat(np.arange(len(lags)), DEGREE),
            fixed.shape[1] + np.arange(DEGREE * len(lags)),
        )

    start = np.log([tau_s for _, tau_s in lags])
    targets = rows.prepare(rows.targets, some)
    phi = build(start).phi
    strength = ridge * np.sum(phi**2, axis=0)
    residual = targets - phi @ solve_ridge(phi.T @ phi, phi.T @ targets, strength)
    hold = np.full(len(lags), NEAR_START * float(np.sum(residual**2)))
    problem = Problem(build, targets, strength, hold, start)
    theta = minimise(problem, start, REFINE_STEPS)
    return tuple((s, float(f"{tau_s:.{DIGITS}g}")) for s, tau_s in decode(theta))
