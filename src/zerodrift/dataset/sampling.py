"""How often a log has rows: one cadence, one that changes, or bursts with pauses between."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array

COARSEST = 1.5
"""A log whose period is more than this many steps holds too little to be brought to them."""
MIXED_RATIO = 1.5
"""Blocks of a run whose median intervals differ by more than this are of different cadences."""
MOST_BLOCKS = 64
NEIGHBOURS = 15
"""Intervals on either side by which a gap is judged where the cadence changes."""
PAUSE_RATIO = 5.0
"""A pause between bursts is so many times the interval within one, and more."""
FEWEST_BURSTS = 5
EVEN_BURSTS = 0.25
"""Bursts begin at even intervals if nine in ten of these are within this share of their median."""


@dataclass(frozen=True)
class Sampling:
    """How often rows come, of one run."""

    usual_s: float
    """The median interval in s; with bursts, from one burst to the next."""
    cadences: tuple[tuple[int, float], ...]
    """(first row, interval in s) of each part with an interval of its own; one for most logs."""
    bursts: NDArray[np.intp] | None = None
    """[b] first row of each burst; None: rows come one by one."""

    @property
    def slowest_s(self) -> float:
        """Return the longest of the cadences."""
        return max(period_s for _, period_s in self.cadences)

    @property
    def fastest_s(self) -> float:
        """Return the shortest of the cadences."""
        return min(period_s for _, period_s in self.cadences)


def look_at_sampling(time_s: Array, sample_period_s: float) -> Sampling:
    """Return how often rows come.

    Args:
        time_s: [n] rising times of one run, two or more.
        sample_period_s: the firmware's step; bursts that are farther apart are pieces of a log.
    """
    interval_s = np.diff(time_s)
    median_s = float(np.median(interval_s))
    bursts = _find_bursts(time_s, interval_s, median_s)
    if bursts is not None:
        usual_s = float(np.median(np.diff(time_s[bursts])))
        if usual_s <= COARSEST * sample_period_s:
            return Sampling(usual_s, ((0, usual_s),), bursts)
    return Sampling(median_s, _find_cadences(interval_s, median_s))


def measure_neighbours(interval_s: Array, sampling: Sampling) -> Array | float:
    """Return the interval that is usual around each one [n - 1], or everywhere."""
    if len(sampling.cadences) == 1:
        return sampling.usual_s
    padded = np.pad(interval_s, NEIGHBOURS, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    usual: Array = np.median(windows, axis=1)
    return usual


def _find_cadences(interval_s: Array, median_s: float) -> tuple[tuple[int, float], ...]:
    """Return the parts of different cadence, by medians of blocks.

    Medians are not moved by lost rows, gaps or jitter.
    """
    whole = ((0, median_s),)
    blocks = min(MOST_BLOCKS, max(2, interval_s.size // 64))
    if interval_s.size < 16 or interval_s.max() <= MIXED_RATIO * interval_s.min():
        return whole
    edges = np.linspace(0, interval_s.size, blocks + 1).astype(int)
    medians = np.array([np.median(interval_s[a:b]) for a, b in itertools.pairwise(edges)])
    if medians.max() <= MIXED_RATIO * medians.min():
        return whole
    parts = [(0, float(medians[0]))]
    for block in range(1, blocks):
        before_s, now_s = parts[-1][1], float(medians[block])
        if max(before_s, now_s) > MIXED_RATIO**0.5 * min(before_s, now_s):
            near = interval_s[edges[block - 1] : edges[block + 1]]
            # The change is where intervals are nearer to the second period from there on.
            is_second = np.abs(np.log(near / now_s)) < np.abs(np.log(near / before_s))
            score = np.cumsum(np.where(is_second, -1, 1))
            row = int(edges[block - 1]) + int(np.argmax(score)) + 2
            parts.append((max(row, parts[-1][0] + 1), now_s))
    return tuple(parts)


def _find_bursts(time_s: Array, interval_s: Array, median_s: float) -> NDArray[np.intp] | None:
    """Return the first row of each burst, or None where rows do not come in bursts."""
    if interval_s.max() <= PAUSE_RATIO * median_s:
        return None
    starts = np.concatenate([[0], np.flatnonzero(interval_s > PAUSE_RATIO * median_s) + 1])
    if starts.size < FEWEST_BURSTS or time_s.size < 2 * starts.size:
        return None
    between_s = np.diff(time_s[starts])
    off = np.abs(between_s / np.median(between_s) - 1)
    return starts if np.quantile(off, 0.9) <= EVEN_BURSTS else None
