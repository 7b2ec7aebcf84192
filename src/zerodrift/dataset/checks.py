"""Checks of a log's values, and the line of a file that failed one."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import PARSER_ERRORS, LogTable, Source, mend_source, write_text
from zerodrift.dataset.text_format import list_lines
from zerodrift.dataset.times import find_zone
from zerodrift.dataset.units import read_unit, write_local

# The second pass over a file: line and text of a row that failed a check.


@dataclass(frozen=True)
class RowPlace:
    """Where a row stands in its file."""

    text: str
    """`chamber_1.csv:17`, or `chamber_1.parquet: row 16` (rows count from 1)."""
    values: dict[str, str | None]
    """The row's fields as text; None where there is none."""


def locate_row(source: Source, position: int) -> RowPlace:
    """Return the place of the row at `position` (from 0) among the rows that the filter keeps.

    Raises:
        InputError: the row cannot be read as text either: it is not UTF-8, or its fields are
            quoted so that the lines cannot be separated.
    """
    try:
        frame = source.scan().slice(position, 1)
        names = frame.collect_schema().names()
        found = frame.select(write_text(name, frame) for name in names).collect()
    except PARSER_ERRORS as error:
        return locate_row(mend_source(source, error), position)
    if found.is_empty():
        raise InputError(_explain_quotes(source))
    values: dict[str, str | None] = found.row(0, named=True)
    record = int(values.pop("_row") or 0)
    if not source.is_csv:
        return RowPlace(f"{source.label}: row {record + 1}", values)
    return RowPlace(f"{source.label}:{_find_line(source, record)}", values)


def find_blank_rows(source: Source) -> list[int]:
    """Return the positions of a CSV's blank lines, which the parser takes for rows without fields.

    Where a row filter is set there is nothing to find: blank lines do not pass it.
    """
    if not source.is_csv or source.where:
        return []
    lines = list_lines(*source.parsed)
    return [row for row, (_, line) in enumerate(lines) if not line.strip()]


def _explain_quotes(source: Source) -> str:
    """Return the message for a file whose rows depend on how its quotation marks are read."""
    opened, is_open = 1, False
    with source.path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if line.count(b'"') % 2 == 1:
                opened, is_open = (number, True) if not is_open else (opened, False)
    if not is_open:
        return (
            f"{source.label}: its quotation marks leave open where rows end; expected none but "
            "around whole fields. Write the log anew without them."
        )
    return (
        f"{source.label}:{opened}: a quotation mark opens a field that is not closed; expected "
        "them in pairs around a field. Close or remove it."
    )


def _find_line(source: Source, record: int) -> int:
    """Return the 1-based line on which a record ends; a quoted field may hold line breaks."""
    current, last, is_quoted = -1, 1, False
    for number, line in list_lines(*source.parsed):
        last = number
        current += not is_quoted
        is_quoted ^= line.count(b'"') % 2 == 1
        if current == record and not is_quoted:
            break
    return last


# Checks of a log's values: vectorised first; only a failed check looks for the line.

Limits = tuple[float, float]
"""Lowest and highest value."""

UNREADY_DEGC = -256.0
"""What a TMP117 reports before its first conversion (code 0x8000; datasheet, table 7-2)."""
COLDEST_DEGC = -200.0
HOTTEST_DEGC = 500.0
LARGEST = 1e30
"""No measured value is larger, in any unit; powers of it stay finite in double precision."""
SKIP = "or pass --skip-invalid to drop"


def widen_plausible(stated: tuple[float, float] | None) -> Limits:
    """Return the plausible temperatures in degC, wider where the sensor's stated range is."""
    low, high = stated or (COLDEST_DEGC, HOTTEST_DEGC)
    return min(low, COLDEST_DEGC), max(high, HOTTEST_DEGC)


def find_invalid_rows(table: LogTable, temperatures: Mapping[str, Limits]) -> Mask | None:
    """Return the rows [n] with a value that is not finite or an implausible temperature; None =
    none.

    Args:
        table: the parsed log.
        temperatures: columns in degC -> lowest and highest plausible value.
    """
    invalid: Mask | None = None
    for column in table.columns:
        wrong = find_invalid_values(table.columns[column], temperatures.get(column))
        if wrong is not None:
            invalid = wrong if invalid is None else invalid | wrong
    return invalid


def find_invalid_values(values: Array, temperature: Limits | None) -> Mask | None:
    """Return where a column is invalid; None, without making a mask, when it is nowhere."""
    if temperature is None:
        # One pass without a mask: no value is larger than the root of the sum of squares.
        with np.errstate(over="ignore", invalid="ignore"):
            if np.dot(values, values) <= LARGEST**2:
                return None
    low, high = temperature or (-LARGEST, LARGEST)
    if temperature is not None and values.min() >= low and values.max() <= high:
        return None
    invalid = ~(np.isfinite(values) & (values >= low) & (values <= high))
    return invalid if invalid.any() else None


def explain_invalid_row(
    table: LogTable, invalid: Mask, temperatures: Mapping[str, Limits]
) -> InputError:
    """Return the error for the first invalid row, with its line and its text."""
    row = int(np.argmax(invalid))
    place = locate_row(table.source, table.position(row))
    for column, values in table.columns.items():
        if find_invalid_values(values[row : row + 1], temperatures.get(column)) is not None:
            break
    count = int(invalid.sum())
    rows = "this row" if count == 1 else f"the {count} such rows"
    # In a run of several files a column may be called `FILE:NAME`.
    text = place.values.get(column, place.values.get(column.partition(":")[2]))
    value = float(values[row])
    clock = table.clock
    if clock is not None and column == clock.name and clock.kind != "number":
        shown = " ".join(place.values.get(name) or "" for name in clock.columns).strip()
        return InputError(
            f"{place.text}: {column} holds '{show_text(shown)}', which is no time like those of "
            f"the other rows; expected one. Correct the row, {SKIP} {rows}."
        )
    if text is None or not text.strip():
        return InputError(
            f"{place.text}: column '{column}' is empty; expected a number. Fill it in, {SKIP} "
            f"{rows}."
        )
    if np.isnan(value) and column in table.converted:
        return InputError(
            f"{place.text}: column '{column}' holds '{show_text(text)}', which its conversion in "
            f"zerodrift.toml does not cover; expected a value that it does. Correct scale, "
            f"divider or table, or the row, {SKIP} {rows}."
        )
    if np.isnan(value) and text.strip().lower().lstrip("+-") != "nan":
        hint = _explain_text(text)
        return InputError(
            f"{place.text}: column '{column}' holds '{show_text(text)}', which is no number; "
            f"expected a finite number.{hint} Correct the row, {SKIP} {rows}."
        )
    if not np.isfinite(value):
        return InputError(
            f"{place.text}: column '{column}' is {text.strip()}; expected a finite number. "
            f"Correct the row, {SKIP} {rows}."
        )
    if column not in temperatures:
        return InputError(
            f"{place.text}: column '{column}' is {text.strip()}; expected a measured value, within "
            f"{LARGEST:g} of 0. Correct the row, {SKIP} {rows}."
        )
    if value == UNREADY_DEGC:
        return InputError(
            f"{place.text}: {column} is -256 degC; the chip reports that before its first "
            f"conversion; expected a measured temperature. Drop the row, {SKIP} {rows}."
        )
    low, high = temperatures[column]
    hint = guess_temperature_unit(column, values[np.isfinite(values)])
    return InputError(
        f"{place.text}: {column} is {value:g} degC; expected {low:g} to {high:g} degC.{hint} "
        f"Correct the unit or the row, {SKIP} {rows}; for a sensor that measures beyond, write "
        f'{{ column = "{column}", range = [low, high] }}.'
    )


def show_text(text: str) -> str:
    """Return the first characters of a field, those that do not print as their codes."""
    return "".join(each if each.isprintable() else f"\\x{ord(each):02x}" for each in text[:40])[:60]


def _explain_text(text: str) -> str:
    """Return a hint at why a field that was meant as a number is none, or an empty string."""
    bare = text.strip()
    if bare.count(",") == 1 and bare.replace(",", "").lstrip("+-").isdigit():
        return " Write the decimals with a point."
    if bare != text and bare.replace(".", "").lstrip("+-").isdigit():
        return " Remove the spaces after the number."
    return ""


def guess_temperature_unit(column: str, values: Array) -> str:
    """Return a hint at the unit that temperatures may be in if not degC, or an empty string."""
    middle = float(np.median(values))
    whole = bool(np.all(values == np.round(values)))
    if whole and abs(middle) > HOTTEST_DEGC:
        return (
            f" Whole numbers around {middle:g} look like raw codes or hundredths: a TMP117 gives "
            "0.0078125 degC per LSB."
        )
    if read_unit(column) == "K" or 230 < middle < 360:
        return f" Values around {middle:g} look like kelvin: subtract 273.15."
    if read_unit(column) == "degF" or HOTTEST_DEGC < middle < 1000:
        return f" Values around {middle:g} look like degF: subtract 32, then multiply by 5/9."
    return ""


def check_time(table: LogTable, column: str, start: int, stop: int) -> None:
    """Raise InputError unless the times of rows `start` to `stop`, one run, rise."""
    time_s = table.columns[column][start:stop]
    interval_s = np.diff(time_s)
    if interval_s.size == 0 or interval_s.min() > 0:
        return
    wrong = interval_s <= 0
    row = start + 1 + int(np.argmax(wrong))
    count = int(find_late_rows(time_s).sum())
    rows = "the row that does" if count == 1 else f"the {count} rows that do"
    before, now = float(table.columns[column][row - 1]), float(table.columns[column][row])
    place = locate_row(table.source, table.position(row))
    if now == before:
        raise InputError(
            f"{place.text}: {column} repeats {now:.10g} s; expected rising times within a run. "
            "Write the time with more digits, select one unit of several by [logs] where, "
            f"{SKIP} {rows} not move on."
        )
    is_local = table.clock is not None and table.clock.kind == "local"
    told = [write_local(time) if is_local else f"{time:.10g}" for time in (before, now)]
    hint = ""
    if table.clock is not None and is_local and (zone := find_zone(time_s[row - start - 1 :][:2])):
        columns = table.clock.columns
        named = json.dumps(list(columns) if len(columns) > 1 else columns[0], ensure_ascii=False)
        hint = (
            " If the clock was put back here in autumn, say where it stood: [sensor] time = "
            f'{{ column = {named}, zone = "{zone}" }}.'
        )
    raise InputError(
        f"{place.text}: {column} goes back from {told[0]} to {told[1]}{'' if is_local else ' s'}; "
        f"expected rising times within a run.{hint} If a new run begins here, split the file or add"
        f" a `run` column; if a counter wrapped, unwrap it; {SKIP} {rows} not move on."
    )


def find_late_rows(time_s: Array) -> Mask:
    """Return the rows whose time is not later than that of every row before."""
    late = np.zeros(time_s.size, dtype=np.bool_)
    late[1:] = time_s[1:] <= np.maximum.accumulate(time_s)[:-1]
    return late


def check_period(
    label: str, median_s: float, sample_period_s: float, coarsest: float, where: str
) -> None:
    """Raise InputError when a log is too coarse for the firmware's step."""
    if median_s <= coarsest * sample_period_s:
        return
    raise InputError(
        f"{label}: a row every {median_s:.4g} s, but {where} sets sample_period_s = "
        f"{sample_period_s:g}; expected a row at least every {coarsest * sample_period_s:.4g} s, "
        f"as what lies between rows cannot be made up. Set sample_period_s = {median_s:.4g}, "
        "or log faster."
    )
