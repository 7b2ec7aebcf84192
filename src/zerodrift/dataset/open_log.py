"""Opens one log: its rows, selected, checked and split into runs."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from zerodrift.base.column_config import FACTORS, TIME_UNITS, CodesConfig
from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import show_path
from zerodrift.dataset.checks import (
    SKIP,
    check_time,
    explain_invalid_row,
    find_blank_rows,
    find_invalid_rows,
    find_invalid_values,
    find_late_rows,
    locate_row,
    show_text,
    widen_plausible,
)
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.join import join_tables
from zerodrift.dataset.logs import read_log
from zerodrift.dataset.selectors import Selection
from zerodrift.dataset.tables import LogTable, Source
from zerodrift.dataset.units import normalise_unit, read_time_unit

# Units that a log itself states, by a row of units or its format, against zerodrift.toml's.


def refuse_contradictions(config: Config, source: Source) -> None:
    """Refuse columns that are taken in one unit where the log states another of the same quantity.

    Columns with a conversion table in zerodrift.toml are not checked: the table decides.

    Raises:
        InputError: names the log, both units, and the table to write.
    """
    stated = {name: unit for name, unit in source.units.items() if unit}
    if not stated:
        return
    wanted: list[tuple[str, str, str, tuple[str, ...]]] = [
        ("[sensor] temperature", config.temperature_column, "degC", ("sensor", "temperature"))
    ]
    for output in config.outputs:
        for key, column in (("measured", output.measured), ("reference", output.reference)):
            if isinstance(column, str):
                own = ("outputs", output.name, key)
                wanted.append((f"[outputs.{output.name}] {key}", column, output.unit, own))
    time = config.clocks.time(source.path, config.time)
    if len(time.columns) == 1 and not time.unit and not time.format:
        unit = read_time_unit(time.columns[0]) or "s"
        wanted.append(("[sensor] time", time.columns[0], unit, ("sensor", "time")))
    for role, column, taken, place in wanted:
        name = column if column in stated else column.rpartition(":")[2]
        if name not in stated or column in config.conversions:
            continue
        found = normalise_unit(stated[name], name)
        if not _contradict(found, taken):
            continue
        key = role.rpartition(" ")[2]
        row = source.text.header_line + 1 if source.text is not None else 0
        raise InputError(
            f"{source.label}{f':{row}' if row else ''}: column '{name}' is in {found}, as the log "
            f"states, and {locate_key(config.path, *place)} takes it as {taken}; expected one unit."
            f' Write {key} = {{ column = "{column}", unit = "{found}" }} in '
            f"{role.rpartition(' ')[0]}, which converts it."
        )


def _contradict(found: str, unit: str) -> bool:
    """Tell whether two units are of one quantity and differ."""
    if unit == "degC":
        return found in ("K", "degF")
    if unit in TIME_UNITS and found in TIME_UNITS:
        return found != unit
    one, other = FACTORS.get(found), FACTORS.get(unit)
    return one is not None and other is not None and one[0] == other[0] and one[1] != other[1]


# Thermocouples whose cold junction another file of the run has: converted once both are joined.


def convert_joined(
    config: Config,
    joined: LogTable,
    tables: Sequence[LogTable],
    skip_invalid: bool,
    holes: bool,
    notes: list[str],
) -> None:
    """Convert the voltages that needed a cold junction from another file, in place.

    The junction's temperature is interpolated linearly to the rows of the join.

    Args:
        config: the project.
        joined: the run.
        tables: its files, before the join.
        skip_invalid: drop rows that have no temperature instead of raising.
        holes: leave them as NaN.
        notes: gets how many were dropped.

    Raises:
        InputError: the conversion has no temperature for a voltage.
    """
    wrong = np.zeros(len(joined), dtype=np.bool_)
    for column in [c for table in tables for c in table.deferred]:
        by = config.conversions[column]
        cold = config.inputs[by.junction or ""]
        found = convert(joined.columns[column], by, joined.columns[cold])
        joined.columns[column] = found
        joined.converted += (column,)
        stated = config.temperature_codes.range
        names = [name for name, own in config.inputs.items() if own == column]
        if names:
            stated = config.input_codes[names[0]].range
        invalid = find_invalid_values(found, widen_plausible(stated))
        if invalid is None:
            continue
        if holes:
            found[invalid] = np.nan
            continue
        if not skip_invalid or invalid.all():
            own = next(table for table in tables if column in table.deferred)
            raise _explain(config, joined, own, column, int(np.argmax(invalid)))
        wrong |= invalid
    if wrong.any():
        label = joined.source.label
        notes.append(
            f"{label}: dropped {int(wrong.sum())} of {wrong.size} rows whose voltage and cold "
            "junction make no temperature"
        )
        joined.take(~wrong)


def _explain(config: Config, joined: LogTable, own: LogTable, column: str, row: int) -> InputError:
    """Return the error about a row of the join, with the nearest row of the thermocouple's file."""
    at_s = float(joined.columns[config.time_column][row])
    nearest = int(np.argmin(np.abs(own.columns[config.time_column] - at_s)))
    place = locate_row(own.source, own.position(nearest))
    text = place.values.get(column, place.values.get(column.partition(":")[2])) or ""
    by = config.conversions[column]
    cold = config.inputs[by.junction or ""]
    degc = float(joined.columns[cold][row])
    became = float(joined.columns[column][row])
    made = "no temperature" if np.isnan(became) else f"{became:.6g} degC"
    return InputError(
        f"{place.text}: column '{column}' holds '{show_text(text)}', which with its cold junction "
        f"'{cold}' at {degc:.6g} degC makes {made} by type {by.couple}; expected a temperature "
        f"in its range. Correct unit, scale or type in zerodrift.toml, or the row, {SKIP} it."
    )


# Opens one log: its rows, selected, checked and split into runs.


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
    joined = join_tables(config, tables, show_path(selection.path, config.directory), notes)
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
