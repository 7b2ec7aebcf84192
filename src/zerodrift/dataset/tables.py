"""Reads the needed columns of one log, CSV or Parquet, as float64 arrays.

The first pass only parses: what is no number becomes NaN. Only when a check fails is the file read
a second time, by `zerodrift.dataset.checks`, for the line and the text of the offending row.
"""

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import name_kind
from zerodrift.dataset.selectors import ARROW_SUFFIXES, PARQUET_SUFFIXES
from zerodrift.dataset.text_format import (
    UNNAMED,
    TextFormat,
    list_lines,
    sniff_text,
    split_fields,
    write_plain,
)
from zerodrift.dataset.times import Clock

# Float64 columns that grow batch by batch and are never copied as a whole.


class GrowingColumns:
    """Equally long columns with room reserved ahead; unused room takes address space, not
    memory."""

    def __init__(self, names: Sequence[str], capacity: int) -> None:
        self._arrays: dict[str, Array] = {name: np.empty(capacity) for name in names}
        self._capacity = capacity
        self._rows = 0

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._rows

    def append(self, batch: pl.DataFrame) -> None:
        """Add the rows of a batch that has these columns, as float64; null becomes NaN."""
        rows = self._rows + batch.height
        if rows > self._capacity:
            self._capacity = rows + rows // 4
            for name, old in self._arrays.items():
                self._arrays[name] = np.empty(self._capacity)
                self._arrays[name][: self._rows] = old[: self._rows]
        for name, array in self._arrays.items():
            array[self._rows : rows] = batch[name].to_numpy()
        self._rows = rows

    def finish(self) -> dict[str, Array]:
        """Return name -> [n]."""
        return {name: array[: self._rows] for name, array in self._arrays.items()}


# Checks that the quotation marks of a CSV leave no doubt where its rows end.
#
# Polars takes a mark anywhere in a field for the start of quoted text, and all lines up to the next
# mark for one row: one `5"` among remarks would silently cost every row between it and the next.

_MARK = b'"'
_BLOCK_BYTES = 1 << 22
_LONGEST_FIELD_BYTES = 1 << 20
_SHOWN = 60


def check_quotes(path: Path, label: str, separator: str) -> None:
    """Refuse a CSV in which a quotation mark runs over the end of a line without quoting a field.

    Marks in pairs within a line do no harm, nor does a quoted field that holds line breaks. A file
    without any mark, the usual case, is only searched for one.

    Args:
        path: the log.
        label: how messages name it.
        separator: the character between fields.

    Raises:
        InputError: with the line of the mark.
    """
    if not _holds_mark(path):
        return
    between = re.escape(separator.encode())
    quoted = re.compile(rb'(?:(?<=%b)|\A)[ \t]*"(?:[^"]|"")*"(?=%b|\r?\n|\Z)' % (between, between))
    for number, record, is_closed in _list_odd_records(path):
        first = record.split(b"\n", 1)[0].decode("utf-8", "replace").strip()[:_SHOWN]
        if not is_closed:
            raise InputError(
                f"{label}:{number}: a quotation mark opens a field that is not closed ({first}); "
                "expected them in pairs around a field. Close or remove it."
            )
        if _MARK in quoted.sub(b"", record):
            raise InputError(
                f"{label}:{number}: a quotation mark stands alone within a field ({first}); "
                "expected them in pairs around a field, as it would swallow the rows up to the "
                "next one. Remove it, or double it and quote the whole field."
            )


def _holds_mark(path: Path) -> bool:
    with path.open("rb") as file:
        return any(_MARK in block for block in iter(lambda: file.read(_BLOCK_BYTES), b""))


def _list_odd_records(path: Path) -> Iterator[tuple[int, bytes, bool]]:
    """Yield what begins on a line with an odd number of marks and ends on the next such line.

    Each as the number of its first line, its bytes, and whether a line that ends it comes within
    the greatest length of a field.
    """
    start, record = 0, b""
    with path.open("rb") as file:
        next(file)
        for number, line in enumerate(file, start=2):
            is_odd = line.count(_MARK) % 2 == 1
            if record:
                record += line
                if is_odd:
                    yield start, record, True
                    record = b""
                elif len(record) > _LONGEST_FIELD_BYTES:
                    break
            elif is_odd:
                start, record = number, line
    if record:
        yield start, record, False


# Reads the needed columns of one log, CSV or Parquet, as float64 arrays.

PARSER_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError)
"""What Polars raises over a damaged file."""
RUN_COLUMN = "run"
BATCH_ROWS = 100_000
_HEAD_BYTES = 1 << 18
_LONGEST_HEAD_BYTES = 1 << 21
"""More is read of a file whose first lines are longer, up to a header of so many bytes."""
_SAMPLE_BYTES = 1 << 16
_SHOWN_NAMES = 12
MOST_SNIFFED = 256
"""Logs of which it is kept how they are written."""


@dataclass(frozen=True)
class Source:
    """One table of a log and how it is read; enough to read it again."""

    path: Path
    label: str
    """How messages name the file."""
    names: tuple[str, ...]
    """All column names, in order; unnamed ones get a name no config can hold."""
    where: Mapping[str, str]
    """Row filter: column -> value."""
    text: TextFormat | None = None
    """How a CSV is written; None for anything else."""
    data: Path | None = None
    """What is parsed instead of `path`: the same lines as plain UTF-8."""
    frame: pl.DataFrame | None = None
    """The rows, of a file that is neither CSV, Parquet nor Arrow."""
    is_ragged: bool = False
    """Rows may end in delimiters that nothing follows."""
    notes: tuple[str, ...] = ()
    """What the user should know of the file."""
    part: str = ""
    """Sheet, group or topic, of a file that holds several."""
    stated_units: Mapping[str, str] = field(default_factory=dict)
    """Column -> unit, where the format itself keeps it."""

    @property
    def name(self) -> str:
        """Return the name of the table in `FILE:COLUMN`: its part, or the file's name."""
        return self.part or self.path.name

    @property
    def is_csv(self) -> bool:
        """Tell whether the log is text."""
        return self.text is not None

    @property
    def units(self) -> dict[str, str]:
        """Return column -> unit, as a row of units or the format states it."""
        if self.text is None:
            return dict(self.stated_units)
        return dict(zip(self.names, self.text.units, strict=False))

    @property
    def parsed(self) -> tuple[Path, TextFormat]:
        """Return the file of text that is parsed, and how it is written."""
        assert self.text is not None
        if self.data is None:
            return self.path, self.text
        return self.data, replace(self.text, separator="\t", encoding="utf-8", padded=False)

    def scan(self, numeric: Sequence[str] = ()) -> pl.LazyFrame:
        """Return the log as a lazy frame with the row filter applied and a `_row` column.

        `_row` counts from 0 within the file, before the filter. In a CSV the `numeric` columns are
        read as float64, null where they hold no number, and all others as text.
        """
        if self.is_csv:
            path, text = self.parsed
            schema = {name: pl.Float64 if name in numeric else pl.String for name in self.names}
            frame = pl.scan_csv(
                path,
                separator=text.separator,
                decimal_comma=text.decimal_comma,
                comment_prefix=text.comment or None,
                has_header=False,
                skip_lines=text.head_lines,
                schema=schema,
                ignore_errors=True,
                truncate_ragged_lines=self.is_ragged,
                glob=False,
                row_index_name="_row",
            )
        elif self.frame is not None:
            frame = self.frame.lazy().with_row_index("_row")
        elif self.path.suffix.lower() in ARROW_SUFFIXES:
            frame = pl.scan_ipc(self.path, glob=False, row_index_name="_row")
        else:
            frame = pl.scan_parquet(self.path, glob=False, row_index_name="_row")
        for column, value in self.where.items():
            frame = frame.filter(pl.col(column).cast(pl.String) == value)
        return frame

    def sample(self, columns: Sequence[str], rows: int | None) -> list[pl.Series]:
        """Return the first values of some columns, as text in a CSV; None: all different ones.

        Raises:
            InputError: the file is damaged.
        """
        try:
            frame = replace(self, where={}).scan().select(columns)
            found = frame.unique(maintain_order=True) if rows is None else frame.head(rows)
            return found.collect().get_columns()
        except PARSER_ERRORS as error:
            mended = mend_source(self, error)
            return mended.sample(columns, rows)


@dataclass
class LogTable:
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
    clock: Clock | None = None
    """How its times were read."""
    converted: tuple[str, ...] = ()
    """Columns that are no longer as they were logged."""
    deferred: tuple[str, ...] = ()
    """Thermocouples that are still voltages: another file of the run has their cold junction."""
    logged: dict[str, Array] = field(default_factory=dict)
    """Column -> [n] as it was logged, of those that are converted, where that was asked for."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return next((int(column.size) for column in self.columns.values()), 0)

    def take(self, rows: NDArray[np.intp] | Mask) -> None:
        """Keep only `rows` (positions or a mask), in that order."""
        kept = self.positions[rows]
        for name in self.columns:
            self.columns[name] = self.columns[name][rows]
        self.logged = {name: values[rows] for name, values in self.logged.items()}
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


def write_text(column: str, frame: pl.LazyFrame) -> pl.Expr:
    """Return a column as text; null where it holds what has no text, such as lists or bytes."""
    dtype, value = frame.collect_schema()[column], pl.col(column)
    if dtype == pl.Duration:
        return (value.dt.total_microseconds() / 1e6).cast(pl.String)
    if dtype.is_nested() or dtype in (pl.Binary, pl.Object):
        return pl.lit(None, dtype=pl.String).alias(column)
    return value.cast(pl.String)


def open_source(path: Path, label: str, where: Mapping[str, str]) -> Source:
    """Read a log's column names, and how it is written.

    Raises:
        InputError: the file cannot be opened, is empty, is no text or not Parquet, or names a
            column twice.
    """
    head = _read_head(path, label)
    if path.suffix.lower() in PARQUET_SUFFIXES + ARROW_SUFFIXES:
        return Source(path, label, _read_names(path, label), where)
    if head.startswith(b"PAR1"):
        raise InputError(f"{label}: holds Parquet; expected CSV text. Name it {path.stem}.parquet.")
    text = _sniff_once(head, label, is_whole=len(head) >= path.stat().st_size)
    return _open_text(Source(path, label, text.names, where, text, notes=text.notes))


def _sniff_once(head: bytes, label: str, is_whole: bool) -> TextFormat:
    """Return what `sniff_text` finds; a log that is opened again is not sniffed again."""
    key = (hashlib.sha256(head).digest(), label, is_whole)
    if key not in _SNIFFED:
        while len(_SNIFFED) >= MOST_SNIFFED:
            del _SNIFFED[next(iter(_SNIFFED))]
        _SNIFFED[key] = sniff_text(head, label, is_whole)
    return _SNIFFED[key]


_SNIFFED: dict[tuple[bytes, str, bool], TextFormat] = {}


def _open_text(source: Source) -> Source:
    """Return the source with a plain copy of its file where the parser needs one."""
    assert source.text is not None
    is_plain = source.text.is_plain
    return source if is_plain else replace(source, data=write_plain(source.path, source.text))


def read_table(
    source: Source,
    needed: Mapping[str, str],
    run_column: bool = True,
    clock: Clock | None = None,
    unread: frozenset[str] = frozenset(),
) -> LogTable:
    """Parse the needed columns of a log.

    Args:
        source: the log.
        needed: column -> where the config names it, for messages.
        run_column: whether a column named `run` splits the file.
        clock: how the times, `clock.name` in `needed`, are written; None: they are a column of
            numbers like any other.
        unread: columns that have to be there, as numbers, but whose values are not wanted.

    Raises:
        InputError: a column is missing or holds no numbers, rows have too many fields, the file is
            damaged or holds no row.
    """
    plain = {name: role for name, role in needed.items() if clock is None or name != clock.name}
    timed = {} if clock is None else dict.fromkeys(clock.columns, needed.get(clock.name, ""))
    for column, role in [
        *timed.items(),
        *plain.items(),
        *((name, "[logs] where") for name in source.where),
    ]:
        if column not in source.names:
            raise InputError(_explain_missing_column(source, column, role))
    if source.text is not None and source.data is None:
        check_quotes(source.path, source.label, source.text.separator)
    has_runs = run_column and RUN_COLUMN in source.names and RUN_COLUMN not in needed
    try:
        wanted = {name: role for name, role in plain.items() if name not in unread}
        _refuse_dtypes(source, plain)
        columns, runs = _parse(source, wanted, clock, has_runs)
    except PARSER_ERRORS as error:
        return read_table(mend_source(source, error), needed, run_column, clock, unread)
    if len(columns) == 0:
        raise InputError(_explain_no_rows(source))
    arrays = columns.finish()
    if clock is not None and clock.is_even and np.isnan(arrays[clock.name]).any():
        # Some row is no time, or is not written as evenly as the first ones.
        return read_table(source, needed, run_column, replace(clock, is_even=False), unread)
    codes = arrays.pop(RUN_COLUMN).astype(np.uint32) if has_runs else None
    if clock is not None and clock.kind == "rows":
        rows = next(iter(arrays.values())).size
        arrays[clock.name] = clock.period_s * np.arange(rows, dtype=np.float64)
    if clock is not None:
        arrays[clock.name] = clock.settle(arrays[clock.name], source.label)
        arrays = {name: arrays[name] for name in needed if name in arrays}
    return LogTable(source, arrays, tuple(runs), codes, clock=clock)


def _parse(
    source: Source, needed: Mapping[str, str], clock: Clock | None, has_runs: bool
) -> tuple[GrowingColumns, dict[str, int]]:
    is_timed = clock is not None and clock.kind != "rows"
    numbers = clock.columns if clock is not None and clock.kind == "number" else ()
    frame = source.scan((*needed, *numbers))
    schema = frame.collect_schema()
    for column in numbers:
        _refuse_dtype(source, column, schema[column])
    wanted = [pl.col(column).cast(pl.Float64) for column in needed]
    if clock is not None and is_timed:
        wanted.insert(0, clock.read(schema))
    wanted += [pl.col(RUN_COLUMN).cast(pl.String)] if has_runs else []
    names = [*([clock.name] if clock is not None and is_timed else []), *needed]
    names += [RUN_COLUMN] if has_runs else []
    columns = GrowingColumns(names, _guess_rows(source))
    runs: dict[str, int] = {}
    for batch in _stream(frame.select(wanted)):
        columns.append(_encode_runs(batch, runs) if has_runs else batch)
    return columns, runs


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
        return int(source.scan().select(pl.len()).collect().item())
    path, _ = source.parsed
    size = path.stat().st_size
    with path.open("rb") as file:
        counts = []
        for share in (0.0, 0.5, 1.0):
            file.seek(int(share * max(0, size - _SAMPLE_BYTES)))
            counts.append(file.read(_SAMPLE_BYTES).count(b"\n"))
    return int(1.05 * max(counts) * max(1.0, size / _SAMPLE_BYTES)) + 1


def refuse_no_file(path: Path, label: str) -> None:
    """Raise InputError for what is no ordinary file."""
    if path.exists() and not path.is_file():
        # Opening a named pipe would block for ever.
        raise InputError(
            f"{label}: is {name_kind(path)}; expected a log, an ordinary file. Name the file that "
            "holds the rows."
        )


def _read_head(path: Path, label: str) -> bytes:
    refuse_no_file(path, label)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            if head.count(b"\n") < 2:
                head += file.read(_LONGEST_HEAD_BYTES)
    except FileNotFoundError as error:
        raise InputError(
            f"{label}: there is no such file; expected a log. Correct the name, or the folder that "
            "it is looked up in."
        ) from error
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
    return head


def _read_names(path: Path, label: str) -> tuple[str, ...]:
    is_arrow = path.suffix.lower() in ARROW_SUFFIXES
    scan = pl.scan_ipc if is_arrow else pl.scan_parquet
    try:
        return tuple(scan(path, glob=False).collect_schema().names())
    except PARSER_ERRORS as error:
        raise InputError(_explain_damaged(label, error, is_arrow)) from error


def _refuse_dtypes(source: Source, columns: Mapping[str, str]) -> None:
    if source.is_csv:
        return  # they are read as numbers
    schema = source.scan(tuple(columns)).collect_schema()
    for column in columns:
        _refuse_dtype(source, column, schema[column])


def _refuse_dtype(source: Source, column: str, dtype: pl.DataType) -> None:
    if dtype.is_numeric():
        return
    hint = " Write seconds." if dtype.is_temporal() else " Convert it to numbers."
    raise InputError(f"{source.label}: column '{column}' holds {dtype}; expected numbers.{hint}")


def _explain_missing_column(source: Source, column: str, role: str) -> str:
    names = [name for name in source.names if not name.startswith(UNNAMED)]
    shown = ", ".join(names[:_SHOWN_NAMES]) + (", ..." if len(names) > _SHOWN_NAMES else "")
    line = 0 if source.text is None else source.text.header_line
    place = f"{source.label}:{line}" if line else source.label
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


def _explain_unread(label: str, error: OSError) -> str:
    return (
        f"{label}: cannot be read to its end ({error.strerror}); expected a whole file. Run the "
        "command again; if it stays so, look at the disk."
    )


def _explain_damaged(label: str, error: BaseException, is_arrow: bool = False) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        return _explain_unread(label, error)
    reason = str(error).splitlines()[0].removeprefix("parquet: ") if str(error) else "damaged"
    kind = "Arrow (Feather)" if is_arrow else "Parquet"
    return (
        f"{label}: not a whole {kind} file ({reason}); expected one that ends in its footer. Copy "
        "it again, or write the log anew."
    )


def mend_source(source: Source, error: BaseException) -> Source:
    """Return a source that can be read in place of one that the parser refused.

    A second pass over a file that failed. It accepts what needs no guess: another encoding, and
    rows that end in delimiters after which nothing follows.

    Raises:
        InputError: anything else; the message names the line, or what the system refused.
    """
    if isinstance(error, OSError) and error.errno is not None:
        raise InputError(_explain_unread(source.label, error)) from error
    if source.text is None:
        is_arrow = source.path.suffix.lower() in ARROW_SUFFIXES
        raise InputError(_explain_damaged(source.label, error, is_arrow)) from error
    path, text = source.parsed
    trailing = 0
    for number, line in list_lines(path, text):
        try:
            row = line.decode("utf-8-sig")
        except UnicodeDecodeError:
            note = f"{source.label}: line {number} is not UTF-8; read as Windows-1252 (latin-1)"
            other = replace(source.text, encoding="cp1252")
            return _open_text(replace(source, text=other, notes=(*source.notes, note)))
        fields = split_fields(row.rstrip("\r\n"), text.separator)
        surplus = [field for field in fields[len(source.names) :] if field.strip()]
        if '"' not in row and surplus:
            raise InputError(
                f"{source.label}:{number}: the row has {len(fields)} fields ({row.strip()[:60]}); "
                f"expected {len(source.names)}, as the header names. Correct the row; "
                "--skip-invalid does not guess which fields are the right ones."
            ) from error
        trailing += len(fields) > len(source.names)
    if trailing and not source.is_ragged:
        rows = "one row ends" if trailing == 1 else f"{trailing} rows end"
        note = f"{source.label}: {rows} in a delimiter after which nothing follows; left out"
        return replace(source, is_ragged=True, notes=(*source.notes, note))
    raise InputError(
        f"{source.label}: cannot be read as CSV ({str(error).splitlines()[0]}); expected a header "
        f"line and rows separated by {text.separator!r}. Write the log anew."
    ) from error
