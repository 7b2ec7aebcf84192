"""A table of a file that may hold several: a sheet, a group, a topic, a kind of message."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

TIME = "time_s"
"""What readers call times that the format itself keeps, in seconds."""
MOST_ELEMENTS = 32
"""Arrays of more elements than this are no channels."""


@dataclass(frozen=True)
class FormatTable:
    """One table."""

    name: str
    frame: pl.DataFrame | None
    """The rows; None where they are in `text`."""
    units: Mapping[str, str] = field(default_factory=dict)
    text: Path | None = None
    """The rows as text, where header, units and the lines above them are still to be found."""

    @property
    def holds_rows(self) -> bool:
        """Tell whether there is anything to read."""
        return self.text is not None or (self.frame is not None and self.frame.height > 0)

    @property
    def holds_numbers(self) -> bool:
        """Tell whether there are numbers besides the times."""
        return self.frame is None or any(name != TIME for name in self.frame.columns)


class Recorder:
    """Messages of one topic, field by field, as columns."""

    def __init__(self) -> None:
        self._rows: list[dict[str, float]] = []

    def add(self, time_s: float, message: object) -> None:
        """Add one message with its numbers, at this time."""
        self._rows.append({TIME: time_s} | read_numbers(message))

    def finish(self, name: str) -> FormatTable:
        """Return the messages as a table, in the order of their times."""
        names = dict.fromkeys(key for row in self._rows for key in row)
        columns = {
            key: np.array([row.get(key, np.nan) for row in self._rows], dtype=np.float64)
            for key in names
        }
        frame = pl.DataFrame(columns)
        return FormatTable(name, frame.sort(TIME, maintain_order=True) if TIME in names else frame)


def read_numbers(message: object) -> dict[str, float]:
    """Return the numbers of a message by names such as `wrench.force.x`."""
    found: dict[str, float] = {}
    _flatten("", message, found, 0)
    return found


def _flatten(prefix: str, value: object, row: dict[str, float], depth: int) -> None:
    """Write the numbers of a value, and of those within it, into a row."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        row[prefix or "value"] = float(value)
        return
    if depth > 8 or value is None or isinstance(value, str | bytes):
        return
    if isinstance(value, np.ndarray | list | tuple):
        if 0 < len(value) <= MOST_ELEMENTS:
            for index, each in enumerate(value):
                _flatten(f"{prefix}[{index}]", each, row, depth + 1)
        return
    if isinstance(value, dict):
        fields = list(value.items())
    else:
        slots = getattr(value, "__slots__", None)
        names = tuple(slots or getattr(value, "__dataclass_fields__", ()) or ())
        fields = [(name, getattr(value, name, None)) for name in names]
    for name, each in fields:
        if str(name).startswith("_") or (depth == 0 and name == "header"):
            continue
        _flatten(f"{prefix}.{name}" if prefix else str(name), each, row, depth + 1)


def read_stamp(message: object) -> float | None:
    """Return the seconds of a ROS message's header, or None where it has none that is set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None and isinstance(message, dict):
        header = message.get("header")
        stamp = header.get("stamp") if isinstance(header, dict) else None
    if stamp is None:
        return None
    parts = stamp if isinstance(stamp, dict) else {k: getattr(stamp, k, None) for k in _STAMP}
    seconds = parts.get("sec", parts.get("secs"))
    nanos = parts.get("nanosec") if parts.get("nanosec") is not None else parts.get("nsec")
    if not isinstance(seconds, int | np.integer) or not isinstance(nanos, int | np.integer):
        return None
    return int(seconds) + 1e-9 * int(nanos) if seconds or nanos else None


_STAMP = ("sec", "nanosec", "nsec")
"""What a stamp calls its seconds and nanoseconds."""
