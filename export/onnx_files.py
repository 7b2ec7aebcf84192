"""Completes a float ONNX graph: weights in files beside it, and missing shapes."""

from pathlib import Path

import onnx
from onnx import TensorProto, external_data_helper, numpy_helper

from zerodrift.base.errors import InputError

LARGEST_FILE = 64 * 2**20
"""Bytes; the weights of a network that fits a microcontroller take a fraction of this."""


def load_external_data(model: onnx.ModelProto, where: str, folder: Path | None) -> None:
    """Read the weights that lie in other files beside the graph into it.

    Args:
        model: changed in place.
        where: the file's name, for messages.
        folder: where the files lie; None: there is none.

    Raises:
        InputError: a file is missing, too large, too short, or lies elsewhere; says the remedy.
    """
    tensors = [*model.graph.initializer]
    for nodes in (model.graph.node, *(f.node for f in model.functions)):
        tensors += [a.t for n in nodes for a in n.attribute if a.HasField("t")]
    outside = [t for t in tensors if t.data_location == TensorProto.EXTERNAL]
    if not outside:
        return
    remedy = (
        "Copy it there, or export again with the weights inside:"
        " torch.onnx.export(..., external_data=False)."
    )
    places = sorted({_find_location(t) for t in outside})
    if folder is None:
        raise InputError(f"{where}: keeps its weights in {places}, which are not at hand. {remedy}")
    for place in places:
        path = folder / place
        inside = path.resolve().is_relative_to(folder.resolve())
        if not place or Path(place).is_absolute() or not inside:
            raise InputError(
                f"{where}: keeps its weights in '{place}'; expected a file in its own folder."
                f" {remedy}"
            )
        try:
            size = path.stat().st_size
        except OSError as error:
            raise InputError(
                f"{where}: keeps its weights in the file '{place}' beside it, which cannot be read"
                f" ({error.strerror}). {remedy}"
            ) from error
        if size > LARGEST_FILE:
            raise InputError(
                f"{path}: has {size / 2**20:.0f} MiB; expected at most {LARGEST_FILE >> 20} MiB,"
                " since the network is to fit a microcontroller. Export the network alone."
            )
    for tensor in outside:
        try:
            external_data_helper.load_external_data_for_tensor(tensor, str(folder))
            tensor.data_location = TensorProto.DEFAULT
            numpy_helper.to_array(tensor)  # older versions of onnx read a file that is too short
        except Exception as error:  # onnx raises kinds of its own
            raise InputError(
                f"{where}: weight '{tensor.name}' cannot be read from '{_find_location(tensor)}'"
                f" beside it ({error}). Export both files again."
            ) from error
        del tensor.external_data[:]


def _find_location(tensor: onnx.TensorProto) -> str:
    return next((entry.value for entry in tensor.external_data if entry.key == "location"), "")


def complete_shapes(graph: onnx.GraphProto, where: str) -> None:
    """Give outputs without a type or a shape one, which nothing here reads; inputs need theirs.

    Raises:
        InputError: an input has no shape.
    """
    given = {tensor.name for tensor in graph.initializer}
    for value in graph.input:
        kind = value.type.tensor_type
        if value.name not in given and not kind.HasField("shape"):
            raise InputError(
                f"{where}: input '{value.name}' has no shape; expected its axes, of which only the"
                " features need a length. Export it again with example inputs."
            )
    for value in graph.output:
        kind = value.type.tensor_type
        if kind.elem_type == TensorProto.UNDEFINED:
            kind.elem_type = TensorProto.FLOAT
        if not kind.HasField("shape"):
            kind.shape.SetInParent()
