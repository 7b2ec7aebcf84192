"""One log of a project as tables: its files, their clocks, which file holds which column."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Mask
from zerodrift.base.column_config import fits
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import show_path
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.formats.registry import find_format, read_tables
from zerodrift.dataset.tables import (
    LogTable,
    Source,
    open_source,
    read_table,
    refuse_no_file,
    write_text,
)
from zerodrift.dataset.text_format import UNNAMED
from zerodrift.dataset.times import SAMPLE, Clock, find_clock

# Opens a file as the tables that it holds: one for text, Parquet and Arrow, else several.


def open_sources(path: Path, label: str, where: Mapping[str, str]) -> list[Source]:
    """Return the tables of a file; those of a file with several are called `LABEL[NAME]`.

    Raises:
        InputError: the file cannot be read, or its library is not installed.
    """
    known = find_format(path)
    if known is None:
        return [open_source(path, label, where)]
    refuse_no_file(path, label)
    tables = read_tables(path, label, known)
    sources = []
    for table in tables:
        who = f"{label}[{table.name}]" if len(tables) > 1 else label
        if table.text is not None:
            inner = open_source(table.text, who, where)
            sources.append(replace(inner, path=path, data=inner.data or table.text))
        elif table.frame is not None:
            names = tuple(table.frame.columns)
            sources.append(
                Source(path, who, names, where, frame=table.frame, stated_units=table.units)
            )
    named = [table.name if len(tables) > 1 else "" for table in tables]
    return [replace(each, part=part) for each, part in zip(sources, named, strict=True)]


# Values that mean that there is none (`missing` in zerodrift.toml) are taken out, with a note.


def take_missing_out(
    config: Config, table: LogTable, named: Mapping[str, str], *, keep_rows: bool
) -> LogTable:
    """Drop the rows of a log in which a needed column has no value, as `missing` states it.

    Args:
        config: the project.
        table: the log as it was parsed, before conversions.
        named: column as the table calls it -> its name in the file, where that is another.
        keep_rows: keep the rows, with NaN in place of the value.

    Returns:
        The table, with a note that counts the rows.

    Raises:
        InputError: no row is left.
    """
    absent: dict[str, Mask] = {}
    for column in table.columns:
        if column == config.time_column:
            continue
        numbers = config.missing.list_numbers(column)
        texts = config.missing.list_texts(column)
        rows = _find_rows(table, column, named.get(column, column), numbers, texts)
        if rows is not None and rows.any():
            absent[column] = rows
    if not absent:
        return table
    if keep_rows:
        for column, rows in absent.items():
            table.columns[column][rows] = np.nan
        return table
    every = np.logical_or.reduce(list(absent.values()))
    told = ", ".join(f"{int(rows.sum())} in '{column}'" for column, rows in absent.items())
    label, count = table.source.label, int(every.sum())
    if every.all():
        raise InputError(
            f"{label}: all {every.size} rows hold a value that `missing` in zerodrift.toml says is "
            f"none ({told}); expected rows with values. Correct `missing`, or take the log or the "
            "column out."
        )
    note = (
        f"{label}: {count} of {every.size} rows left out, as they hold no value by `missing` in "
        f"zerodrift.toml ({told})"
    )
    table.take(~every)
    table.source = replace(table.source, notes=(*table.source.notes, note))
    return table


def _find_rows(
    table: LogTable, column: str, name: str, numbers: tuple[float, ...], texts: tuple[str, ...]
) -> Mask | None:
    """Return the rows [n] that hold one of the values; None where none can."""
    values = table.columns[column]
    if not numbers and not texts:
        return None
    rows = np.isin(values, numbers)
    if texts and np.isnan(values).any() and table.source.is_csv:
        # A text is no number, so it was parsed as NaN: only then is the column read as text.
        frame = table.source.scan()
        written = frame.select(write_text(name, frame).str.strip_chars().is_in(list(texts)))
        found = written.collect().to_series().fill_null(value=False).to_numpy()
        rows |= np.asarray(found, dtype=np.bool_)[table.positions]
    return np.asarray(rows)


# One log of a project as tables: its files, their clocks, which file holds which column.

COMMON = "[logs] common"


@dataclass(frozen=True)
class Part:
    """One file of a log, and the columns that are read of it."""

    source: Source
    columns: Mapping[str, str]
    """Column as zerodrift.toml names it -> its name in the file."""


def read_log(
    config: Config,
    files: Sequence[Path],
    needed: Mapping[str, str],
    streamed: frozenset[str] = frozenset(),
    keep_logged: bool = False,
) -> list[LogTable]:
    """Read the needed columns of a log, times in seconds: one table for each file that has some.

    Args:
        config: the project.
        files: one, or several that are one run.
        needed: column -> where the config names it; the times are called `config.time_column`.
        streamed: columns that the caller reads from the file again, row by row; with a single table
            their values are read here only where they are converted.
        keep_logged: keep converted columns as they were logged too, where the log is no one text.

    Raises:
        InputError: a file cannot be read, a column is in none or in several of them.
    """
    needed = add_junctions(config, needed)
    if len(files) == 1:
        opened = open_sources(files[0], show_path(files[0], config.directory), config.where)
        if len(opened) == 1:
            (source,) = opened
            is_whole = bool(source.part)  # a sheet, group or topic: written from what is read
            unread = frozenset() if is_whole else streamed.difference(config.conversions)
            clock = find_log_clock(config, source)
            table = read_table(source, needed, clock=clock, unread=unread)
            table = take_missing_out(config, table, {}, keep_rows=keep_logged)
            return [_convert(config, table, keep_logged and is_whole)]
    sources, refused = _open_all(config, files)
    wanted = {name: role for name, role in needed.items() if name != config.time_column}
    parts = _share_out(sources, wanted, files, refused, config)
    tables = [
        take_missing_out(
            config,
            _read_part(config, part, needed, len(parts) > 1),
            part.columns,
            keep_rows=keep_logged,
        )
        for part in parts
    ]
    return [_convert(config, table, keep_logged) for table in tables]


def add_junctions(config: Config, needed: Mapping[str, str]) -> Mapping[str, str]:
    """Return the needed columns with those of the cold junctions of thermocouples among them."""
    names = {config.conversions[c].junction for c in needed if c in config.conversions} - {None}
    return {**{config.inputs[name]: f"[inputs] {name}" for name in names if name}, **needed}


def _convert(config: Config, table: LogTable, keep_logged: bool) -> LogTable:
    """Bring the columns that zerodrift.toml converts to the quantity that the model takes.

    A thermocouple whose cold junction is in another file waits for it (`open_log`).
    """
    own = {c: by for c, by in config.conversions.items() if c in table.columns}
    if keep_logged:
        table.logged = {column: table.columns[column].copy() for column in own}
    for column, by in own.items():
        if by.junction is None:
            table.columns[column] = convert(table.columns[column], by)
    for column, by in own.items():
        if by.junction is None:
            continue
        cold = config.inputs[by.junction]
        if cold in table.columns:
            table.columns[column] = convert(table.columns[column], by, table.columns[cold])
        else:
            table.deferred += (column,)
    table.converted += tuple(column for column in own if column not in table.deferred)
    return table


def _open_all(config: Config, files: Sequence[Path]) -> tuple[list[Source], list[str]]:
    """Return the files that can be opened, and a note on each of the others."""
    sources, refused = [], []
    for path in files:
        try:
            sources += open_sources(path, show_path(path, config.directory), {})
        except InputError as error:
            if isinstance(error.__cause__, OSError):
                raise
            refused.append(str(error))
    for column in config.where:
        if not any(column in source.names for source in sources):
            raise InputError(_explain_missing(files, sources, refused, column, "[logs] where"))
    return [
        replace(source, where={k: v for k, v in config.where.items() if k in source.names})
        for source in sources
    ], refused


def _share_out(
    sources: Sequence[Source],
    wanted: Mapping[str, str],
    files: Sequence[Path],
    refused: Sequence[str],
    config: Config,
) -> list[Part]:
    """Return the files that hold wanted columns, each with its own."""
    columns: list[dict[str, str]] = [{} for _ in sources]
    for column, role in wanted.items():
        holders = find_holders(sources, column)
        if not holders:
            raise InputError(_explain_missing(files, sources, refused, column, role))
        if len(holders) > 1:
            names = [sources[number].name for number, _ in holders]
            raise InputError(
                f"{_label(files, config)}: column '{column}' is in {' and in '.join(names)}; "
                f'expected one. Write "{names[0]}:{column}" where {role} names it.'
            )
        number, name = holders[0]
        columns[number][column] = name
    used = [Part(source, own) for source, own in zip(sources, columns, strict=True) if own]
    return [
        Part(part.source, {**part.columns, **_find_common(config, part, len(used))})
        for part in used
    ]


def find_holders(sources: Sequence[Source], column: str) -> list[tuple[int, str]]:
    """Return (position among the sources, name there) of each that holds a column.

    The column is a name, or `FILE:NAME` with the file's name or a pattern of it.
    """
    found = [(i, column) for i, source in enumerate(sources) if column in source.names]
    if found:
        return found
    return [
        (i, name)
        for i, source in enumerate(sources)
        for name in source.names
        if column.endswith(f":{name}") and _is_called(source, column.removesuffix(f":{name}"))
    ]


def _is_called(source: Source, name: str) -> bool:
    return name == source.part or fits(source.path, name) or source.path.stem == name


def _find_common(config: Config, part: Part, parts: int) -> dict[str, str]:
    """Return the part's column of the quantity that all record, as `COMMON`."""
    if parts < 2:
        return {}
    for column in config.clocks.common:
        if holders := find_holders([part.source], column):
            return {COMMON: holders[0][1]}
    return {}


def _read_part(config: Config, part: Part, needed: Mapping[str, str], is_joined: bool) -> LogTable:
    clock = find_log_clock(config, part.source)
    if clock is None:
        columns = " and ".join(f"'{name}'" for name in config.time.columns)
        names = ", ".join(name for name in part.source.names if not name.startswith(UNNAMED))
        raise InputError(
            f"{part.source.label}: there is no column {columns} of times. Found: {names}; "
            f"expected one in each of a run's files. State it: [logs] time = {{ "
            f'"{part.source.path.name}" = "COLUMN" }}, or its period: [logs] period_s = {{ '
            f'"{part.source.path.name}" = 1.0 }}.'
        )
    own = {config.time_column: "[sensor] time"}
    own |= {raw: needed.get(column, COMMON) for column, raw in part.columns.items()}
    table = read_table(part.source, own, run_column=not is_joined, clock=clock)
    values = {config.time_column: table.columns[config.time_column]}
    values |= {column: table.columns[raw] for column, raw in part.columns.items()}
    table.columns = values
    return table


def find_log_clock(config: Config, source: Source) -> Clock | None:
    """Return how the times of one log are read; None: it has no such column.

    Raises:
        InputError: the form of its times is unknown or ambiguous.
    """
    offset_s = config.clocks.offset_s(source.path) or 0.0
    period_s = config.clocks.period_s(source.path)
    time = config.clocks.time(source.path, config.time)
    if period_s is not None:
        name = config.time_column
        return Clock((), "rows", name, period_s=period_s, offset_s=offset_s)
    if any(column not in source.names for column in time.columns):
        return None
    first = source.sample(time.columns, SAMPLE)
    if not len(first[0]):
        return None
    clock = find_clock(time, first, source.label, lambda: source.sample(time.columns, None))
    return replace(clock, name=config.time_column, offset_s=offset_s)


def _label(files: Sequence[Path], config: Config) -> str:
    folder = files[0].parent
    return show_path(folder, config.directory) if folder != config.directory else files[0].name


def _explain_missing(
    files: Sequence[Path],
    sources: Sequence[Source],
    refused: Sequence[str],
    column: str,
    role: str,
) -> str:
    known = [name for source in sources for name in source.names if not name.startswith(UNNAMED)]
    found = "; ".join(
        f"{source.name} has {', '.join(n for n in source.names[:12] if n[:1] != UNNAMED)}"
        for source in sources
    )
    more = f" Not read: {' '.join(refused)}" if refused else ""
    who, what = (files[0].parent.name, "files") if len(files) > 1 else (files[0].name, "tables")
    return (
        f"{who}: there is no column '{column}' in any of its {len(sources)} {what}"
        f"{nearest(column, known) or '.'} Found: {found}; expected the name that {role} gives. "
        f"Correct the one or the other.{more}"
    )
