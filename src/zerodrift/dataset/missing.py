"""Values that mean that there is none (`missing` in zerodrift.toml) are taken out, with a note."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Mask
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import LogTable, write_text


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
