"""Runs as the fit sees them: few rows of block means, columns for each thermometer and lag."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass, lowpass_slope
from zerodrift.train.front_end import read_source

Lag = tuple[int, float]
"""Place of the thermometer, time constant in seconds."""

MOST_ROWS = 5000
"""Rows of a fit; more samples than that are averaged block by block."""
DEGREE = 4
"""Powers of each thermometer and of each lag."""
BLOCKS = 5
"""A single run is left out in this many blocks of time."""
COVER = 0.05
"""A row counts as covered by the others up to this far beyond their range, in half spans."""
KEPT = 64
"""Filtered thermometers that are kept for another look."""


@dataclass(frozen=True)
class Scale:
    """Brings a thermometer to about -1 .. 1: u = (T - centre) / half_span."""

    centre: float
    """degC."""
    half_span: float
    """K."""


class BankData:
    """Training runs laid end to end.

    Args:
        runs: training runs.
        sources: thermometers, the chip's own first.
        others: [n, J] per run: further columns of the linear part (physics, loads).
        targets: [n, K] per run: what is to be explained.
        loaded: [n] per run: whether a load is on the sensor.
        logged: [n] per run: which samples were measured, and do not stand for a gap; empty: all.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        sources: Sequence[str],
        others: Sequence[Array],
        targets: Sequence[Array],
        loaded: Sequence[Mask],
        logged: Sequence[Mask] = (),
    ) -> None:
        self.dt_s = runs[0].sample_period_s
        self.sources = tuple(sources)
        ends = np.cumsum([0, *(len(run) for run in runs)])
        self.logged = tuple(logged or (np.ones(len(run), dtype=bool) for run in runs))
        """[n] per run: which samples were measured."""
        there = np.concatenate(self.logged)
        self._picked = None if there.all() else np.flatnonzero(there)
        follows = np.append(False, there[:-1])
        follows[ends[:-1]] = False
        first = np.flatnonzero(there & ~follows)  # samples that begin a stretch
        samples = int(there.sum())
        block = max(1, -(-samples // MOST_ROWS))
        edges = np.append(np.cumsum(there)[first] - 1, samples)
        starts = [np.arange(a, b, block) for a, b in pairwise(edges)]
        self._starts = np.concatenate(starts)
        self.begins = np.isin(self._starts, edges[:-1])
        """[m] rows that begin a stretch."""
        self.counts = np.diff(np.append(self._starts, samples)).astype(np.float64)
        """[m] samples behind each row."""
        names = list(dict.fromkeys(run.group for run in runs))
        owners = np.searchsorted(ends, first, side="right") - 1
        self.run_group = np.concatenate(
            [
                np.full(len(s), names.index(runs[i].group))
                for i, s in zip(owners, starts, strict=True)
            ]
        )
        """[m] run that a row belongs to; an offset of its own may belong to each."""
        self.group = self.run_group
        """[m] what is left out together: runs, or blocks of the only one."""
        if len(names) == 1:
            self.group = np.arange(len(self._starts)) * BLOCKS // len(self._starts)
        self.longest_s = max(len(run) for run in runs) * self.dt_s
        signals = [np.concatenate([read_source(run, s) for run in runs]) for s in sources]
        self.scales = tuple(_choose_scale(x) for x in signals)
        self._levels = [
            (x - s.centre) / s.half_span for x, s in zip(signals, self.scales, strict=True)
        ]
        self._runs = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._powers = [raise_all(x) for x in self._levels]
        self._filtered: dict[Lag, Array] = {}
        self.others = self.average(np.concatenate(others))
        self.targets = self.average(np.concatenate(targets))
        self.loaded = self.average(np.concatenate(loaded).astype(np.float64)) > 0.0

    def less(self, parts: Sequence[Array]) -> "BankData":
        """Return the same runs with these parts [n, K] per run taken off the targets."""
        again = copy.copy(self)
        again.targets = self.targets - self.average(np.concatenate(parts))
        return again

    @property
    def temperature_degC(self) -> Array:
        """[m] of the chip's own thermometer."""
        return self.average(self._levels[0]) * self.scales[0].half_span + self.scales[0].centre

    @property
    def groups(self) -> int:
        """Number of groups that are left out in turn."""
        return int(self.group.max()) + 1

    @cached_property
    def covered(self) -> Mask:
        """[m] rows whose temperatures the other groups have seen too.

        Only these rows are evaluated: rows beyond all other runs show how a model extrapolates,
        which a single run at the edge would decide alone.
        """
        covered = np.ones(len(self.group), dtype=bool)
        for x in self._levels:
            level = self.average(x)
            for g in range(self.groups):
                own = self.group == g
                low, high = level[~own].min() - COVER, level[~own].max() + COVER
                covered[own] &= (level[own] >= low) & (level[own] <= high)
        return covered

    def average(self, x: Array) -> Array:
        """Return the block means [m, ...] of samples [n, ...], those that were logged."""
        if self._picked is not None:
            x = x[self._picked]
        sums = np.add.reduceat(x, self._starts, axis=0)
        return np.asarray(sums / self.counts.reshape(-1, *[1] * (x.ndim - 1)))

    def _filter(self, lag: Lag) -> Array:
        """Return the scaled thermometer after a lag, [n]; every run starts at rest."""
        if lag not in self._filtered:
            if len(self._filtered) >= KEPT:
                self._filtered.pop(next(iter(self._filtered)))
            x = self._levels[lag[0]]
            self._filtered[lag] = np.concatenate(
                [lowpass(x[own], self.dt_s, lag[1]) for own in self._runs]
            )
        return self._filtered[lag]

    def level(self, source: int) -> Array:
        """Return the block means of u, u^2, ... of a thermometer, [m, DEGREE]."""
        return self.average(self._powers[source])

    def lag(self, lag: Lag) -> Array:
        """Return the block means of v - u, v^2 - u^2, ... of a lagged v, [m, DEGREE]."""
        return self.average(raise_all(self._filter(lag)) - self._powers[lag[0]])

    def lag_and_slope(self, lag: Lag) -> tuple[Array, Array]:
        """Return `lag` and its derivatives with respect to log tau, both [m, DEGREE]."""
        u, v = self._levels[lag[0]], self._filter(lag)
        slope = lag[1] * np.concatenate(
            [lowpass_slope(u[own], v[own], self.dt_s, lag[1]) for own in self._runs]
        )
        powers = raise_all(v)
        slopes = np.empty_like(powers)
        slopes[:, 0] = slope
        for p in range(1, DEGREE):
            np.multiply(powers[:, p - 1], (p + 1) * slope, out=slopes[:, p])
        return self.average(powers - self._powers[lag[0]]), self.average(slopes)


def raise_all(x: Array) -> Array:
    """Return x, x^2, ... of a signal [n], as columns [n, DEGREE]."""
    powers = np.empty((len(x), DEGREE))
    powers[:, 0] = x
    for p in range(1, DEGREE):
        np.multiply(powers[:, p - 1], x, out=powers[:, p])
    return powers


def _choose_scale(x: Array) -> Scale:
    low, high = float(x.min()), float(x.max())
    return Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-3))
