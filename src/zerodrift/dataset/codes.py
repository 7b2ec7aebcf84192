"""Calibration logs: converter codes and reference loads of one log, checked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.checks import (
    explain_invalid_row,
    find_invalid_rows,
    locate_row,
    widen_plausible,
)
from zerodrift.dataset.tables import Source, open_source, read_table

CODE_COLUMNS = tuple(f"adc_{number}" for number in range(1, 7))
REFERENCE_PREFIX = "ref_"
TEMPERATURE = "temperature_degC"
CONVERTER_BITS = (8, 10, 12, 14, 16, 18, 20, 24)
LONGEST_STUCK = 20
"""Equal extreme codes in a row, in a column that otherwise moves, are a rail."""


@dataclass(frozen=True)
class CalibrationLog:
    """One calibration log."""

    label: str
    """How messages name the file."""
    codes: Array
    """[n, C] converter codes."""
    loads: Array
    """[n, K] reference loads, each in its own unit."""
    temperature_degC: Array | None
    """[n]; None when the log has no such column."""
    dropped: int
    """Rows that held no numbers and were left out."""


def list_references(source: Source) -> tuple[str, ...]:
    """Return the columns of a log whose names begin with `ref_`."""
    return tuple(name for name in source.names if name.startswith(REFERENCE_PREFIX))


def read_calibration_log(
    path: Path,
    label: str,
    code_columns: Sequence[str],
    references: Sequence[str],
    skip_invalid: bool = False,
) -> CalibrationLog:
    """Read and check one calibration log.

    Args:
        path: the log, CSV or Parquet.
        label: how messages name it.
        code_columns: the converter's columns.
        references: the columns of the reference loads.
        skip_invalid: leave out rows that hold no numbers instead of raising.

    Raises:
        InputError: a column is missing, holds no numbers, never moves, or sits at a rail.
    """
    source = open_source(path, label, {})
    for name in code_columns:
        if name not in source.names:
            raise InputError(_explain_missing(source, name))
    needed = dict.fromkeys(code_columns, "--adc") | dict.fromkeys(references, "--reference")
    temperature = TEMPERATURE if TEMPERATURE in source.names else None
    if temperature is not None:
        needed[temperature] = "the temperature"
    table = read_table(source, needed, run_column=False)
    temperatures = {} if temperature is None else {temperature: widen_plausible(None)}
    invalid = find_invalid_rows(table, temperatures)
    dropped = 0
    if invalid is not None:
        dropped = int(invalid.sum())
        if not skip_invalid or dropped == len(table):
            raise explain_invalid_row(table, invalid, temperatures)
        table.take(~invalid)
    codes = np.stack([table.columns[name] for name in code_columns], axis=1)
    for name, column in zip(code_columns, codes.T, strict=True):
        row = find_saturated_row(column)
        if row is not None:
            place = locate_row(source, table.position(row))
            count = int(np.sum(column == column[row]))
            raise InputError(
                f"{place.text}: {name} is saturated at {column[row]:.0f} ({count} of "
                f"{column.size} rows); expected codes within the converter's range. Use lighter "
                "weights or less gain, or leave these rows out."
            )
    return CalibrationLog(
        label=label,
        codes=codes,
        loads=np.stack([table.columns[name] for name in references], axis=1),
        temperature_degC=None if temperature is None else table.columns[temperature],
        dropped=dropped,
    )


def _explain_missing(source: Source, name: str) -> str:
    names = [known for known in source.names if not known.startswith("\0")]
    place = f"{source.label}:1" if source.is_csv else source.label
    return (
        f"{place}: there is no column '{name}'{nearest(name, names) or '.'} Found: "
        f"{', '.join(names[:16])}{', ...' if len(names) > 16 else ''}; expected the converter's "
        f"codes in {', '.join(CODE_COLUMNS)}, or the columns named by --adc."
    )


def find_saturated_row(codes: Array) -> int | None:
    """Return the first row at which a column of codes [n] sits at a rail; None = nowhere.

    A rail is an end of a converter's range of 8 to 24 bits that the column never passes, met more
    than once in a row, or an extreme code that stands for `LONGEST_STUCK` rows in a column that
    moves from row to row elsewhere.
    """
    if codes.size < 2:
        return None
    for extreme, is_high in ((codes.max(), True), (codes.min(), False)):
        at = codes == extreme
        longest, begin = _find_longest(at)
        ends = {2.0**bits - 1.0 for bits in CONVERTER_BITS} if is_high else {0.0}
        ends |= {2.0 ** (b - 1) - 1.0 if is_high else -(2.0 ** (b - 1)) for b in CONVERTER_BITS}
        moves = float(np.mean(np.diff(codes) != 0)) > 0.3
        if (longest > 1 and float(extreme) in ends and codes.max() > codes.min()) or (
            moves and longest >= LONGEST_STUCK
        ):
            return begin
    return None


def _find_longest(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[int, int]:
    """Return the length and the first row of the longest stretch of true values."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - begins))
    return int(ends[longest] - begins[longest]), int(begins[longest])
