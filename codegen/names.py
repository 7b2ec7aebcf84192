"""Names of a model, its inputs and its outputs in the C."""

from zerodrift.codegen.identifiers import (
    sanitize_identifiers,
    sanitize_outputs,
    sanitize_prefix,
)
from zerodrift.export.integer_model import IntegerModel


def name_prefix(model: IntegerModel) -> str:
    """Return what every name of the model's C begins with."""
    return sanitize_prefix(model.prefix or model.name)


def name_channels(model: IntegerModel) -> list[str]:
    """Return the fields of the input struct, one per channel."""
    return sanitize_identifiers((c.name for c in model.channels), "input")


def name_outputs(model: IntegerModel) -> list[str]:
    """Return the outputs' names as the header and the CAN frames call them, in lower case."""
    return sanitize_outputs((o.name for o in model.outputs), name_prefix(model))
