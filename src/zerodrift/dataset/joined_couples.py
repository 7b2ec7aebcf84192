"""Thermocouples whose cold junction another file of the run has: converted once both are joined."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import SKIP, find_invalid_values, show_text, widen_plausible
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.locate import locate_row
from zerodrift.dataset.tables import LogTable


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
