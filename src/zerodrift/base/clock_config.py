"""How zerodrift.toml states a log's times: column, unit or format, zone, offset."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from zerodrift.base.errors import nearest
from zerodrift.base.toml_table import TomlTable

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Unit of a time column -> seconds."""
ROW_TIME = "(row)"
"""Stands for the time column where `[logs] period_s` makes the times."""
_FIXED = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d\d))?|UTC|GMT|Z")


@dataclass(frozen=True)
class TimeConfig:
    """A column of times, as a name or as a table."""

    columns: tuple[str, ...] = ()
    """Its column; two where the date and the time of day have one each."""
    unit: str = ""
    """Of numbers: s | ms | us | ns | min | h; empty where the table states none."""
    format: str = ""
    """Of text, by the codes of strftime; empty: ISO 8601 or HH:MM:SS."""
    zone: str = ""
    """Zone of text that has none: a name such as Europe/Berlin, or +02:00; empty: not known."""

    @property
    def name(self) -> str:
        """Return what the times are called among a table's columns."""
        return " ".join(self.columns)


@dataclass(frozen=True)
class ClockConfig:
    """Settings of the logs' clocks besides `[sensor] time`; patterns match file names."""

    periods_s: Mapping[str, float] = field(default_factory=dict)
    """Pattern -> interval between rows in s, for logs without a column of times."""
    offsets_s: Mapping[str, float] = field(default_factory=dict)
    """Pattern -> seconds to add to the log's times."""
    times: Mapping[str, TimeConfig] = field(default_factory=dict)
    """Pattern -> its times, where they are not as `[sensor] time` says."""
    common: tuple[str, ...] = ()
    """Columns of one quantity that several logs of a run record: one name, or one per log."""

    def period_s(self, path: Path) -> float | None:
        """Return the interval between a log's rows that zerodrift.toml states, if it does."""
        return next((s for name, s in self.periods_s.items() if fits(path, name)), None)

    def offset_s(self, path: Path) -> float | None:
        """Return the seconds to add to a log's times that zerodrift.toml states, if it does."""
        return next((s for name, s in self.offsets_s.items() if fits(path, name)), None)

    def time(self, path: Path, usual: TimeConfig) -> TimeConfig:
        """Return how a log's times are written."""
        return next((each for name, each in self.times.items() if fits(path, name)), usual)


def fits(path: Path, pattern: str) -> bool:
    """Tell whether a file's path ends in what the pattern names: `env*.csv`, `a/env.csv`."""
    parts = pattern.count("/") + 1
    return fnmatchcase("/".join(path.parts[-parts:]), pattern)


def _read_zone(table: TomlTable) -> str:
    """Return a zone's name, or a difference to UTC.

    Raises:
        InputError: this machine has a list of zones, and none of that name.
    """
    zone = table.text("zone")
    if read_fixed_zone(zone) is not None:
        return zone
    try:
        ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        names = available_timezones()
        if names and zone not in names:
            raise table.error(
                "zone",
                f"there is no time zone '{zone}'; expected a name such as Europe/Berlin, or "
                f"a difference to UTC such as +02:00{nearest(zone, names) or '.'} Correct "
                f"{table.label('zone')}.",
            ) from None
    return zone


def read_fixed_zone(zone: str) -> float | None:
    """Return the seconds by which a zone such as `-05:00` is before UTC; None for a name."""
    match = _FIXED.fullmatch(zone.strip())
    if match is None:
        return None
    sign, hours, minutes = match.groups()
    if sign is None:
        return 0.0
    return (1 if sign == "+" else -1) * (3600.0 * int(hours) + 60.0 * int(minutes or 0))


def read_time(table: TomlTable, key: str) -> TimeConfig:
    """Read a column of times, as a name or a table of column, unit, format and zone.

    Raises:
        InputError: neither, an unknown key, or a value of the wrong type.
    """
    if not isinstance(table.values.get(key), dict):
        return TimeConfig((table.text(key),))
    inner = table.table(key, ("column", "unit", "format", "zone"))
    found = inner.values.get("column")
    columns: tuple[str, ...]
    if isinstance(found, list):
        columns = inner.texts("column")
        if len(columns) > 2:
            raise inner.expect("column", 'a column, or two: ["Date", "Time"]')
    else:
        columns = (inner.text("column"),)
    stated = [name for name in ("unit", "format") if name in inner.values]
    if len(stated) == 2:
        raise inner.error(
            "format",
            f"{inner.label('unit')} and {inner.label('format')} contradict each other; expected "
            "a unit for numbers, or a format for text. Take one out.",
        )
    return TimeConfig(
        columns,
        inner.choice("unit", tuple(TIME_UNITS), "s") if "unit" in inner.values else "",
        inner.text("format") if "format" in inner.values else "",
        _read_zone(inner) if "zone" in inner.values else "",
    )


def read_clocks(logs: TomlTable) -> ClockConfig:
    """Read `[logs] period_s`, `offset_s`, `time` and `common`."""
    times: dict[str, TimeConfig] = {}
    if "time" in logs.values:
        table = logs.table("time", None)
        times = {pattern: read_time(table, pattern) for pattern in table.values}
    common: tuple[str, ...] = ()
    if "common" in logs.values:
        is_name = isinstance(logs.values["common"], str)
        common = (logs.text("common"),) if is_name else logs.texts("common")
    periods_s, offsets_s = _read_seconds(logs, "period_s"), _read_seconds(logs, "offset_s")
    return ClockConfig(periods_s, offsets_s, times, common)


def _read_seconds(logs: TomlTable, key: str) -> dict[str, float]:
    """Read a number, or a table of file pattern -> number."""
    if key not in logs.values:
        return {}
    is_table = isinstance(logs.values[key], dict)
    table = logs.table(key, None) if is_table else logs
    found: dict[str, float] = {}
    for pattern in table.values if is_table else (key,):
        if key == "period_s":
            value = table.positive(pattern)
        else:
            value = table.number(pattern, "a number of seconds, or a table of file = seconds")
        found[pattern if is_table else "*"] = value
    return found
