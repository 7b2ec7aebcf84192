"""The LSB of an input by zerodrift.toml alone: the same for every unit of a design.

In projects of format 1 each unit's training logs decide it; from format 2 on they do not.
"""

import math

from zerodrift.base.column_config import CodesConfig
from zerodrift.base.config import Config, locate_key
from zerodrift.base.conversion_config import TEMPERATURES, ConversionConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.code_format import CLOCK
from zerodrift.dataset.raw_codes import find_linear

DESIGN_FORMAT = 2
"""`format` in zerodrift.toml from which on codes do not follow from a unit's logs."""
TEMPERATURE_LSB_DEGC = 0.0078125
"""One count of the TMP117, 2**-7 K (Texas Instruments, TMP117 data sheet, temperature register)."""
CLOCK_LSB_S = 1.0
FILLED = {16: 2.0**14, 32: 2.0**30}
"""Bits of a code -> the code that the largest value is given, at most; twice it is held."""
THERMOMETERS = ("ntc", "pt100", "pt1000", "thermocouple")
"""`convert` that ends in degC."""


def find_design_lsb(config: Config, name: str) -> float | None:
    """Return the LSB of an input, in its unit; None: zerodrift.toml does not state it.

    As stated; else 1 s for the clock, the slope of a linear conversion, 2**-7 K for a thermometer,
    or the power of two by which the stated range fills 15 of 16 bits (31 of 32).
    """
    stated = config.input_codes.get(name, CodesConfig())
    if stated.lsb is not None:
        return stated.lsb
    if name == CLOCK:
        return CLOCK_LSB_S
    linear = None if stated.by is None else find_linear(stated.by)
    if linear is not None:
        return abs(linear[0])
    if is_thermometer(name, config.inputs[name], stated.by or config.conversions.get(name)):
        return TEMPERATURE_LSB_DEGC
    if stated.range is not None:
        return fill_codes(max(map(abs, stated.range)), stated.bits or 16)
    return None


def is_thermometer(name: str, column: str, by: ConversionConfig | None = None) -> bool:
    """Tell whether an input is a temperature in degC, by its name, column or conversion."""
    if by is not None and (by.kind in THERMOMETERS or by.unit in TEMPERATURES):
        return True
    return "temperature" in name or column.endswith("degC")


def fill_codes(largest: float, bits: int) -> float:
    """Return the power-of-two LSB at which the largest value fills at most half the range."""
    return float(2.0 ** math.ceil(math.log2(max(largest, 1e-30) / FILLED[bits])))


def propose_codes(
    name: str, column: str, low: float, high: float, is_degc: bool
) -> tuple[str, float]:
    """Return `raw` and `lsb` for a new project's input whose logs reach from low to high.

    Args:
        name: the input's.
        column: its column.
        low: lowest value of all logs.
        high: highest value of all logs.
        is_degc: it is known to be a thermometer in degC.
    """
    largest = max(abs(low), abs(high))
    if is_degc or is_thermometer(name, column):
        is_short = largest < (2.0**15 - 1) * TEMPERATURE_LSB_DEGC / 1.25
        return ("int16" if is_short else "int32"), TEMPERATURE_LSB_DEGC
    return "int16", fill_codes(largest, 16)


def require_design_lsb(config: Config, name: str) -> float:
    """Return `find_design_lsb`.

    Raises:
        InputError: zerodrift.toml does not state it.
    """
    found = find_design_lsb(config, name)
    if found is not None:
        return found
    raise InputError(
        f"{locate_key(config.path, 'inputs', name)}: '{name}' states neither lsb nor range; "
        f"expected one of them, as from format = {DESIGN_FORMAT} on a code is worth the same for "
        "every unit of the design, whatever its logs hold. `zerodrift init --upgrade` writes one "
        f'that holds the logs, or write {name} = {{ column = "{config.inputs[name]}", range = '
        "[LOWEST, HIGHEST] }."
    )


def list_unstated(config: Config) -> list[str]:
    """Return the inputs whose LSB zerodrift.toml does not state."""
    return [name for name in config.inputs if not explain_stated(config, name)]


def explain_stated(config: Config, name: str) -> str:
    """Return how zerodrift.toml states the LSB; empty: the logs decide it, in format 1."""
    stated = config.input_codes.get(name, CodesConfig())
    linear = None if stated.by is None else find_linear(stated.by)
    if name == CLOCK:
        return "whole seconds"
    if linear is not None:
        return "the hardware's own codes"
    if stated.lsb is not None and (stated.bits is not None or stated.raw):
        return "it states raw and lsb"
    if config.format >= DESIGN_FORMAT and find_design_lsb(config, name) is not None:
        return f"format = {DESIGN_FORMAT} says what a code is worth"
    return ""
