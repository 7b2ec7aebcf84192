"""Opens one log: its rows, selected, checked and split into runs."""

import itertools
from collections.abc import Mapping

import numpy as np

from zerodrift.base.column_config import CodesConfig
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.checks import (
    check_time,
    explain_invalid_row,
    find_invalid_rows,
    find_invalid_values,
    find_late_rows,
    widen_plausible,
)
from zerodrift.dataset.join import join_tables
from zerodrift.dataset.joined_couples import convert_joined
from zerodrift.dataset.locate import find_blank_rows, locate_row
from zerodrift.dataset.logs import read_log
from zerodrift.dataset.selectors import Selection
from zerodrift.dataset.stated_units import refuse_contradictions
from zerodrift.dataset.tables import LogTable, label_log


def list_columns(config: Config) -> dict[str, str]:
    """Return column -> where the config names it, for every column that is read as numbers."""
    columns = {
        config.time_column: "[sensor] time",
        config.temperature_column: "[sensor] temperature",
    }
    for output in config.outputs:
        columns.setdefault(output.measured, f"[outputs.{output.name}] measured")
    for output in config.outputs:
        if isinstance(output.reference, str):
            columns.setdefault(output.reference, f"[outputs.{output.name}] reference")
    for name, column in config.inputs.items():
        columns.setdefault(column, f"[inputs] {name}")
    return columns


def open_log(
    config: Config,
    selection: Selection,
    skip_invalid: bool,
    notes: list[str],
    columns: Mapping[str, str] | None = None,
    streamed: frozenset[str] = frozenset(),
) -> tuple[LogTable, list[tuple[str, int, int]]]:
    """Read one log; return its checked rows, and (run, first row, row after the last) of each.

    Args:
        config: the project.
        selection: the log, and what of it.
        skip_invalid: drop invalid rows instead of raising.
        notes: what was noticed is added to them.
        columns: column -> where it is named; None: all that the config names. With `columns` only
            the time must be valid; other invalid values become NaN.
        streamed: those of them that are read again from the file, as `read_log` takes them.

    Raises:
        InputError: the log is missing or damaged, or holds impossible values.
    """
    needed = list_columns(config) if columns is None else columns
    raw = {config.temperature_column: config.temperature_codes.raw}
    stated = {name: config.input_codes.get(name, CodesConfig()) for name in config.inputs}
    raw |= {column: stated[name].raw for name, column in config.inputs.items()}
    notes += [
        f"'{column}' is converted in the logs; the firmware is given the converted quantity"
        for column in config.conversions
        if not raw.get(column)
    ]
    notes += [
        f"'{column}': the firmware is given {kind} codes as the hardware has them"
        for column, kind in raw.items()
        if kind and column in needed
    ]
    tables = read_log(config, selection.files, needed, streamed, keep_logged=columns is not None)
    for table in tables:
        notes += table.source.notes
        refuse_contradictions(config, table.source)
        _keep_selected_runs(table, selection)
        _check_values(config, table, skip_invalid, notes, holes=columns is not None)
        spans = _split_runs(config, table, skip_invalid, notes)
    if len(tables) == 1:
        return table, spans
    joined = join_tables(config, tables, label_log(selection.path, config.directory), notes)
    holes = columns is not None
    convert_joined(config, joined, tables, skip_invalid, holes, notes)
    return joined, [("", 0, len(joined))]


def _keep_selected_runs(table: LogTable, selection: Selection) -> None:
    source = table.source
    if table.run_of_row is None:
        if selection.run_pattern not in (None, "*"):
            raise InputError(
                f"{selection.where}: selects run '{selection.run_pattern}' of {source.label}, "
                "which has no column 'run'. Add one, or leave the '#...' out."
            )
        return
    accepted = [index for index, name in enumerate(table.runs) if selection.accepts(name)]
    if not accepted:
        shown = ", ".join(table.runs[:12])
        raise InputError(
            f"{selection.where}: {source.label} has no run '{selection.run_pattern}'"
            f"{nearest(selection.run_pattern or '', table.runs) or '.'} It has: {shown}; expected "
            "one of these or a pattern such as run*. Correct the part after the '#'."
        )
    if len(accepted) < len(table.runs):
        table.take(np.isin(table.run_of_row, accepted))


def _check_values(
    config: Config, table: LogTable, skip_invalid: bool, notes: list[str], holes: bool
) -> None:
    """Drop blank lines; raise for rows with invalid values, or drop them too.

    With `holes` only the time is checked so; other invalid values become NaN.
    """
    temperatures = {config.temperature_column: widen_plausible(config.temperature_codes.range)}
    for name, column in config.inputs.items():
        if "temperature" in name or column.endswith("degC"):
            stated = config.input_codes.get(name, CodesConfig())
            temperatures[column] = widen_plausible(stated.range)
    temperatures = {name: ends for name, ends in temperatures.items() if name not in table.deferred}
    invalid = find_invalid_rows(table, temperatures)
    if invalid is not None:
        blank = find_blank_rows(table.source)
        if blank:
            table.take(~np.isin(table.positions, blank))
            invalid = find_invalid_rows(table, temperatures)
    if invalid is not None and holes:
        for column, values in table.columns.items():
            wrong = find_invalid_values(values, temperatures.get(column))
            if wrong is not None:
                values[wrong] = np.nan
        untimed = np.isnan(table.columns[config.time_column])
        invalid = untimed if untimed.any() else None
    if invalid is None:
        return
    count, rows = int(invalid.sum()), len(table)
    if not skip_invalid or count == rows:
        raise explain_invalid_row(table, invalid, temperatures)
    notes.append(f"{table.source.label}: dropped {count} of {rows} rows that hold invalid values")
    table.take(~invalid)


def _split_runs(
    config: Config, table: LogTable, skip_invalid: bool, notes: list[str]
) -> list[tuple[str, int, int]]:
    """Return (run, first row, row after the last) of each run, rows sorted by run, times checked.

    The name is empty for a file without a `run` column.
    """
    spans = _list_run_spans(table)
    if skip_invalid:
        late = np.zeros(len(table), dtype=np.bool_)
        time_s = table.columns[config.time_column]
        for _, start, stop in spans:
            late[start:stop] = find_late_rows(time_s[start:stop])
        if late.any():
            notes.append(
                f"{table.source.label}: dropped {int(late.sum())} of {late.size} rows whose time "
                "does not rise"
            )
            table.take(~late)
            spans = _list_run_spans(table)
    for _, start, stop in spans:
        check_time(table, config.time_column, start, stop)
    return spans


def _list_run_spans(table: LogTable) -> list[tuple[str, int, int]]:
    if table.run_of_row is None:
        return [("", 0, len(table))]
    codes = table.run_of_row
    changes = np.flatnonzero(np.diff(codes)) + 1
    if changes.size + 1 > np.unique(codes).size:
        # Rows of several runs alternate in the file.
        table.take(np.argsort(codes, kind="stable"))
        codes = table.run_of_row
        changes = np.flatnonzero(np.diff(codes)) + 1
    bounds = [0, *changes.tolist(), codes.size]
    spans = []
    for start, stop in itertools.pairwise(bounds):
        name = table.runs[int(codes[start])]
        if not name:
            place = locate_row(table.source, table.position(start))
            raise InputError(
                f"{place.text}: column 'run' is empty; expected the run's name in every row. Fill "
                "it in."
            )
        spans.append((name, start, stop))
    return spans
