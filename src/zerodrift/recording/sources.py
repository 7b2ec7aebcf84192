"""Where readings come from, and the values in a line of text by name."""

import json
import math
import re
import time
from dataclasses import dataclass
from typing import Protocol

from zerodrift.base.errors import InputError, nearest

# Lines of text become values by name: columns, JSON objects, or `name=value` pairs.

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


# Where readings come from: a serial port, a CAN bus, an MQTT broker, an MCAP file, a command.

FORMS = {
    "serial": "serial:PORT[@BAUD], such as serial:/dev/ttyUSB0@115200",
    "can": "can:INTERFACE:CHANNEL[@BITRATE], such as can:socketcan:can0, with --dbc FILE",
    "mqtt": "mqtt:HOST[:PORT]/TOPIC, such as mqtt:localhost/chamber/#",
    "mcap": "mcap:FILE[#TOPIC,TOPIC], such as mcap:bag/bag_0.mcap#/ft/wrench",
    "command": "command:COMMAND LINE, such as 'command:candump can0'",
    "-": "-, lines on standard input",
}
"""Kind of a source -> how it is written."""
MQTT_PORT = 1883


@dataclass(frozen=True)
class Reading:
    """Values that arrived at one moment."""

    at_s: float
    """When it arrived, in s of the monotonic clock; or the source's own time, if it has one."""
    values: Values


@dataclass(frozen=True)
class SourceText:
    """A source as it is written on the command line."""

    kind: str
    """serial | can | mqtt | mcap | command | -."""
    place: str
    """Port, channel, host, file or command line."""
    detail: str = ""
    """Interface of a CAN bus, topic of a broker, topics of a file with commas between."""
    number: int = 0
    """Baud, bits per second, or port; 0: none was given."""


class LiveSource(Protocol):
    """A source of readings."""

    is_rows: bool
    """Whether each reading is a row; else they are parts, put together at a period."""
    has_times: bool
    """Whether readings carry the source's own Unix times in s; rows are then made at those."""

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return the readings that have arrived; None: the source has ended.

        Waits at most `timeout_s` for the first.

        Raises:
            InputError: the source has failed.
        """
        ...

    def explain_wait(self) -> str:
        """Return what is still waited for, for people; nothing where that is not known."""
        ...

    def list_strays(self) -> list[str]:
        """Return a sentence for each kind of input that came and is in no row."""
        ...

    def close(self) -> None:
        """Close the source."""
        ...


def parse_source(text: str) -> SourceText:
    """Read a source as it is written.

    Raises:
        InputError: it has none of the forms in `FORMS`.
    """
    if text == "-":
        return SourceText("-", "-")
    kind, colon, rest = text.partition(":")
    if kind not in FORMS or kind == "-":
        known = "; ".join(FORMS.values())
        raise InputError(f"source '{text}': expected one of {known}{nearest(kind, FORMS)}")
    if kind in ("command", "mcap"):
        place, number = rest, ""
    else:
        place, _, number = rest.partition("@")
    if kind == "mqtt":
        host, slash, topic = place.removeprefix("//").partition("/")
        host, _, number = host.partition(":")
        if not (host and slash and topic):
            raise InputError(f"source '{text}': expected {FORMS[kind]}")
        return SourceText(kind, host, topic, _read_count(number or str(MQTT_PORT), text))
    if kind == "can":
        interface, _, channel = place.partition(":")
        if not (interface and channel):
            raise InputError(f"source '{text}': expected {FORMS[kind]}")
        return SourceText(kind, channel, interface, _read_count(number or "0", text))
    if not (colon and place.strip()):
        raise InputError(f"source '{text}': expected {FORMS[kind]}")
    if kind == "mcap":
        file, mark, topics = place.rpartition("#")
        return SourceText(kind, file, topics) if mark else SourceText(kind, place)
    return SourceText(kind, place, number=_read_count(number or "0", text))


def _read_count(text: str, source: str) -> int:
    if not text.isdecimal():
        raise InputError(f"source '{source}': '{text}' is no whole number")
    return int(text)


def now_s() -> float:
    """Return the monotonic clock in s."""
    return time.monotonic()
