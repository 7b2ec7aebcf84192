"""How long the drift remembers the temperature, found from the logs by linear models of it.

Every model here is a table of columns that are linear in unknown coefficients: a polynomial in the
chip's temperature x, the loads and other channels, and for a memory the differences d between
what a slower body or an earlier sample has and what the chip has now, each as d, x d and x^2 d.
All of them are judged alike: each run by the model of the others. The sums of products of all
columns are formed once; a model is a choice of columns.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.live import find_live

Array = NDArray[np.float64]

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
            columns = self._build(run, thermometers, windows, (*self.grid, *lags_s))
            rows = np.concatenate([columns, run.drift[:, self.outputs]], axis=1)
            whole = len(rows) // blocks * blocks
            tables.append(rows[:whole].reshape(-1, blocks, rows.shape[1]).mean(axis=1))
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

    def _add(self, key: tuple[str, float, float], columns: list[Array], new: list[Array]) -> None:
        self._index[key] = list(range(len(columns), len(columns) + len(new)))
        columns += new

    def _build(
        self,
        run: Run,
        thermometers: Sequence[str],
        windows: Sequence[tuple[int, float]],
        lags_s: Sequence[float],
    ) -> Array:
        """Return the columns [n, J] of a run, and note where each model has its own."""
        t, dt_s = run.temperature_degC, self.sample_period_s
        x = (t - self._mean) / self._spread

        def expand(d: Array) -> list[Array]:
            d = d / self._spread
            return [d, x * d, x**2 * d]

        base = [x**power for power in range(1, DEGREE + 1)]
        for k in range(run.reference.shape[1]):
            if any(np.ptp(other.reference[:, k]) > 0.0 for other in self.runs):
                load = run.reference[:, k]
                base += [load, x * load]
        for name in (n for n in run.inputs if n != "clock"):
            if name in thermometers:
                base += expand(run.inputs[name] - t)
            elif all(name in other.inputs for other in self.runs):
                base.append(run.inputs[name])
        self._base = list(range(len(base)))
        columns = list(base)
        for tau in dict.fromkeys(lags_s):
            self._add(("lag", tau, 0.0), columns, expand(lowpass(t, dt_s, tau) - t))
        for samples, spacing_s in windows:
            steps = max(1, round(spacing_s / dt_s))
            new: list[Array] = []
            ages = choose_ages(samples)
            for newest, oldest in itertools.pairwise(ages):
                back = [age * steps for age in range(newest + 1, oldest + 1)]
                earlier = np.concatenate([np.full(back[-1], t[0]), t])
                starts = [earlier[back[-1] - b : back[-1] - b + len(t)] for b in back]
                new += expand(np.mean(starts, axis=0) - t)
            self._add(("window", float(samples), spacing_s), columns, new)
        self._width = len(columns)
        return np.stack(columns, axis=1)

    def _form_products(self, tables: Sequence[Array]) -> None:
        """Form the sums of products, each run without its mean, since a log may be tared."""
        parts = [
            np.concatenate(
                [rows for rows, run in zip(tables, self.runs, strict=True) if run.group == group]
            )
            for group in self.groups
        ]
        parts = [part - part.mean(axis=0) for part in parts]
        if len(parts) == 1:
            parts = np.array_split(parts[0], BLOCKS)
        self.samples = np.array([float(len(part)) for part in parts])
        self.products = np.stack([part.T @ part for part in parts])
        self.scale = np.ones(len(self.outputs))
        plain = self.score([])
        scale = self.samples @ plain / self.samples.sum()
        self.scale = np.where(scale > 0.0, scale, 1.0)


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
