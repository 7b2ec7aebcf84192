"""Reads the needed columns of one log, CSV or Parquet, as float64 arrays.

The first pass only parses: what is no number becomes NaN. Only when a check fails is the file read
a second time, by `zerodrift.dataset.locate`, for the line and the text of the offending row.
"""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import name_kind
from zerodrift.dataset.columns import GrowingColumns
from zerodrift.dataset.quotes import check_quotes
from zerodrift.dataset.runs import Array
from zerodrift.dataset.selectors import PARQUET_SUFFIXES

RUN_COLUMN = "run"
BATCH_ROWS = 100_000
SEPARATORS = (",", ";", "\t")
_MAX_HEADER_BYTES = 1 << 20
_SAMPLE_BYTES = 1 << 16
_SHOWN_NAMES = 12


@dataclass(frozen=True)
class Source:
    """One log and what of it is read; enough to read it again."""

    path: Path
    label: str
    """How messages name the file."""
    names: tuple[str, ...]
    """All column names, in order; unnamed ones get a name no config can hold."""
    separator: str | None
    """The character between CSV fields; None for Parquet."""
    where: Mapping[str, str]
    """Row filter: column -> value."""
    head_lines: int = 1
    """Lines before the first record of a CSV: the header and blank lines after it."""

    @property
    def is_csv(self) -> bool:
        """Tell CSV from Parquet."""
        return self.separator is not None

    def scan(self, numeric: Sequence[str] = ()) -> pl.LazyFrame:
        """Return the log as a lazy frame with the row filter applied and a `_row` column.

        `_row` counts from 0 within the file, before the filter. In a CSV the `numeric` columns are
        read as float64, null where they hold no number, and all others as text.
        """
        if self.is_csv:
            schema = {name: pl.Float64 if name in numeric else pl.String for name in self.names}
            frame = pl.scan_csv(
                self.path,
                separator=self.separator or ",",
                has_header=False,
                skip_lines=self.head_lines,
                schema=schema,
                ignore_errors=True,
                glob=False,
                row_index_name="_row",
            )
        else:
            frame = pl.scan_parquet(self.path, glob=False, row_index_name="_row")
        for column, value in self.where.items():
            frame = frame.filter(pl.col(column).cast(pl.String) == value)
        return frame


@dataclass
class Table:
    """The parsed columns of one log; columns are taken out one by one to keep the memory low."""

    source: Source
    columns: dict[str, Array]
    """Column -> [n]; NaN where the file holds no number."""
    runs: tuple[str, ...]
    """Names of the runs, in the order of appearance; empty without a `run` column."""
    run_of_row: NDArray[np.uint32] | None
    """[n] position in `runs`; None without a `run` column."""
    kept: NDArray[np.intp] | None = None
    """[n] position of each row among those read, once rows were left out; None = all, in order."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return next((int(column.size) for column in self.columns.values()), 0)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> None:
        """Keep only `rows` (positions or a mask), in that order."""
        kept = self.positions[rows]
        for name in self.columns:
            self.columns[name] = self.columns[name][rows]
        if self.run_of_row is not None:
            self.run_of_row = self.run_of_row[rows]
        self.kept = kept

    @property
    def positions(self) -> NDArray[np.intp]:
        """[n] where each row stood among those that were read."""
        return np.arange(len(self)) if self.kept is None else self.kept

    def position(self, row: int) -> int:
        """Return where `row` stood among the rows that were read, for `locate_row`."""
        return row if self.kept is None else int(self.kept[row])


def label_log(path: Path, directory: Path) -> str:
    """Return how messages name a log: relative to the project where it lies within."""
    return str(path.relative_to(directory)) if path.is_relative_to(directory) else str(path)


def open_source(path: Path, label: str, where: Mapping[str, str]) -> Source:
    """Read a log's column names.

    Raises:
        InputError: the file cannot be opened, is empty, is not UTF-8 or not Parquet, or names a
            column twice.
    """
    head = _read_head(path, label)
    if path.suffix.lower() in PARQUET_SUFFIXES:
        return Source(path, label, _read_parquet_names(path, label), None, where)
    if head.startswith(b"PAR1"):
        raise InputError(f"{label}: holds Parquet; expected CSV text. Name it {path.stem}.parquet.")
    line = head.split(b"\n", 1)[0].rstrip(b"\r")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(_explain_not_utf8(label, 1, line[error.start])) from error
    if not text.strip():
        raise InputError(f"{label}:1: the first line is blank; expected the columns' names there.")
    separator = max(SEPARATORS, key=text.count)
    names = split_fields(text, separator)
    if not names or "\0" in text:
        raise InputError(
            f"{label}:1: the first line is no line of text ({text[:40]!r}); expected the columns' "
            "names, and lines that end in a line feed. Save the log as CSV text."
        )
    if all(_is_number(name) for name in names):
        raise InputError(
            f"{label}:1: the first line holds numbers ({text[:40]}); expected the columns' names. "
            "Add a header line, with units in the names, such as time_s,temperature_degC,Fz_N."
        )
    counts = Counter(names)
    for name, count in counts.items():
        if name and count > 1:
            raise InputError(
                f"{label}:1: the header names column '{name}' {count} times; expected each name "
                "once. Rename one of them."
            )
    unique = tuple(name or f"\0unnamed{index}" for index, name in enumerate(names))
    return Source(path, label, unique, separator, where, _count_head_lines(head))


def read_table(source: Source, needed: Mapping[str, str], run_column: bool = True) -> Table:
    """Parse the needed columns of a log.

    Args:
        source: the log.
        needed: column -> where the config names it, for messages.
        run_column: whether a column named `run` splits the file.

    Raises:
        InputError: a column is missing or holds no numbers, rows have too many fields, the file is
            damaged or holds no row.
    """
    for column, role in [*needed.items(), *((name, "[logs] where") for name in source.where)]:
        if column not in source.names:
            raise InputError(_explain_missing_column(source, column, role))
    if source.separator is not None:
        check_quotes(source.path, source.label, source.separator)
    has_runs = run_column and RUN_COLUMN in source.names and RUN_COLUMN not in needed
    frame = source.scan(tuple(needed))
    wanted = [pl.col(column).cast(pl.Float64) for column in needed]
    wanted += [pl.col(RUN_COLUMN).cast(pl.String)] if has_runs else []
    columns = GrowingColumns([*needed, *([RUN_COLUMN] if has_runs else [])], _guess_rows(source))
    runs: dict[str, int] = {}
    try:
        schema = frame.collect_schema()
        for column in needed:
            _refuse_dtype(source, column, schema[column])
        for batch in _stream(frame.select(wanted)):
            columns.append(_encode_runs(batch, runs) if has_runs else batch)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(explain_unreadable(source, error)) from error
    if len(columns) == 0:
        raise InputError(_explain_no_rows(source))
    arrays = columns.finish()
    codes = arrays.pop(RUN_COLUMN).astype(np.uint32) if has_runs else None
    return Table(source, arrays, tuple(runs), codes)


def _stream(frame: pl.LazyFrame) -> Iterator[pl.DataFrame]:
    """Yield the frame's rows in batches, so that a log is never in memory twice.

    Polars calls `collect_batches` unstable; where it is missing, the frame comes in one piece.
    """
    if hasattr(frame, "collect_batches"):
        yield from frame.collect_batches(chunk_size=BATCH_ROWS)
    else:
        yield frame.collect()


def _encode_runs(batch: pl.DataFrame, runs: dict[str, int]) -> pl.DataFrame:
    """Replace the runs' names by their numbers in the order of first appearance."""
    column = batch[RUN_COLUMN].fill_null("")
    names = column.unique(maintain_order=True)
    codes = [runs.setdefault(name, len(runs)) for name in names]
    return batch.with_columns(column.replace_strict(names, codes, return_dtype=pl.Float64))


def _guess_rows(source: Source) -> int:
    """Return about how many rows the log holds, a little more rather than less."""
    if not source.is_csv:
        return int(pl.scan_parquet(source.path, glob=False).select(pl.len()).collect().item())
    size = source.path.stat().st_size
    with source.path.open("rb") as file:
        counts = []
        for share in (0.0, 0.5, 1.0):
            file.seek(int(share * max(0, size - _SAMPLE_BYTES)))
            counts.append(file.read(_SAMPLE_BYTES).count(b"\n"))
    return int(1.05 * max(counts) * max(1.0, size / _SAMPLE_BYTES)) + 1


def _read_head(path: Path, label: str) -> bytes:
    if path.exists() and not path.is_file():
        # A named pipe would be waited for, for ever.
        raise InputError(
            f"{label}: is {name_kind(path)}; expected a log, an ordinary file. Name the file that "
            "holds the rows."
        )
    try:
        with path.open("rb") as file:
            head = file.read(_MAX_HEADER_BYTES)
    except OSError as error:
        raise InputError(
            f"{label}: cannot be read ({error.strerror}); expected a file that this user may read. "
            "Check its permissions."
        ) from error
    if not head:
        raise InputError(
            f"{label}: the file is empty; expected a header line and rows. Copy it again, or take "
            "it out of [logs]."
        )
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{label}:1: the text is UTF-16; expected UTF-8. Save the log as UTF-8.")
    return head


def _count_head_lines(head: bytes) -> int:
    """Return the number of lines up to the first record: the parser takes a blank one for one."""
    lines = head.split(b"\n")[1:-1]
    blank = next((count for count, line in enumerate(lines) if line.strip()), len(lines))
    return 1 + blank


def _read_parquet_names(path: Path, label: str) -> tuple[str, ...]:
    try:
        return tuple(pl.scan_parquet(path, glob=False).collect_schema().names())
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(_explain_damaged(label, error)) from error


def _refuse_dtype(source: Source, column: str, dtype: pl.DataType) -> None:
    if dtype.is_numeric():
        return
    hint = " Write seconds." if dtype.is_temporal() else " Convert it to numbers."
    raise InputError(f"{source.label}: column '{column}' holds {dtype}; expected numbers.{hint}")


def split_fields(line: str, separator: str) -> list[str]:
    """Return the fields of one line of CSV; none when it cannot be split."""
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _explain_missing_column(source: Source, column: str, role: str) -> str:
    names = [name for name in source.names if not name.startswith("\0")]
    shown = ", ".join(names[:_SHOWN_NAMES]) + (", ..." if len(names) > _SHOWN_NAMES else "")
    place = f"{source.label}:1" if source.is_csv else source.label
    hint = nearest(column, names) or "."
    return (
        f"{place}: there is no column '{column}'{hint} Found: {shown}; expected "
        f"the name that {role} gives. Correct the one or the other."
    )


def _explain_no_rows(source: Source) -> str:
    if source.where:
        wanted = " and ".join(f"{column} = '{value}'" for column, value in source.where.items())
        seen = []
        for column in source.where:
            known = replace(source, where={}).scan()
            values = known.select(pl.col(column).cast(pl.String).unique()).collect().to_series()
            seen += [f"{column} is one of {', '.join(sorted(values.drop_nulls())[:8])}"]
        if any(not text.endswith("one of ") for text in seen):
            return (
                f"{source.label}: no row has {wanted}; there {'; '.join(seen)}. Correct "
                "[logs] where, or take the file out of [logs]."
            )
    return (
        f"{source.label}: there is a header but no row; expected one row per sample. Record the "
        "log again, or take it out of [logs]."
    )


def _explain_not_utf8(label: str, line: int, byte: int) -> str:
    return (
        f"{label}:{line}: byte 0x{byte:02x} is not UTF-8; expected text in UTF-8. Save the log as "
        "UTF-8."
    )


def _explain_damaged(label: str, error: BaseException) -> str:
    reason = str(error).splitlines()[0].removeprefix("parquet: ") if str(error) else "damaged"
    return (
        f"{label}: not a whole Parquet file ({reason}); expected one that ends in its footer. Copy "
        "it again, or write the log anew."
    )


def explain_unreadable(source: Source, error: BaseException) -> str:
    """Say which line the parser stumbled over; the second pass over a file that failed."""
    if not source.is_csv:
        return _explain_damaged(source.label, error)
    with source.path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            try:
                text = line.decode("utf-8-sig")
            except UnicodeDecodeError as wrong:
                return _explain_not_utf8(source.label, number, line[wrong.start])
            fields = len(split_fields(text, source.separator or ","))
            if '"' not in text and fields > len(source.names):
                return (
                    f"{source.label}:{number}: the row has {fields} fields ({text.strip()[:60]}); "
                    f"expected {len(source.names)}, as the header names. Correct the row; "
                    "--skip-invalid does not guess which fields are the right ones."
                )
    return (
        f"{source.label}: cannot be read as CSV ({str(error).splitlines()[0]}); expected a header "
        f"line and rows separated by '{source.separator}'. Write the log anew."
    )
