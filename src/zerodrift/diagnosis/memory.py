"""How long the drift remembers the temperature, found from the logs by linear models of it.

Every model here is a table of columns that are linear in unknown coefficients: a polynomial in the
chip's temperature x, the loads and other channels, and for a memory the differences d between
what a slower body or an earlier sample has and what the chip has now, each as d, x d and x^2 d.
All of them are judged alike: each run by the model of the others. The sums of products of all
columns are formed once; a model is a choice of columns.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.live import find_live

TakeColumns = Callable[[slice], list[Array]]
"""Rows of a run -> some of its columns there, [n] each."""

GRID = 28
"""Time constants that are tried, evenly spaced in the logarithm."""
SHORTEST_STEPS = 3.0
"""A lag of fewer samples shows the thermometer's noise more than its slope."""
LONGEST_SHARE = 0.25
"""A lag longer than this share of the longest run cannot be told from a slow drift."""
MOST_LAGS = 3
EARNS_ITS_PLACE = 0.9
"""A lag must bring the error of runs left out below this multiple of what it was,"""
MOST_RUNS = 2.0 / 3.0
"""and do so in this share of the runs."""
TOLD_APART = 0.01
"""Time constants that give away no more than this share of the gain are as good as the best."""
MOST_ROWS = 40_000
"""Rows of the tables: more samples are averaged in blocks."""
ROWS_AT_ONCE = 1 << 14
"""Rows whose columns are in memory at once, about."""
DEGREE = 5
"""Of the polynomial in the temperature, which bends as a dark current does."""
MOST_TAPS = 9
"""Earlier samples of a window, or means of them, that enter its model."""
BLOCKS = 5
"""A single run is judged in this many blocks of time."""
RIDGE = 1e-7


@dataclass(frozen=True)
class TimeConstant:
    """One lag of the drift behind the chip's thermometer."""

    tau_s: float
    low_s: float
    """Between `low_s` and `high_s` the logs hardly tell one value from another."""
    high_s: float
    gain: float
    """Held-out RMSE with it over that without it."""
    at_limit: bool
    """Whether it is the longest that these logs can show."""

    @property
    def determined(self) -> bool:
        """Whether the logs tell it to within a factor of 3."""
        return not self.at_limit and self.high_s <= 3.0 * self.low_s


class MemoryTable:
    """The sums of products of base, lag and window columns with the drifts, run by run.

    Args:
        runs: training runs at one sample period.
        thermometers: inputs that are further thermometers; they enter the base like a lag.
        windows: (samples, seconds between them) of windows that will be asked for.
        lags_s: time constants beside those of the grid that will be asked for.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        *,
        thermometers: Sequence[str] = (),
        windows: Sequence[tuple[int, float]] = (),
        lags_s: Sequence[float] = (),
    ) -> None:
        self.runs = runs
        self.sample_period_s = runs[0].sample_period_s
        longest_s = max(len(run) for run in runs) * self.sample_period_s
        lowest_s = SHORTEST_STEPS * self.sample_period_s
        self.longest_s = max(LONGEST_SHARE * longest_s, 2.0 * lowest_s)
        self.grid = tuple(float(t) for t in np.geomspace(lowest_s, self.longest_s, GRID))
        temperature = np.concatenate([run.temperature_degC for run in runs])
        self._mean, self._spread = float(temperature.mean()), float(temperature.std()) or 1.0
        live = find_live(runs)
        self.outputs = np.flatnonzero(live)
        self.groups = tuple(dict.fromkeys(run.group for run in runs))
        self._index: dict[tuple[str, float, float], list[int]] = {}
        self._width = 0
        blocks = max(1, -(-sum(len(run) for run in runs) // MOST_ROWS))
        tables = []
        for run in runs:
            groups = self._build(run, thermometers, windows, (*self.grid, *lags_s))
            # Group by group, each forgotten before the next is made.
            means = [average(take, len(run), blocks) for take in groups]
            table = np.empty((len(run) // blocks, sum(mean.shape[1] for mean in means)))
            tables.append(np.concatenate(means, axis=1, out=table))
        self._form_products(tables)

    @property
    def judged(self) -> int:
        """How many runs, or blocks of a single one, are left out in turn."""
        return len(self.products)

    def lags(self, taus_s: Sequence[float]) -> list[int]:
        """Return the columns of a bank of lags."""
        return [i for tau in taus_s for i in self._index["lag", tau, 0.0]]

    def window(self, samples: int, spacing_s: float) -> list[int]:
        """Return the columns of a window of samples."""
        return self._index["window", float(samples), spacing_s]

    def score(self, columns: Sequence[int]) -> Array:
        """Return the mean squares [G, K] that each run leaves, predicted from the others.

        In units of what a model without memory leaves of each output in all runs.
        """
        index = [*self._base, *columns]
        own, target, power = self._take(index)
        solution = self.solve(own.sum(axis=0) - own, target.sum(axis=0) - target)
        squares = (
            power
            - 2.0 * np.einsum("gjk,gjk->gk", solution, target)
            + np.einsum("gjk,gji,gik->gk", solution, own, solution, optimize=True)
        )
        return np.asarray(np.maximum(squares, 0.0) / self.samples[:, None] / self.scale)

    def rmse(self, columns: Sequence[int]) -> float:
        """Return the held-out RMSE of all runs and outputs together, in the units of `score`."""
        return pool(self.score(columns), self.samples)

    def list_lagged(self, run: Run) -> list[Array]:
        """Return how far each lag of the grid is from the chip's temperature in a run, [n] each."""
        t = run.temperature_degC
        return [lowpass(t, self.sample_period_s, tau) - t for tau in self.grid[:: GRID // 7]]

    def take_base(self) -> list[int]:
        """Return the columns of the model without memory."""
        return list(self._base)

    def _take(self, index: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return products [G, J, J], with the drifts [G, J, K], and the drifts' squares [G, K]."""
        own = self.products[:, index][:, :, index]
        target = self.products[:, index, self._width :]
        power = np.einsum("gkk->gk", self.products[:, self._width :, self._width :])
        return own, target, power

    def solve(self, own: Array, target: Array) -> Array:
        """Return coefficients of stacked normal equations, with a small ridge."""
        diagonal = np.einsum("gjj->gj", own)
        ridge = RIDGE * diagonal + 1e-12 * diagonal.sum(axis=1, keepdims=True) + 1e-300
        return np.asarray(np.linalg.solve(own + ridge[:, :, None] * np.eye(own.shape[1]), target))

    def _build(
        self,
        run: Run,
        thermometers: Sequence[str],
        windows: Sequence[tuple[int, float]],
        lags_s: Sequence[float],
    ) -> Iterator[TakeColumns]:
        """Yield the columns of a run, group by group, the drifts last; note where each model's are.

        Each group is to be forgotten before the next is asked for: a long run's columns together
        are many times its log.
        """
        t, dt_s = run.temperature_degC, self.sample_period_s
        x = (t - self._mean) / self._spread

        def expand(other: Array, rows: slice) -> list[Array]:
            d = (other[rows] - t[rows]) / self._spread
            return [d, x[rows] * d, x[rows] ** 2 * d]

        def expand_mean(back: Sequence[int], rows: slice) -> list[Array]:
            d = (_look_back(t, rows, back) - t[rows]) / self._spread
            return [d, x[rows] * d, x[rows] ** 2 * d]

        def take(values: Array, rows: slice) -> list[Array]:
            return [values[rows]]

        def take_load(load: Array, rows: slice) -> list[Array]:
            return [load[rows], x[rows] * load[rows]]

        def raise_to_powers(rows: slice) -> list[Array]:
            return [x[rows] ** power for power in range(1, DEGREE + 1)]

        yield raise_to_powers
        count = DEGREE
        for k in range(run.reference.shape[1]):
            if any(np.ptp(other.reference[:, k]) > 0.0 for other in self.runs):
                yield partial(take_load, run.reference[:, k])
                count += 2
        for name in (n for n in run.inputs if n != "clock"):
            if name in thermometers:
                yield partial(expand, run.inputs[name])
                count += 3
            elif all(name in other.inputs for other in self.runs):
                yield partial(take, run.inputs[name])
                count += 1
        self._base = list(range(count))
        for tau in dict.fromkeys(lags_s):
            self._index["lag", tau, 0.0] = list(range(count, count + 3))
            yield partial(expand, lowpass(t, dt_s, tau))
            count += 3
        for samples, spacing_s in windows:
            first = count
            steps = max(1, round(spacing_s / dt_s))
            for newest, oldest in itertools.pairwise(choose_ages(samples)):
                back = [age * steps for age in range(newest + 1, oldest + 1)]
                yield partial(expand_mean, back)
                count += 3
            self._index["window", float(samples), spacing_s] = list(range(first, count))
        self._width = count
        yield lambda rows: list((run.measured[rows] - run.reference[rows])[:, self.outputs].T)

    def _form_products(self, tables: Sequence[Array]) -> None:
        """Form the sums of products, each run without its mean, since a log may be tared."""
        parts = [
            np.concatenate(
                [rows for rows, run in zip(tables, self.runs, strict=True) if run.group == group]
            )
            for group in self.groups
        ]
        for part in parts:
            np.subtract(part, part.mean(axis=0), out=part)
        if len(parts) == 1:
            parts = np.array_split(parts[0], BLOCKS)
        self.samples = np.array([float(len(part)) for part in parts])
        self.products = np.stack([part.T @ part for part in parts])
        self.scale = np.ones(len(self.outputs))
        plain = self.score([])
        scale = self.samples @ plain / self.samples.sum()
        self.scale = np.where(scale > 0.0, scale, 1.0)


def average(take: TakeColumns, samples: int, block: int) -> Array:
    """Return the means [m, J] of columns over blocks of samples, what is left at the end dropped.

    The columns are made a few rows at a time, so they may be many; each block's samples are added
    in their order, so the result is the same, bit for bit, however many.

    Args:
        take: makes the columns.
        samples: rows of the run.
        block: samples in a block.
    """
    at_once = max(1, ROWS_AT_ONCE // block) * block
    whole = samples // block * block
    means = []
    for start in range(0, max(whole, 1), at_once):
        columns = np.stack(take(slice(start, min(start + at_once, whole))))
        by_place = columns.reshape(len(columns), -1, block).transpose(2, 1, 0)
        means.append(np.add.accumulate(by_place, axis=0)[-1] / block)
    return np.concatenate(means)


def _look_back(t: Array, rows: slice, back: Sequence[int]) -> Array:
    """Return the mean of a signal so many samples before each row; before the first it stood."""
    at = np.arange(rows.start, rows.stop)
    total = t[np.maximum(at - back[0], 0)]
    for steps in back[1:]:
        total += t[np.maximum(at - steps, 0)]
    return np.asarray(total / len(back))


def pool(squares: Array, samples: Array) -> float:
    """Return the RMSE of mean squares [G, K] of runs of so many samples [G]."""
    return float(np.sqrt(samples @ squares.mean(axis=1) / samples.sum()))


def choose_ages(samples: int) -> list[int]:
    """Return the ages between which a window's earlier samples are averaged; the first is 0.

    A short window keeps each sample, a long one fewer means the older they are.
    """
    if samples - 1 <= MOST_TAPS:
        return list(range(samples))
    return [0, *sorted({round(float(k)) for k in np.geomspace(1.0, samples - 1.0, MOST_TAPS)})]


def find_time_constants(table: MemoryTable) -> tuple[TimeConstant, ...]:
    """Return the lags that runs left out call for, the one that gains most first.

    One lag after the other is added where it gains most; those before it are then moved to where
    they do best beside it. A lag that does not help in most runs ends the search.
    """
    chosen: list[float] = []
    gains: list[float] = []
    before = table.score([])
    for _ in range(MOST_LAGS):
        trial = _settle(table, [*chosen, _find_best(table, chosen)])
        after = table.score(table.lags(trial))
        gain = pool(after, table.samples) / max(pool(before, table.samples), 1e-300)
        agreeing = float(np.mean(after.mean(axis=1) < before.mean(axis=1)))
        if gain > EARNS_ITS_PLACE or agreeing < MOST_RUNS:
            break
        chosen, before = trial, after
        gains.append(gain)
    return tuple(
        _bound(table, chosen, i, gain) for i, gain in zip(range(len(chosen)), gains, strict=True)
    )


def _find_best(table: MemoryTable, others: Sequence[float]) -> float:
    """Return the time constant of the grid that does best beside others."""
    free = [tau for tau in table.grid if tau not in others]
    return min(free, key=lambda tau: table.rmse(table.lags([*others, tau])))


def _settle(table: MemoryTable, taus_s: Sequence[float]) -> list[float]:
    """Return the time constants after each was moved, in turn, to where it does best."""
    settled = list(taus_s)
    for _ in range(3):
        before = list(settled)
        for i in range(len(settled) if len(settled) > 1 else 0):
            settled[i] = _find_best(table, [*settled[:i], *settled[i + 1 :]])
        if settled == before:
            break
    return settled


def _bound(table: MemoryTable, taus_s: Sequence[float], i: int, gain: float) -> TimeConstant:
    """Return a time constant with the range in which the logs hardly tell it from others."""
    others = [tau for j, tau in enumerate(taus_s) if j != i]
    without = table.rmse(table.lags(others)) ** 2
    squares = {
        tau: table.rmse(table.lags([*others, tau])) ** 2 for tau in table.grid if tau not in others
    }
    best = squares[taus_s[i]]
    alike = [t for t, s in squares.items() if s - best <= TOLD_APART * max(without - best, 0.0)]
    return TimeConstant(
        tau_s=taus_s[i],
        low_s=min(alike),
        high_s=max(alike),
        gain=gain,
        at_limit=max(alike) >= table.grid[-1],
    )
