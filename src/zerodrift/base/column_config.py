"""Columns of the logs as zerodrift.toml states them: name and unit, times, conversion."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from zerodrift.base.errors import nearest
from zerodrift.base.records import OPTIONAL
from zerodrift.base.toml_table import TomlTable

# How zerodrift.toml states a log's times: column, unit or format, zone, offset.

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


# How a column of the logs becomes the quantity that the model takes, by zerodrift.toml.

KINDS = ("ntc", "pt100", "pt1000", "thermocouple", "table", "polynomial")
COUPLE_TYPES = ("B", "E", "J", "K", "N", "R", "S", "T")
"""Thermocouples of IEC 60584-1."""
TEMPERATURES = ("degC", "degF", "K")
CONVERSION_KEYS = (
    *("unit", "scale", "offset", "convert", "divider", "r25_ohm", "beta_K", "steinhart"),
    *("points", "coefficients", "type", "cold_junction"),
)
OWN_UNITS = {
    **dict.fromkeys(("ntc", "pt100", "pt1000"), ("ohm",)),
    "thermocouple": ("V", "mV", "uV"),
}
"""Conversion -> units that it is from."""
FACTORS = {
    **{"uV": ("V", 1e-6), "mV": ("V", 1e-3), "V": ("V", 1.0)},
    **{"uA": ("A", 1e-6), "mA": ("A", 1e-3), "A": ("A", 1.0)},
    **{"mN": ("N", 1e-3), "N": ("N", 1.0), "kN": ("N", 1e3)},
    **{"mNm": ("Nm", 1e-3), "Nm": ("Nm", 1.0)},
    **{"mg": ("g", 1e-3), "g": ("g", 1.0), "kg": ("g", 1e3)},
    **{"Pa": ("Pa", 1.0), "mbar": ("Pa", 100.0), "kPa": ("Pa", 1e3)},
    **{"bar": ("Pa", 1e5), "MPa": ("Pa", 1e6)},
    **{"ohm": ("ohm", 1.0), "kohm": ("ohm", 1e3)},
    **{"um": ("m", 1e-6), "mm": ("m", 1e-3), "m": ("m", 1.0)},
    **{"ppb": ("ppm", 1e-3), "ppm": ("ppm", 1.0)},
}
"""Unit -> (what it is a multiple of, by how much)."""


@dataclass(frozen=True)
class DividerConfig:
    """A series resistor and the sensor's resistor; a converter measures the voltage between
    them."""

    series_ohm: float
    is_low: bool
    """The sensor is between the middle and ground."""
    counts: float
    """The converter's counts at full range, which is the divider's supply."""
    rail: float = 0.0
    """Counts from either end within which the converter is at a rail: no reading."""


@dataclass(frozen=True)
class ConversionConfig:
    """Steps from a logged value to the quantity, in this order."""

    scale: float = 1.0
    offset: float = 0.0
    """value * scale + offset is in `unit`."""
    unit: str = ""
    divider: DividerConfig | None = None
    """From the share of the full counts to ohm."""
    kind: str = ""
    """ntc | pt100 | pt1000 | thermocouple | table | polynomial; empty: none. A model's file also
    has emf: `times` times the voltage of a thermocouple against 0 degC."""
    r25_ohm: float = 0.0
    beta_K: float = 0.0
    steinhart: tuple[float, ...] = ()
    points: tuple[tuple[float, float], ...] = ()
    coefficients: tuple[float, ...] = ()
    lacks: float | None = None
    """The logged value that means that there is no reading."""
    couple: str | None = field(default=None, metadata=OPTIONAL)
    """Type of the thermocouple; value * scale + offset is its voltage."""
    junction: str | None = field(default=None, metadata=OPTIONAL)
    """The input that measures its cold junction, in degC."""
    junction_degC: float | None = field(default=None, metadata=OPTIONAL)
    """Temperature of a cold junction that is constant, in degC."""
    times: float | None = field(default=None, metadata=OPTIONAL)


def read_conversion(table: TomlTable, *, of_code: bool = True) -> ConversionConfig | None:
    """Read the keys of a column's table that convert; None where it has none of them.

    Args:
        table: of the column.
        of_code: the log holds the values to convert; else only the chip's codes are converted, and
            the log's unit may be that of the result.

    Raises:
        InputError: a key is missing, contradicts another, or has a value of the wrong type.
    """
    if not any(key in table.values for key in CONVERSION_KEYS):
        return None
    kind = table.choice("convert", KINDS, "ntc") if "convert" in table.values else ""
    own = {"ntc": ("r25_ohm", "beta_K", "steinhart"), "table": ("points",)}
    own["polynomial"], own["thermocouple"] = ("coefficients",), ("type", "cold_junction")
    for owner, keys in own.items():
        for key in keys:
            if key in table.values and kind != owner:
                raise table.error(
                    key,
                    f'{table.label(key)} belongs to convert = "{owner}"; expected that beside it.',
                )
    unit = table.text("unit") if "unit" in table.values else ""
    divider = _read_divider(table) if "divider" in table.values else None
    results = () if of_code else TEMPERATURES
    units = OWN_UNITS.get(kind, ())
    if units and unit not in ("", *units, *results):
        hint = ', and log_is = "quantity" where the log holds the temperature itself'
        raise table.error(
            "unit",
            f"{table.label('unit')} is '{unit}', but convert = \"{kind}\" is from {units[0]}; "
            f'expected unit = "{units[0]}"{hint if unit in TEMPERATURES else ""}. Bring it to '
            f"{units[0]} by scale, or take one out.",
        )
    if divider is not None and kind not in ("ntc", "pt100", "pt1000"):
        raise table.error(
            "divider", f'{table.label("divider")} gives ohm; expected convert = "ntc".'
        )
    steinhart = _read_numbers(table, "steinhart", 3) if "steinhart" in table.values else ()
    has_beta = "r25_ohm" in table.values and "beta_K" in table.values
    points = _read_points(table) if kind == "table" else ()
    coefficients = _read_numbers(table, "coefficients") if kind == "polynomial" else ()
    if kind == "ntc" and has_beta == bool(steinhart):
        needed = "r25_ohm and beta_K, or steinhart = [A, B, C]"
        raise table.error("convert", f'convert = "ntc" needs {needed}, and not both.')
    return ConversionConfig(
        scale=table.number("scale", "a number") if "scale" in table.values else 1.0,
        offset=table.number("offset", "a number") if "offset" in table.values else 0.0,
        unit=unit,
        divider=divider,
        kind=kind,
        r25_ohm=table.positive("r25_ohm") if "r25_ohm" in table.values else 0.0,
        beta_K=table.positive("beta_K") if "beta_K" in table.values else 0.0,
        steinhart=steinhart,
        points=points,
        coefficients=coefficients,
        couple=_read_couple(table) if kind == "thermocouple" else None,
        junction=_read_junction(table) if kind == "thermocouple" else None,
        junction_degC=_read_junction_temperature(table) if kind == "thermocouple" else None,
    )


def sum_formula(by: ConversionConfig, fraction_bits: int) -> ConversionConfig:
    """Return the conversion of the sum of a thermocouple's code and its junction's voltage."""
    scale = by.scale / 2.0**fraction_bits
    return replace(by, scale=scale, junction=None, junction_degC=0.0)


def junction_formula(
    by: ConversionConfig, fraction_bits: int, lsb: float, offset: float
) -> ConversionConfig:
    """Return the conversion of a cold junction's code to its part of that sum.

    Args:
        by: of the thermocouple, from V.
        fraction_bits: of the sum.
        lsb: one code of the junction, in K.
        offset: the junction at its code 0, in degC.
    """
    times = 2.0**fraction_bits / by.scale
    return ConversionConfig(kind="emf", couple=by.couple, scale=lsb, offset=offset, times=times)


def bring_to_unit(by: ConversionConfig, unit: str, table: TomlTable) -> ConversionConfig:
    """Return a conversion whose result is in another unit than that of the log.

    Raises:
        InputError: the two units are not of one quantity.
    """
    if not by.unit or by.unit == unit or by.kind:
        return by
    base, factor = FACTORS.get(by.unit, ("", 1.0))
    wanted, per = FACTORS.get(unit, (" ", 1.0))
    if base != wanted:
        raise table.error(
            "unit",
            f"{table.label('unit')} is '{by.unit}', and the output's unit '{unit}', which no known "
            "factor brings together; expected units of one quantity. State scale instead.",
        )
    scale = factor / per
    return replace(by, scale=by.scale * scale, offset=by.offset * scale, unit=unit)


def _read_divider(table: TomlTable) -> DividerConfig:
    inner = table.table("divider", ("series_ohm", "side", "counts"))
    is_low = inner.choice("side", ("low", "high"), "low") == "low"
    return DividerConfig(inner.positive("series_ohm"), is_low, inner.positive("counts"))


def _read_couple(table: TomlTable) -> str:
    if "type" not in table.values:
        types = ", ".join(COUPLE_TYPES)
        raise table.error(
            "convert",
            f'convert = "thermocouple" needs type = "K" beside it; expected one of {types}.',
        )
    return table.choice("type", COUPLE_TYPES, "K")


def _read_junction(table: TomlTable) -> str | None:
    """Return the input that measures the cold junction; None where it has one temperature.

    Raises:
        InputError: neither is stated, though a thermocouple measures a difference.
    """
    if "cold_junction" not in table.values:
        raise table.error(
            "convert",
            'convert = "thermocouple" gives a difference of temperatures; expected cold_junction = '
            '"NAME", one of [inputs] in degC, beside it, or a number in degC where its cold '
            "junction is always at that.",
        )
    found = table.values["cold_junction"]
    return table.text("cold_junction") if isinstance(found, str) else None


def _read_junction_temperature(table: TomlTable) -> float | None:
    if isinstance(table.values.get("cold_junction"), str):
        return None
    return table.number("cold_junction", "the name of one of [inputs], or a number in degC")


def _read_numbers(table: TomlTable, key: str, count: int | None = None) -> tuple[float, ...]:
    found = table.values.get(key)
    expected = f"a list of {count} numbers" if count else "a list of numbers"
    if not isinstance(found, list) or not found or (count and len(found) != count):
        raise table.expect(key, expected)
    inner = (TomlTable(table.file, table.lines, table.key, {key: value}) for value in found)
    return tuple(each.number(key, expected) for each in inner)


def _read_points(table: TomlTable) -> tuple[tuple[float, float], ...]:
    found = table.values.get("points")
    expected = "a list of two or more [x, y]"
    if not isinstance(found, list) or len(found) < 2:
        raise table.expect("points", expected)
    points = []
    for pair in found:
        inner = TomlTable(table.file, table.lines, table.key, {"points": pair})
        x, y = _read_numbers(inner, "points", 2)
        points.append((x, y))
    steps = [after[0] - before[0] for before, after in pairwise(points)]
    if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
        raise table.expect("points", f"{expected}, x rising or falling throughout")
    return tuple(points if steps[0] > 0 else reversed(points))


# A column of the logs as zerodrift.toml names it: its name, or a table that says more.

RAW_CODES = {
    "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "int32": (-(2**31), 2**31 - 1),
}
"""`raw` -> lowest and highest code of the type."""
RAW_BITS = {"uint16": 16, "int16": 16, "int32": 32}
COLUMN_KEYS = ("column", "raw", "lsb", "range", "no_reading", "log_is", "missing")
RAIL_SHARE = 1024
"""A divider's converter within this part of its counts of either end stands at a rail: its sensor
is open or shorted. At least one code does."""


@dataclass(frozen=True)
class CodesConfig:
    """The codes of a column that the chip is given; a field that is None is chosen from the
    logs."""

    bits: int | None = None
    """16 or 32 (`raw`) where the chip is given the quantity's codes."""
    lsb: float | None = None
    """LSB of the quantity's codes, in the column's unit."""
    range: tuple[float, float] | None = None
    """Range that codes and flags must cover, in the column's unit."""
    no_reading: int | None = None
    """The code that means no reading; None: the lowest of the type, if that is signed."""
    always_read: bool = False
    """Every code is a reading (`no_reading = false`)."""
    raw: str = ""
    """Type of the raw codes that the chip is given, where they are not the quantity's codes."""
    by: ConversionConfig | None = None
    """From raw code to quantity; None: the LSB is `lsb`, or chosen from the logs."""


def read_column(table: TomlTable, key: str) -> tuple[str, CodesConfig, ConversionConfig | None]:
    """Return the column that a key names, by its name or by a table, its codes and conversion.

    Raises:
        InputError: neither text nor a table, an unknown key, or a value of the wrong type or range.
    """
    if not isinstance(table.values.get(key), dict):
        return table.text(key), CodesConfig(), None
    inner = table.table(key, COLUMN_KEYS + CONVERSION_KEYS)
    raw = inner.choice("raw", tuple(RAW_CODES), "") if "raw" in inner.values else ""
    of_code = inner.choice("log_is", ("quantity", "code"), "code") == "code"
    by = read_conversion(inner, of_code=of_code)
    found = inner.values.get("no_reading")
    least, most = RAW_CODES[raw or "int32"]
    no_reading = None
    if found is not None and found is not False:
        no_reading = inner.integer("no_reading", least, most)
    given = _find_chip_conversion(inner, by) if raw else None
    if "log_is" in inner.values and given is None:
        raise inner.error(
            "log_is",
            f"{inner.label('log_is')} says what the log holds where the chip converts its codes, "
            "and this table has no such conversion; expected raw and one of convert, scale or "
            "offset beside it. Add them, or take log_is out.",
        )
    if given is not None:
        given = _check_chip_conversion(inner, given, raw)
    codes = CodesConfig(
        bits=RAW_BITS[raw] if raw and given is None and raw != "uint16" else None,
        lsb=inner.positive("lsb") if "lsb" in inner.values else None,
        range=_read_range(inner) if "range" in inner.values else None,
        no_reading=no_reading,
        always_read=found is False,
        raw=raw if given is not None or raw == "uint16" else "",
        by=given,
    )
    if given is not None and by is not None:
        by = _find_log_conversion(by, given, no_reading) if of_code else _take_quantity(by)
    return inner.text("column"), codes, by


def _find_chip_conversion(table: TomlTable, by: ConversionConfig | None) -> ConversionConfig | None:
    """Return the conversion on the chip; None where its codes are the quantity's."""
    if by is None:
        return None
    if by.kind or by.divider is not None:
        return by
    is_stated = "scale" in table.values or "offset" in table.values
    return by if is_stated and "lsb" not in table.values else None


def _check_chip_conversion(table: TomlTable, by: ConversionConfig, raw: str) -> ConversionConfig:
    """Return a chip's conversion with the rails of its converter.

    Raises:
        InputError: it contradicts the type of the codes, or its table turns.
    """
    if by.scale == 0.0:
        raise table.error(
            "scale",
            f"{table.label('scale')} is 0, which makes one value of all codes; expected "
            "what one code is worth. Correct it.",
        )
    if by.kind == "table":
        steps = [after[1] - before[1] for before, after in pairwise(by.points)]
        wrong = [i for i, step in enumerate(steps) if step * steps[0] <= 0]
        if wrong:
            at = by.points[wrong[0] : wrong[0] + 2]
            raise table.error(
                "points",
                f"{table.label('points')} go from {list(at[0])} to {list(at[1])}, where y turns or "
                "stands; expected y that rises, or falls, throughout, since the chip tells one "
                "quantity by one code. Correct the points, or take raw out.",
            )
    if by.divider is None:
        if by.kind == "thermocouple":  # a table on the chip starts from V
            factor = FACTORS[by.unit or "V"][1] if by.unit not in TEMPERATURES else 1.0
            return replace(by, scale=by.scale * factor, offset=by.offset * factor, unit="")
        return replace(by, unit="" if by.kind else by.unit)
    counts, most = by.divider.counts, RAW_CODES[raw][1]
    last = ((counts - 1) - by.offset) / by.scale
    if last > most:
        raise table.error(
            "divider",
            f'{table.label("divider")} has counts = {counts:g}, but raw = "{raw}" ends at {most}; '
            "expected counts that its codes reach, or a wider raw type. Correct one of them.",
        )
    rail = float(max(counts // RAIL_SHARE, 1))
    return replace(by, unit="", divider=replace(by.divider, rail=rail))


def _find_log_conversion(
    by: ConversionConfig, given: ConversionConfig, no_reading: int | None
) -> ConversionConfig:
    """Return the conversion of a log that holds the chip's codes."""
    lacks = None if no_reading is None else float(no_reading)
    return replace(by, divider=given.divider, lacks=lacks)


def check_junctions(
    inputs: TomlTable, columns: Sequence[tuple[TomlTable, str, ConversionConfig | None]]
) -> None:
    """Refuse cold junctions that no input measures.

    Args:
        inputs: the table [inputs].
        columns: table, key and conversion of every column that may have one.

    Raises:
        InputError: there is no such input, or it is a thermocouple with a cold junction itself.
    """
    named = {key: by for table, key, by in columns if table is inputs}
    for table, key, by in columns:
        if by is None or by.junction is None:
            continue
        inner = TomlTable(table.file, table.lines, (*table.key, key), table.values)
        if by.junction not in inputs.values or by.junction == key:
            known = [name for name in inputs.values if name != key]
            found = f"[inputs] has {', '.join(known)}" if known else "[inputs] names none"
            raise inner.error(
                "cold_junction",
                f"{inner.label('cold_junction')} is '{by.junction}', which is no other input"
                f"{nearest(by.junction, known) or '.'} Found: {found}; expected the name of the "
                "thermometer at the cold junction. Add it to [inputs], or write its temperature "
                "as a number.",
            )
        of = named.get(by.junction)
        if of is not None and of.junction is not None:
            raise inner.error(
                "cold_junction",
                f"{inner.label('cold_junction')} is '{by.junction}', which is a thermocouple with "
                "a cold junction of its own; expected a thermometer that needs none.",
            )


def _take_quantity(by: ConversionConfig) -> ConversionConfig | None:
    """Return the conversion of a log that holds the quantity the chip's codes are converted to.

    For a resistor's conversion that is ohm, unless its unit is one of temperature.
    """
    if by.unit in TEMPERATURES:
        return None if by.unit == "degC" else ConversionConfig(unit=by.unit)
    if by.kind in OWN_UNITS:
        return replace(by, scale=1.0, offset=0.0, divider=None)
    return None


def read_quantity(table: TomlTable, key: str, unit: str) -> tuple[str, ConversionConfig | None]:
    """Return the column of an output, and how it is brought to the output's unit.

    Raises:
        InputError: as `read_column`.
    """
    if not isinstance(table.values.get(key), dict):
        return table.text(key), None
    inner = table.table(key, ("column", "missing", *CONVERSION_KEYS))
    by = read_conversion(inner)
    return inner.text("column"), None if by is None else bring_to_unit(by, unit, inner)


def _read_range(table: TomlTable) -> tuple[float, float]:
    found = table.values["range"]
    if isinstance(found, list) and len(found) == 2:
        ends = [TomlTable(table.file, table.lines, table.key, {"range": end}) for end in found]
        low, high = (end.number("range", "[lowest, highest], two numbers") for end in ends)
        if low < high:
            return low, high
    raise table.expect("range", "[lowest, highest], two numbers")
