"""Takes readings from a source, makes rows of them, and keeps the rows."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from zerodrift.base.errors import InputError
from zerodrift.recording.coverage import Coverage, Covered
from zerodrift.recording.keep import Keeper
from zerodrift.recording.lines import Values
from zerodrift.recording.sources import LiveSource, Reading, now_s

POLL_S = 0.1
SILENT_S = 10.0
"""A source that says nothing for so long is told of."""
CLOCK = "clock_s"
"""Column of Unix time, beside the time since the first row."""
Show = Callable[[Covered, str], None]
"""Is given what is covered, and what to say of the source."""


@dataclass(frozen=True)
class RowRules:
    """How readings become rows.

    Args:
        time_column: seconds since the first row, unless the source sends a column of that name.
        period_s: of the rows in s, for sources that send parts.
        hold_s: for how many seconds a part counts where no newer one came.
        most_s: when to stop, in s; None: when asked to.
        until_enough: stop once all that is wanted is covered.
    """

    time_column: str = "time_s"
    period_s: float = 1.0
    hold_s: float = 5.0
    most_s: float | None = None
    until_enough: bool = False


class Recording:
    """Records one source into one log.

    Args:
        source: where readings come from.
        keeper: where rows go.
        coverage: follows them.
        rules: how readings become rows.
        clock: that of the readings, s.
    """

    def __init__(
        self,
        source: LiveSource,
        keeper: Keeper,
        coverage: Coverage,
        rules: RowRules,
        clock: Callable[[], float] = now_s,
    ) -> None:
        self._source, self._keeper, self._coverage, self._rules = source, keeper, coverage, rules
        self._now_s = clock
        self._start_s: float | None = None
        self._clock_s = 0.0 if source.has_times else time.time() - clock()
        self._parts: dict[str, tuple[float, float]] = {}
        self._next_s = math.inf
        self._last_time: float | None = None
        self.backwards = 0
        """Rows and readings left out because the source's own time ran backwards."""

    def run(self, show: Show, is_asked: Callable[[], bool] = lambda: False) -> bool:
        """Record until the source ends, enough is covered, or it is asked to end.

        Args:
            show: is given the recording so far, about ten times a second.
            is_asked: whether to end now; asked between rows, so that none is kept by half.

        Returns:
            Whether it was asked to end, by Ctrl-C or by the system.

        Raises:
            InputError: the source or the disk failed; the rows before are kept.
        """
        heard_s = began_s = self._now_s()
        try:
            while not is_asked():
                readings = self._source.read(POLL_S)
                if readings is None:
                    self._tick(math.inf)
                    return False
                if readings:
                    heard_s = self._now_s()
                for reading in readings:
                    self._take(reading)
                if not self._source.has_times:
                    self._tick(self._now_s())
                self._keeper.settle()
                covered = self._coverage.describe()
                show(covered, self._explain_silence(self._now_s() - heard_s, began_s))
                if self._rules.most_s is not None and self._now_s() - began_s >= self._rules.most_s:
                    return False
                if self._rules.until_enough and covered.enough:
                    return False
        except KeyboardInterrupt:  # asked twice: something does not return
            pass
        return True

    def _explain_silence(self, silent_s: float, began_s: float) -> str:
        """Return that nothing comes, and what is waited for; nothing within the first seconds."""
        parts = [f"nothing for {silent_s:.0f} s"] if silent_s >= SILENT_S else []
        if self._now_s() - began_s >= SILENT_S:
            parts.append(self._source.explain_wait())
        return "; ".join(part for part in parts if part)

    def _take(self, reading: Reading) -> None:
        if self._source.is_rows:
            self._keep(reading.at_s, reading.values)
            return
        if self._next_s == math.inf:
            self._next_s = reading.at_s + self._rules.period_s
        if reading.at_s < self._next_s - self._rules.period_s - self._rules.hold_s:
            self.backwards += 1
            return
        self._tick(reading.at_s)
        self._parts |= {name: (reading.at_s, v) for name, v in reading.values.items()}

    def _tick(self, now: float) -> None:
        """Make the rows that are due: the newest part of each column that is not too old."""
        if self._source.is_rows or self._next_s == math.inf:
            return
        if now == math.inf:
            now = self._next_s
        while self._next_s <= now:
            oldest = self._next_s - self._rules.hold_s
            fresh = {n: value for n, (at, value) in self._parts.items() if at >= oldest}
            if fresh:
                self._keep(self._next_s, {n: fresh.get(n, math.nan) for n in self._parts})
                self._next_s += self._rules.period_s
            else:  # nothing counts until the next part comes: no step for each period till then
                steps = math.ceil((now - self._next_s) / self._rules.period_s)
                self._next_s += max(steps, 1) * self._rules.period_s

    def _keep(self, at_s: float, values: Values) -> None:
        if self._start_s is None:
            self._start_s = at_s
        name = self._rules.time_column
        row = dict(values)
        if name in row:
            if not math.isfinite(row[name]) or (
                self._last_time is not None and row[name] <= self._last_time
            ):
                self.backwards += 1
                return
            self._last_time = row[name]
        else:
            row = {name: round(at_s - self._start_s, 6)} | row
            row.setdefault(CLOCK, round(at_s + self._clock_s, 6))
        self._keeper.add(row)
        self._coverage.add(at_s - self._start_s, values)


def check_rules(rules: RowRules) -> None:
    """Refuse rules that contradict each other.

    Raises:
        InputError: a row would hold nothing.
    """
    if rules.hold_s < rules.period_s:
        raise InputError(
            f"--hold {rules.hold_s:g}: is shorter than the period of {rules.period_s:g} s, so that "
            "rows would lack what came; expected at least the period."
        )
