"""What part of a run is shown, and in which unit of time."""

from dataclasses import dataclass

import numpy as np

from zerodrift.report.findings import Trace


@dataclass(frozen=True)
class Window:
    """What part of one run is shown."""

    run: str
    from_s: float | None = None
    """On the log's own clock; None: from its start."""
    to_s: float | None = None


@dataclass(frozen=True)
class TimeAxis:
    """The unit of a time axis."""

    unit: str
    seconds: float
    """One unit."""


HOURS = TimeAxis("h", 3600.0)
CLOCKS = (TimeAxis("s", 1.0), TimeAxis("min", 60.0), HOURS)
LONGEST_IN_UNITS = 300.0


def choose_clock(trace: Trace) -> TimeAxis:
    """Return the unit in which a run's time reads best."""
    length_s = float(trace.time_s[-1] - trace.time_s[0])
    return next((c for c in CLOCKS if length_s <= LONGEST_IN_UNITS * c.seconds), HOURS)


def find_rows(trace: Trace, window: Window) -> tuple[int, int]:
    """Return the rows of the part that is shown, one more on each side."""
    if window.from_s is None or window.to_s is None:
        return 0, trace.time_s.size
    first = int(np.searchsorted(trace.time_s, window.from_s)) - 1
    last = int(np.searchsorted(trace.time_s, window.to_s)) + 1
    first = min(max(first, 0), trace.time_s.size - 2)
    return first, min(max(last, first + 2), trace.time_s.size)
