"""Lines of text become values by name: columns, JSON objects, or `name=value` pairs."""

import json
import math
import re

from zerodrift.base.errors import InputError

Values = dict[str, float]
_PAIR = re.compile(
    r"([A-Za-z_][\w.\[\]/%°-]*)\s*[=:]\s*([-+]?[\d.][\w.+-]*|[-+]?(?:nan|inf)\w*)", re.I
)
_DELIMITERS = (";", "\t", ",", None)
"""None: any white space."""
LONGEST = 10_000
"""Bytes of a line; a source that sends more without an end of line sends no lines."""


class LineError(ValueError):
    """A line that is no row; its text says why."""


class LineReader:
    """Reads the lines of one source, in the form that the first ones show.

    Args:
        columns: names of the columns, for a source that sends numbers alone.
    """

    def __init__(self, columns: tuple[str, ...] = ()) -> None:
        check_names(columns)
        self._columns = columns
        self._delimiter: str | None = None
        self._known = False

    def read(self, text: str) -> Values | None:
        """Return a row's values; None for a header, a comment or an empty line.

        Raises:
            LineError: it is no row of this source.
        """
        line = text.strip().lstrip("\ufeff")
        if not line or line.startswith(("#", "//")):
            return None
        if line.startswith("{"):
            return _read_object(line)
        pairs = _PAIR.findall(line)
        if pairs and not self._columns:
            return {name: _read_number(value) for name, value in pairs}
        return self._read_columns(line)

    def _read_columns(self, line: str) -> Values | None:
        if not self._known:
            self._delimiter = next(d for d in _DELIMITERS if d is None or d in line)
            self._known = True
        cells = [cell.strip().strip('"') for cell in line.split(self._delimiter)]
        if len(cells) > 1 and not cells[-1]:
            cells.pop()  # a delimiter at the end of every row
        if not self._columns:
            if any(_is_number(cell) for cell in cells):
                raise LineError(
                    f"'{_cut(line)}' came before any names; expected a header line, or --columns"
                )
            try:
                check_names(tuple(cells))
            except InputError as error:
                raise LineError(str(error)) from None
            self._columns = tuple(cells)
            return None
        if tuple(cells) == self._columns:
            return None  # the device began again, and sent its header again
        if len(cells) != len(self._columns):
            raise LineError(
                f"'{_cut(line)}' has {len(cells)} values; expected {len(self._columns)}"
            )
        comma = self._delimiter != ","
        return {
            name: _read_number(cell.replace(",", ".") if comma else cell)
            for name, cell in zip(self._columns, cells, strict=True)
        }


def check_names(columns: tuple[str, ...]) -> None:
    """Refuse names that a log cannot have.

    Raises:
        InputError: a name is empty, or stands twice.
    """
    for name in columns:
        if not name:
            raise InputError(
                f"columns {', '.join(columns)}: one has no name; expected one for each."
            )
        if columns.count(name) > 1:
            raise InputError(
                f"columns {', '.join(columns)}: '{name}' appears twice; expected it once."
            )


def _read_object(line: str) -> Values:
    try:
        found = json.loads(line)
    except ValueError as error:
        raise LineError(f"'{_cut(line)}' is no JSON object: {error}") from None
    return flatten(found)


def flatten(found: object, prefix: str = "") -> Values:
    """Return the numbers of a JSON object, those within inner ones as `outer.inner`."""
    values: Values = {}
    if isinstance(found, dict):
        for name, value in found.items():
            values |= flatten(value, f"{prefix}.{name}" if prefix else str(name))
    elif isinstance(found, list):
        for index, value in enumerate(found):
            values |= flatten(value, f"{prefix}[{index}]")
    elif isinstance(found, int | float):  # true and false are 1 and 0
        values[prefix] = float(found)
    return values


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _read_number(cell: str) -> float:
    """Return a number; nothing and "nan" are no reading."""
    if not cell or cell.lower() in ("nan", "na", "null", "-", "none"):
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise LineError(f"'{_cut(cell)}' is no number") from None


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."
