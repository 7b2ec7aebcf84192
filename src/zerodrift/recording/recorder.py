"""Takes readings from a source, makes rows of them, and keeps the rows through a kill."""

import io
import json
import math
import os
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import polars as pl

from zerodrift.base.errors import InputError
from zerodrift.base.files import telling_of_writes, write_whole
from zerodrift.recording.coverage import Coverage, Covered
from zerodrift.recording.sources import LiveSource, Reading, Values, now_s

# A log that survives a kill: rows go to a journal first, from time to time all to Parquet.
#
# Beside `NAME.parquet` lies `.NAME.parquet.rows`, a line of JSON for each row: its number and its
# values. The Parquet file is replaced as a whole; rows that it lacks are in the journal. Whatever
# ends the process, `recover` returns every row except those of the last second.

SYNC_S = 1.0
"""Between two waits for the disk."""
WHOLE_S = 20.0
"""Between two writings of the whole file, at least."""
SHARE = 30.0
"""Writing the whole file takes at most one second of so many."""


def name_journal(path: Path) -> Path:
    """Return the path of the journal, which has the rows that a log may lack."""
    return path.with_name(f".{path.name}.rows")


class Keeper:
    """Keeps the rows of one log.

    Args:
        path: of the log; must end in .parquet and not exist yet.

    Raises:
        InputError: it exists, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix != ".parquet":
            raise InputError(f"--out {path}: expected a name that ends in .parquet.")
        if name_journal(path).exists():
            raise InputError(
                f"{path}: a recording of that name was cut off; expected none. "
                f"Run: zerodrift record --recover {path}"
            )
        if path.exists():
            raise InputError(f"--out {path}: is there already; expected a new name.")
        self.path = path
        self._rows = _KeptRows()
        with telling_of_writes(name_journal(path)):
            self._journal: TextIO = name_journal(path).open("x", encoding="utf-8")
        hold_file(self._journal)
        self._synced_s = self._whole_s = time.monotonic()
        self._pause_s = WHOLE_S

    @property
    def rows(self) -> int:
        """The number of rows."""
        return self._rows.count

    def add(self, values: Values) -> None:
        """Keep one row.

        Raises:
            InputError: it cannot be written to the disk.
        """
        with telling_of_writes(name_journal(self.path)):
            self._journal.write(_write_line(self._rows.count, values))
        self._rows.add(values)

    def settle(self) -> None:
        """Flush to the disk, if it is due; call it about every tenth of a second."""
        now_s = time.monotonic()
        if now_s - self._synced_s >= SYNC_S:
            self._sync()
            self._synced_s = now_s
        if now_s - self._whole_s >= self._pause_s and self._rows.count:
            self._write()
            self._whole_s = time.monotonic()
            self._pause_s = max(WHOLE_S, SHARE * (self._whole_s - now_s))

    def __enter__(self) -> "Keeper":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the whole file and take the journal away; without rows, leave nothing."""
        self._sync()
        if self._rows.count:
            write_whole(self.path, self._rows.render())
        self._journal.close()
        name_journal(self.path).unlink(missing_ok=True)

    def _sync(self) -> None:
        with telling_of_writes(name_journal(self.path)):
            self._journal.flush()
            os.fsync(self._journal.fileno())

    def _write(self) -> None:
        """Write the whole file, then begin the journal again; a kill between leaves both."""
        self._sync()
        write_whole(self.path, self._rows.render())
        with telling_of_writes(name_journal(self.path)):
            self._journal.seek(0)
            self._journal.truncate()


def hold_file(file: TextIO) -> bool:
    """Hold a journal as long as it is open; return whether nobody else does."""
    try:
        import fcntl
    except ImportError:  # not on Windows
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True


class _KeptRows:
    """Columns in memory, eight bytes a value; a column that comes later is empty before."""

    def __init__(self) -> None:
        self.count = 0
        self._columns: dict[str, array[float]] = {}

    def add(self, values: Values) -> None:
        for name in [name for name in values if name not in self._columns]:
            self._columns[name] = array("d", [math.nan]) * self.count
        for name, column in self._columns.items():
            column.append(values.get(name, math.nan))
        self.count += 1

    def render(self) -> bytes:
        frame = pl.DataFrame(
            {name: pl.Series(column, dtype=pl.Float64) for name, column in self._columns.items()}
        ).fill_nan(None)
        content = io.BytesIO()
        frame.write_parquet(content)
        return content.getvalue()


def recover(path: Path) -> int:
    """End a recording that was cut off; return how many rows the log has now.

    Raises:
        InputError: there is none of that name, or it is still being recorded.
    """
    journal = name_journal(path)
    if not journal.exists():
        what = "is whole" if path.exists() else "there is no recording of that name"
        raise InputError(f"--recover {path}: {what}; expected one that was cut off.")
    with telling_of_writes(journal), journal.open(encoding="utf-8", errors="replace") as lines:
        if not hold_file(lines):
            raise InputError(
                f"--recover {path}: is still being recorded; expected a recording that was cut "
                "off. End it with Ctrl-C where it was started."
            )
        rows = _read_rows(path, lines)
        if rows.count:
            write_whole(path, rows.render())
    journal.unlink()
    return rows.count


def _read_rows(path: Path, lines: TextIO) -> _KeptRows:
    """Return the rows of a log, and those that its journal has beyond them."""
    rows = _KeptRows()
    if path.exists():
        frame = pl.read_parquet(path)
        for row in frame.iter_rows(named=True):
            rows.add({name: math.nan if value is None else value for name, value in row.items()})
    for line in lines:
        if not line.endswith("\n"):
            break  # the one that was being written
        number, values = json.loads(line)
        if number >= rows.count:
            rows.add({n: math.nan if v is None else v for n, v in values.items()})
    return rows


def _write_line(number: int, values: Values) -> str:
    plain = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return json.dumps([number, plain]) + "\n"


# Takes readings from a source, makes rows of them, and keeps the rows.

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
