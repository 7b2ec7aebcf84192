"""A column of the logs as zerodrift.toml names it: its name, or a table that says more."""

from dataclasses import dataclass

from zerodrift.base.conversion_config import (
    CONVERSION_KEYS,
    ConversionConfig,
    bring_to_unit,
    read_conversion,
)
from zerodrift.base.toml_table import TomlTable

RAW_BITS = {"int16": 16, "int32": 32}
COLUMN_KEYS = ("column", "raw", "lsb", "range", "no_reading")
LATER_KEYS = ("log_is",)
"""Of a column's table, but not built yet."""


@dataclass(frozen=True)
class CodesConfig:
    """What the chip is given of a column; None: chosen from the logs."""

    bits: int | None = None
    """16 or 32 (`raw`)."""
    lsb: float | None = None
    """What one code is worth, in the column's unit."""
    range: tuple[float, float] | None = None
    """What codes and flags must cover, in the column's unit."""
    no_reading: int | None = None
    """The code that means that there is none; None: the lowest of the type."""
    always_read: bool = False
    """Every code is a reading (`no_reading = false`)."""


def read_column(table: TomlTable, key: str) -> tuple[str, CodesConfig, ConversionConfig | None]:
    """Return the column that a key names, by its name or by a table, its codes and conversion.

    Raises:
        InputError: neither text nor a table, an unknown key, or a value of the wrong type or range.
    """
    if not isinstance(table.values.get(key), dict):
        return table.text(key), CodesConfig(), None
    inner = table.table(key, None)
    for name in inner.values:
        if name in LATER_KEYS:
            raise inner.error(
                name,
                f"{inner.label(name)} is a key of column tables that this version does not read "
                f"yet; expected {', '.join(COLUMN_KEYS)}. Take it out, and convert the log and "
                "what the firmware is given beforehand.",
            )
    inner.refuse_unknown(COLUMN_KEYS + CONVERSION_KEYS)
    bits = None
    if "raw" in inner.values:
        bits = RAW_BITS[inner.choice("raw", tuple(RAW_BITS), "")]
    found = inner.values.get("no_reading")
    no_reading = None
    if found is not None and found is not False:
        limit = 1 << ((bits or 32) - 1)
        no_reading = inner.integer("no_reading", -limit, limit - 1)
    codes = CodesConfig(
        bits=bits,
        lsb=inner.positive("lsb") if "lsb" in inner.values else None,
        range=_read_range(inner) if "range" in inner.values else None,
        no_reading=no_reading,
        always_read=found is False,
    )
    return inner.text("column"), codes, read_conversion(inner)


def read_quantity(table: TomlTable, key: str, unit: str) -> tuple[str, ConversionConfig | None]:
    """Return the column of an output, and how it is brought to the output's unit.

    Raises:
        InputError: as `read_column`.
    """
    if not isinstance(table.values.get(key), dict):
        return table.text(key), None
    inner = table.table(key, ("column", *CONVERSION_KEYS))
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
