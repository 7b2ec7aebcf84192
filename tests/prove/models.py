"""Models as the proof reads them."""

from collections.abc import Mapping

from zerodrift.export.integer_model import IntegerModel
from zerodrift_proof import Model, ShownPart, list_shown, read_model


def as_read(model: IntegerModel) -> Model:
    """Return what the proof reads in a model's file."""
    return read_model(model.to_json())


def prove(model: IntegerModel, texts: Mapping[str, str]) -> tuple[ShownPart, ...]:
    """Return what is shown of a model's C, its object code apart."""
    return tuple(list_shown(as_read(model), texts))
