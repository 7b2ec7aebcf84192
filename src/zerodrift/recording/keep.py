"""A log that survives a kill: rows go to a journal first, from time to time all to Parquet.

Beside `NAME.parquet` lies `.NAME.parquet.rows`, a line of JSON for each row: its number and its
values. The Parquet file is replaced as a whole; rows that it lacks are in the journal. Whatever
ends the process, `recover` returns every row except those of the last second.
"""

import io
import json
import math
import os
import time
from array import array
from pathlib import Path
from typing import TextIO

import polars as pl

from zerodrift.base.errors import InputError
from zerodrift.base.files import telling_of_writes, write_whole
from zerodrift.recording.lines import Values

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
