"""How often a log has rows, and how it is brought to the firmware's period."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array

# How often a log has rows: one cadence, one that changes, or bursts with pauses between.

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


# Brings a log to the firmware's period, stretch by stretch between its gaps.
#
# Convention: a sample counts until the next one arrives, as in the chip, and the value of step k is
# the mean over the period that ends at t_k. So the filter is causal: a step holds nothing that was
# recorded after t_k. Ten samples to a period become exactly their mean.
#
# A log that has the period already is passed through bit for bit. One that has it except for jitter
# or a lost row is interpolated linearly, which looks ahead by less than one row.

MIN_STEPS = 10
"""A stretch with fewer steps is dropped: no filter has settled by then."""
GAP_PERIODS = 3.0
"""An interval of more than this many median periods (and of more than one step) is a gap."""
KEPT_TOLERANCE = 0.01
"""Time stamps within this share of a step of the uniform grid are taken as uniform."""
AVERAGED_BELOW = 0.9
"""A log whose period is a smaller share of the step is averaged; else it is interpolated."""


@dataclass(frozen=True)
class Stretch:
    """Rows `start` to `stop` of a log without a gap, and how they become steps."""

    start: int
    stop: int
    method: str
    """kept | averaged | interpolated."""
    time_s: Array
    """[steps] uniform times on the log's own clock."""
    source_time_s: Array
    """The rows' own times; a view of the log's."""
    averager: "Averager | None"
    """Set when the method is `averaged`."""
    bursts: NDArray[np.intp] | None = None
    """First row, from `start` on, of each burst that is taken as its mean; None: there are none."""

    @property
    def steps(self) -> int:
        """The number of steps that the rows become."""
        return int(self.time_s.size)

    def resample(self, values: Array) -> Array:
        """Return a column of the log (all of its rows) as [steps] values of this stretch."""
        rows = values[self.start : self.stop]
        if self.bursts is not None:
            rows = average_bursts(rows, self.bursts)
        if self.averager is not None:
            return self.averager.average(rows)
        if self.method == "kept":
            return rows
        return np.interp(self.time_s, self.source_time_s, rows)


@dataclass(frozen=True)
class Averager:
    """The means of samples over periods, planned once and applied to every column.

    Each sample counts until the next one; a sample in force at the end of a period counts for each
    side by its share.
    """

    width_s: Array
    """[n] time in s for which each sample counts."""
    in_force: NDArray[np.intp]
    """[steps + 1] the sample in force at the edge of each period."""
    since_s: Array
    """[steps + 1] for how long it has been in force there, in s."""
    period_s: float

    def average(self, values: Array) -> Array:
        """Return the [steps] means of [n] values.

        Exact for a constant; sums within each period only, so that a long log loses nothing to
        rounding.
        """
        origin = values[0]
        area = values - origin
        at_edge = self.since_s * area[self.in_force]
        area *= self.width_s
        # Whole samples from one edge to the next; what follows the last edge is left out.
        whole = np.add.reduceat(area, self.in_force)[:-1]
        whole[self.in_force[:-1] == self.in_force[1:]] = 0.0
        mean: Array = origin + (whole - at_edge[:-1] + at_edge[1:]) / self.period_s
        return mean


def plan_average(
    time_s: Array, last_width_s: float, step_time_s: Array, period_s: float
) -> Averager:
    """Plan the means over the period before each of `step_time_s`.

    Args:
        time_s: [n] rising times of the samples.
        last_width_s: for how long the last sample counts, in s.
        step_time_s: [steps] ends of the periods, one `period_s` apart, the first one period after
            `time_s[0]` or later, the last not after `time_s[-1] + last_width_s`.
        period_s: their length.
    """
    edges_s = np.append(step_time_s[0] - period_s, step_time_s)
    in_force = np.maximum(np.searchsorted(time_s, edges_s, side="right") - 1, 0)
    width_s = np.diff(time_s, append=time_s[-1] + last_width_s)
    return Averager(width_s, in_force, edges_s - time_s[in_force], period_s)


def average_bursts(rows: Array, bursts: NDArray[np.intp]) -> Array:
    """Return the means [b] of rows [n] that come in bursts; `bursts` [b] has their first rows."""
    counts = np.diff(bursts, append=rows.size)
    # About the first row, so that Unix times keep their digits.
    mean: Array = rows[0] + np.add.reduceat(rows - rows[0], bursts) / counts
    return mean


def find_gaps(time_s: Array, median_period_s: Array | float, sample_period_s: float) -> list[int]:
    """Return the rows after which the log is interrupted.

    Args:
        time_s: [n] rising times.
        median_period_s: the usual interval in s, one for all or one around each [n - 1].
        sample_period_s: the firmware's step.
    """
    limit_s = np.maximum(GAP_PERIODS * median_period_s, sample_period_s * (1 + KEPT_TOLERANCE))
    return [int(row) for row in np.flatnonzero(np.diff(time_s) > limit_s)]


def plan_stretches(
    time_s: Array, start: int, stop: int, sample_period_s: float
) -> tuple[list[Stretch], list[int]]:
    """Split rows `start` to `stop` at their gaps and choose how each part becomes steps.

    Args:
        time_s: rising times of the whole log.
        start: first row.
        stop: the row after the last.
        sample_period_s: the firmware's step.

    Returns:
        The stretches, the shortest of which may have any number of steps, and the rows after which
        a gap begins.
    """
    sampling = look_at_sampling(time_s[start:stop], sample_period_s)
    if sampling.bursts is not None:
        return _plan_bursts(time_s[start:stop], start, sampling.bursts, sample_period_s)
    own_s = np.diff(time_s[start:stop])
    median_s = float(np.median(own_s))
    usual_s = measure_neighbours(own_s, sampling)
    gaps = [start + row for row in find_gaps(time_s[start:stop], usual_s, sample_period_s)]
    bounds = [start, *(row + 1 for row in gaps), stop]
    stretches = [
        _plan_stretch(time_s[first:last], first, last, median_s, sample_period_s)
        for first, last in itertools.pairwise(bounds)
    ]
    return stretches, gaps


def _plan_bursts(
    time_s: Array, start: int, bursts: NDArray[np.intp], sample_period_s: float
) -> tuple[list[Stretch], list[int]]:
    """Plan the stretches of a run whose bursts are taken as their means; as `plan_stretches`."""
    mean_s = average_bursts(time_s, bursts)
    ends = np.append(bursts, time_s.size)
    median_s = float(np.median(np.diff(mean_s)))
    gaps = find_gaps(mean_s, median_s, sample_period_s)
    stretches = []
    for first, last in itertools.pairwise([0, *(row + 1 for row in gaps), mean_s.size]):
        plan = _plan_stretch(mean_s[first:last], first, last, median_s, sample_period_s)
        rows = start + int(ends[first]), start + int(ends[last])
        own = bursts[first:last] - bursts[first]
        stretches.append(replace(plan, start=rows[0], stop=rows[1], bursts=own))
    return stretches, [start + int(ends[row + 1]) - 1 for row in gaps]


def _plan_stretch(
    time_s: Array, start: int, stop: int, median_s: float, sample_period_s: float
) -> Stretch:
    if median_s < AVERAGED_BELOW * sample_period_s:
        # The last sample counts for a median period, as its successor would end it.
        steps = _count_periods(time_s[-1] - time_s[0] + median_s, sample_period_s)
        steps_s = _make_steps(float(time_s[0]) + sample_period_s, steps, sample_period_s)
        averager = plan_average(time_s, median_s, steps_s, sample_period_s) if steps else None
        return Stretch(start, stop, "averaged", steps_s, time_s, averager)
    uniform_s = _make_steps(float(time_s[0]), time_s.size, sample_period_s)
    off_s = time_s - uniform_s
    if max(off_s.max(), -off_s.min()) <= KEPT_TOLERANCE * sample_period_s:
        return Stretch(start, stop, "kept", uniform_s, time_s, None)
    steps = _count_periods(time_s[-1] - time_s[0], sample_period_s) + 1
    steps_s = _make_steps(float(time_s[0]), steps, sample_period_s)
    return Stretch(start, stop, "interpolated", steps_s, time_s, None)


def _count_periods(duration_s: float, sample_period_s: float) -> int:
    """Return how many whole periods fit; 0.3 s holds three of 0.1 s although 0.3 / 0.1 < 3."""
    return int(duration_s / sample_period_s + 1e-6)


def _make_steps(first_s: float, count: int, sample_period_s: float) -> Array:
    return first_s + sample_period_s * np.arange(count, dtype=np.float64)
