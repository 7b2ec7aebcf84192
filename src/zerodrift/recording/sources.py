"""Where readings come from: a serial port, a CAN bus, an MQTT broker, an MCAP file, a command."""

import time
from dataclasses import dataclass
from typing import Protocol

from zerodrift.base.errors import InputError, nearest
from zerodrift.recording.lines import Values

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
