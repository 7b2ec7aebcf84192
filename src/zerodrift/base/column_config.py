"""A column of the logs as zerodrift.toml names it: its name, or a table that says more."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from zerodrift.base.conversion_config import (
    CONVERSION_KEYS,
    FACTORS,
    OWN_UNITS,
    TEMPERATURES,
    ConversionConfig,
    bring_to_unit,
    read_conversion,
)
from zerodrift.base.errors import nearest
from zerodrift.base.toml_table import TomlTable

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
