"""A live sensor's rows become steps at the model's sample period, without looking ahead.

The convention is that of logs (dataset/resample.py). Rows that come faster than the period are
averaged: a row counts until the next one, and a step is the mean over the period that ends at it.
Rows at the period are a step each, jitter or not. Slower ones are held until the next row, where a
log would be interpolated, which nobody can before the next row is there.
"""

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.resample import AVERAGED_BELOW

SLOW_ABOVE = 1.1
"""Rows whose interval is a larger share of the period are said to be slow."""
LOOKED_AT = 5
"""Intervals between rows, after which the way to steps is chosen."""
MOST_HELD = 100
"""Steps for which one row is held at most; a longer silence is left out."""
REMEMBERED = 60
"""Intervals of which the median is told."""
ENDED = 1e-6
"""Of a period: ten rows of 0.1 s fill one of 1 s, although their times are rounded."""


class LiveSteps:
    """Makes steps of rows, in the order in which they come.

    Args:
        period_s: of the model.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._waiting: list[tuple[float, Array]] = []
        """Rows that came before the way was chosen."""
        self._intervals: list[float] = []
        self._averages: bool | None = None
        """Whether rows are averaged; None: not known yet."""
        self._start_s = 0.0
        self._steps = 0
        """Of the present stretch, which began at `start`."""
        self._last: tuple[float, Array] | None = None
        self._area = np.zeros(0)
        self._width_s = np.zeros(0)
        """Of the mean so far, for each column: values times seconds, and seconds with a value."""
        self._left_out = 0

    def add(self, at_s: float, values: Array) -> list[Array]:
        """Take a row [n] of values at a time in s; return the steps that it finishes.

        A time that does not rise begins anew: the device has begun again.
        """
        before = self._waiting[-1] if self._waiting else self._last
        if before is not None:
            if at_s <= before[0]:
                self._waiting, self._last = [], None
            else:
                self._intervals = [*self._intervals[1 - REMEMBERED :], at_s - before[0]]
        if self._averages is None:
            self._waiting.append((at_s, values))
            if len(self._intervals) < LOOKED_AT:
                return []
            self._averages = self.interval_s < AVERAGED_BELOW * self._period_s
            rows, self._waiting = self._waiting, []
        else:
            rows = [(at_s, values)]
        return [step for row in rows for step in self._take(*row)]

    @property
    def interval_s(self) -> float:
        """The usual interval between rows in s; NaN before the second."""
        return float(np.median(self._intervals)) if self._intervals else np.nan

    def explain(self) -> tuple[str, bool]:
        """Return how rows become steps, for people, and whether that is worth a warning."""
        share, period = self.interval_s / self._period_s, f"{self._period_s:.4g} s"
        parts = []
        if self._averages:
            parts.append(
                f"a row every {self.interval_s:.3g} s: each step is their mean over {period}"
            )
        elif share > SLOW_ABOVE:
            parts.append(
                f"a row every {self.interval_s:.3g} s, slower than the model's period of {period}: "
                "each is held until the next; send them faster"
            )
        if self._left_out:
            parts.append(f"{self._left_out} silences of more than {MOST_HELD} steps left out")
        return "; ".join(parts), bool(self._left_out) or share > SLOW_ABOVE

    def _take(self, at_s: float, values: Array) -> list[Array]:
        if self._last is None:
            self._begin(at_s, values)
            return [] if self._averages else self._give(values)
        if at_s - self._last[0] > MOST_HELD * self._period_s:
            self._left_out += 1
            self._begin(at_s, values)
            return [] if self._averages else self._give(values)
        found = self._average_until(at_s) if self._averages else self._hold_until(at_s, values)
        self._last = (at_s, values)
        return found

    def _begin(self, at_s: float, values: Array) -> None:
        self._start_s, self._steps, self._last = at_s, 0, (at_s, values)
        self._area, self._width_s = np.zeros(values.size), np.zeros(values.size)

    def _give(self, values: Array) -> list[Array]:
        self._steps += 1
        return [values]

    def _hold_until(self, at_s: float, values: Array) -> list[Array]:
        """Return the held steps before the one that is nearest to a row, and that one."""
        assert self._last is not None
        slot = round((at_s - self._start_s) / self._period_s)
        if slot < self._steps:  # this row's step has been given: two rows within half a period
            return []
        held = [self._last[1]] * (slot - self._steps)
        self._steps = slot + 1
        return [*held, values]

    def _average_until(self, at_s: float) -> list[Array]:
        """Return the means of the periods that end until a row, which the last row fills."""
        assert self._last is not None
        begin_s, values = self._last
        found: list[Array] = []
        while True:
            end_s = self._start_s + (self._steps + 1) * self._period_s
            is_whole = end_s <= at_s + ENDED * self._period_s
            width_s = max((min(end_s, at_s) if is_whole else at_s) - begin_s, 0.0)
            self._area = self._area + np.nan_to_num(values) * width_s
            self._width_s = self._width_s + np.isfinite(values) * width_s
            if not is_whole:
                return found
            with np.errstate(invalid="ignore", divide="ignore"):
                found.append(self._area / self._width_s)
            self._area, self._width_s = np.zeros(values.size), np.zeros(values.size)
            self._steps += 1
            begin_s = end_s
