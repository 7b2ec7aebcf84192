"""Names of a model, its inputs and its outputs in the C."""

from zerodrift.codegen.identifiers import (
    sanitize_identifiers,
    sanitize_outputs,
    sanitize_prefix,
)
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)


def name_prefix(model: IntegerModel) -> str:
    """Return what every name of the model's C begins with."""
    return sanitize_prefix(model.prefix or model.name)


def name_channels(model: IntegerModel) -> list[str]:
    """Return the fields of the input struct, one per channel."""
    return sanitize_identifiers((c.name for c in model.channels), "input")


def name_outputs(model: IntegerModel) -> list[str]:
    """Return the outputs' names as the header and the CAN frames call them, in lower case."""
    return sanitize_outputs((o.name for o in model.outputs), name_prefix(model))


def list_flags(model: IntegerModel) -> dict[str, int]:
    """Return the flags that a step may return, by the names in the header."""
    flags = {
        "WARMING_UP": FLAG_WARMING_UP,
        "TEMPERATURE_RANGE": FLAG_TEMPERATURE_RANGE,
        "RATE_RANGE": FLAG_RATE_RANGE,
        "CLAMPED": FLAG_CLAMPED,
        "DAMAGED": FLAG_DAMAGED,
    }
    if model.guards.ranges:
        flags["INPUT_RANGE"] = FLAG_INPUT_RANGE
    if model.optional:
        flags["NO_READING"] = FLAG_NO_READING
    if model.tare:
        flags["TARED"] = FLAG_TARED
    return flags
