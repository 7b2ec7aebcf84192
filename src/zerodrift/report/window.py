"""What part of a run is shown, in which unit of time, reduced to few points, and where."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, overload

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.dataset.units import is_unix, write_local

if TYPE_CHECKING:
    from zerodrift.report.findings import Trace


# Where the panes of the cause picture stand, before anything is known that is drawn in them.

MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 62.0, 12.0, 26.0, 42.0
GAP = 27.0
"""Pixels between panes, for their headings."""
TALL, LOW = 128.0, 74.0
"""Pixels of a pane of drift, and of one of a channel."""
WIDE = 860.0
"""Pixels from which on the scatter stands beside the panes and not below."""
SHARE_OF_PANES = 0.6
NARROW = 560.0
"""Pixels below which a pane's title stands above its legend."""
STACKED = 17.0


@dataclass(frozen=True)
class CauseGeometry:
    """Places in pixels of the picture."""

    panes: tuple[tuple[float, float], ...]
    """Top and height of each, from top to bottom."""
    width: float
    """Of each pane, from `MARGIN_LEFT` on."""
    scatter: tuple[float, float, float, float]
    """Left, top, width and height."""
    bottom: float
    """Height of the whole picture."""
    is_narrow: bool
    """Whether titles stand above legends."""


def lay_out_cause(tall: Sequence[bool], width: float) -> CauseGeometry:
    """Return where everything stands.

    Args:
        tall: for each pane whether it shows the drift, or else a channel.
        width: of the whole picture; from `WIDE` on the scatter stands beside the panes.
    """
    is_wide = width >= WIDE
    room = SHARE_OF_PANES * width if is_wide else width
    inner = room - MARGIN_LEFT - MARGIN_RIGHT
    is_narrow = inner < NARROW
    gap = GAP + (STACKED if is_narrow else 0.0)
    top = MARGIN_TOP + (STACKED if is_narrow else 0.0)
    panes = []
    for is_tall in tall:
        height = TALL if is_tall else LOW
        panes.append((top, height))
        top += height + gap
    bottom = top - gap + MARGIN_BOTTOM
    if is_wide:
        left, side = room + MARGIN_LEFT, width - room - MARGIN_LEFT - MARGIN_RIGHT
        above = MARGIN_TOP + 2.0 * STACKED
        scatter = (left, above, side, bottom - MARGIN_BOTTOM - above)
    else:
        scatter = (MARGIN_LEFT, bottom + GAP + 2.0 * STACKED, inner, max(0.62 * inner, 200.0))
        bottom = scatter[1] + scatter[3] + MARGIN_BOTTOM
    return CauseGeometry(tuple(panes), inner, scatter, bottom, is_narrow)


# Reduces lines of many samples to few points: least and largest value of each step.

MOST_POINTS = 1200
"""Points of a line; more samples than that are drawn as the least and largest of each step."""


def pick_rows(y: Array, start: int, stop: int, most: int = MOST_POINTS) -> IntArray:
    """Return the rows of y[start:stop] that make a line of at most `most` points look the same.

    Args:
        y: [n] the line.
        start: first row.
        stop: one past the last row.
        most: points that may be kept; at least 4.

    Returns:
        Rows in order, the first and the last among them. Where all fit, all of them; else for each
        step that of the least and that of the largest value, so that no peak is lost.
    """
    count = stop - start
    if count <= most:
        return np.arange(start, stop)
    steps = max((most - 2) // 2, 1)
    size = -(-count // steps)
    whole = count // size
    blocks = np.asarray(y[start : start + whole * size]).reshape(whole, size)
    base = start + size * np.arange(whole)
    rows = [base + blocks.argmin(axis=1), base + blocks.argmax(axis=1), [start, stop - 1]]
    if whole * size < count:
        tail = np.asarray(y[start + whole * size : stop])
        first = start + whole * size
        rows.append([first + int(tail.argmin()), first + int(tail.argmax())])
    return np.unique(np.concatenate([np.asarray(r, dtype=np.int64) for r in rows]))


def pick_spread(count: int, most: int) -> IntArray:
    """Return at most `most` rows out of `count`, evenly spread, for clouds of points."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)


# What part of a run is shown, and in which unit of time.


@dataclass(frozen=True)
class Window:
    """What part of one run is shown."""

    run: str
    from_s: float | None = None
    """On the log's own clock; None: from its start."""
    to_s: float | None = None


@dataclass(frozen=True)
class TimeAxis:
    """The unit of a time axis, and where it begins."""

    unit: str
    seconds: float
    """One unit."""
    from_s: float = 0.0
    """Zero of the axis on the log's clock: a clock of dates is told from the run's first row."""

    @property
    def title(self) -> str:
        """What stands below the axis."""
        since = f"since {write_local(self.from_s)}" if self.from_s else "on the log's clock"
        return f"time {since}, {self.unit}"

    @overload
    def place(self, time_s: float) -> float: ...
    @overload
    def place(self, time_s: Array) -> Array: ...
    def place(self, time_s: float | Array) -> float | Array:
        """Return where times on the log's clock lie."""
        return (time_s - self.from_s) / self.seconds


HOURS = TimeAxis("h", 3600.0)
CLOCKS = (TimeAxis("s", 1.0), TimeAxis("min", 60.0), HOURS)
LONGEST_IN_UNITS = 300.0


def choose_clock(trace: "Trace") -> TimeAxis:
    """Return the unit in which a run's time reads best, and its zero."""
    return choose_axis(float(trace.time_s[0]), float(trace.time_s[-1]))


def choose_axis(first_s: float, last_s: float) -> TimeAxis:
    """Return the unit in which a stretch of time reads best, and its zero."""
    length_s = last_s - first_s
    axis = next((c for c in CLOCKS if length_s <= LONGEST_IN_UNITS * c.seconds), HOURS)
    return replace(axis, from_s=first_s) if is_unix(first_s) else axis


def find_rows(trace: "Trace", window: Window) -> tuple[int, int]:
    """Return the rows of the part that is shown, one more on each side."""
    if window.from_s is None or window.to_s is None:
        return 0, trace.time_s.size
    first = int(np.searchsorted(trace.time_s, window.from_s)) - 1
    last = int(np.searchsorted(trace.time_s, window.to_s)) + 1
    first = min(max(first, 0), trace.time_s.size - 2)
    return first, min(max(last, first + 2), trace.time_s.size)
