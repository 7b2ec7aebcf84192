"""How a column of the logs becomes the quantity that the model takes, by zerodrift.toml."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

from zerodrift.base.records import OPTIONAL
from zerodrift.base.toml_table import TomlTable

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
