"""Reads a GRU and its linear head from a float ONNX file, whoever wrote it.

The quantizer sees nothing of PyTorch: what is read here, by the ONNX definition of its operators,
is what reaches the chip.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from zerodrift.errors import InputError
from zerodrift.operations.gru import FloatGru

Array = NDArray[np.float64]

_RESHAPING = ("Squeeze", "Unsqueeze", "Reshape", "Transpose", "Identity", "Cast")
_SUPPORTED = "one forward GRU with sigmoid and tanh, then MatMul, Gemm, Add, Mul with constants"


@dataclass(frozen=True)
class FloatNetwork:
    """A GRU and its linear head in float64: outputs = head h + head_bias."""

    gru: FloatGru
    head: Array
    """[K, H] in output units."""
    head_bias: Array
    """[K] in output units."""


def read_network(path: Path) -> FloatNetwork:
    """Return the network of an ONNX file.

    Raises:
        InputError: the file cannot be read, or holds something that has no fixed-point form here;
            names the node and what is supported.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error}). Export the network again.") from error
    return read_network_bytes(content, str(path))


def read_network_bytes(content: bytes, where: str) -> FloatNetwork:
    """Return the network of an ONNX file's content; see `read_network`."""
    try:
        model = onnx.load_model_from_string(content)
        onnx.checker.check_model(model)
    except Exception as error:
        raise InputError(f"{where}: cannot be read as ONNX ({error}). Export it again.") from error
    return read_network_proto(model, where)


def read_network_proto(model: onnx.ModelProto, where: str) -> FloatNetwork:
    """Return the network of an ONNX model in memory; see `read_network`."""
    graph = model.graph
    if any(t.data_location == onnx.TensorProto.EXTERNAL for t in graph.initializer):
        raise InputError(
            f"{where}: keeps its weights in another file, which is not followed. Save it with its"
            " weights inside."
        )
    constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant":
            constants[node.output[0]] = numpy_helper.to_array(_attributes(node)["value"])
    recurrent = [n for n in graph.node if n.op_type in ("GRU", "LSTM", "RNN")]
    if len(recurrent) != 1 or recurrent[0].op_type != "GRU":
        found = [f"{n.op_type} '{n.name}'" for n in recurrent] or "none"
        raise InputError(f"{where}: recurrent nodes are {found}; supported is {_SUPPORTED}")
    gru = _read_gru(recurrent[0], constants, where)
    head, bias = _read_head(graph, recurrent[0], constants, where)
    return FloatNetwork(gru, head, bias)


def _attributes(node: onnx.NodeProto) -> dict[str, Any]:
    return {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}


def _constant(
    constants: Mapping[str, NDArray[Any]], node: onnx.NodeProto, index: int, where: str
) -> Array:
    name = node.input[index]
    if name not in constants:
        raise InputError(
            f"{where}: input {index} ('{name}') of {node.op_type} '{node.name}' is computed, not a"
            " constant; its weights must lie in the file"
        )
    return np.asarray(constants[name], dtype=np.float64)


def _read_gru(node: onnx.NodeProto, constants: Mapping[str, NDArray[Any]], where: str) -> FloatGru:
    attributes = _attributes(node)
    direction = attributes.get("direction", b"forward").decode()
    activations = [a.decode().lower() for a in attributes.get("activations", [])]
    if direction != "forward":
        raise InputError(
            f"{where}: GRU '{node.name}' is {direction}; a sensor has only the past. Supported is"
            f" {_SUPPORTED}"
        )
    if activations and activations != ["sigmoid", "tanh"]:
        raise InputError(f"{where}: GRU '{node.name}' has activations {activations}; {_SUPPORTED}")
    if attributes.get("clip"):
        raise InputError(f"{where}: GRU '{node.name}' clips its cells, which is not supported")
    w = _constant(constants, node, 1, where)
    r = _constant(constants, node, 2, where)
    hidden = r.shape[2]
    bias = np.zeros(6 * hidden)
    if len(node.input) > 3 and node.input[3]:
        bias = _constant(constants, node, 3, where)[0]
    # ONNX orders the gates z, r, h; the update gate is kept as u = 1 - z, so z changes its sign.
    w_z, w_r, w_n = w[0].reshape(3, hidden, -1)
    r_z, r_r, r_n = r[0].reshape(3, hidden, hidden)
    b_z, b_r, b_n, c_z, c_r, c_n = bias.reshape(6, hidden)
    after = bool(attributes.get("linear_before_reset", 0))
    inside = c_n if after else np.zeros(hidden)
    outside = b_n if after else b_n + c_n
    return FloatGru(
        w_x=np.stack([w_r, -w_z, w_n]),
        w_h=np.stack([r_r, -r_z, r_n]),
        bias=np.stack([b_r + c_r, -(b_z + c_z), outside, inside]),
        reset="after" if after else "before",
    )


def _read_head(
    graph: onnx.GraphProto,
    gru: onnx.NodeProto,
    constants: Mapping[str, NDArray[Any]],
    where: str,
) -> tuple[Array, Array]:
    """Follow the linear operators from the GRU's states to the first graph output they reach."""
    hidden = _constant(constants, gru, 2, where).shape[2]
    outputs = {o.name for o in graph.output}
    matrix, bias = np.eye(hidden), np.zeros(hidden)
    value = gru.output[0]
    if not value:
        raise InputError(f"{where}: GRU '{gru.name}' does not give its states (output Y)")
    seen_product = False
    while not (value in outputs and seen_product):
        users = [n for n in graph.node if value in n.input]
        users = [n for n in users if not (value in outputs and n.op_type in _RESHAPING)] or users
        if not users:
            break
        node = users[0]
        if node.op_type in ("MatMul", "Gemm"):
            weight = _constant(constants, node, 1, where)
            attributes = _attributes(node)
            if node.op_type == "Gemm":
                weight = weight.T if attributes.get("transB", 0) else weight
                weight = weight * attributes.get("alpha", 1.0)
            matrix, bias = weight.T @ matrix, weight.T @ bias
            if node.op_type == "Gemm" and len(node.input) > 2:
                bias = bias + _constant(constants, node, 2, where).ravel() * attributes.get(
                    "beta", 1.0
                )
            seen_product = True
        elif node.op_type in ("Add", "Mul"):
            operand = _constant(constants, node, 1 - list(node.input).index(value), where).ravel()
            if node.op_type == "Add":
                bias = bias + operand
            else:
                matrix, bias = (matrix.T * operand).T, bias * operand
        elif node.op_type not in _RESHAPING:
            raise InputError(
                f"{where}: {node.op_type} '{node.name}' after the GRU; supported is {_SUPPORTED}"
            )
        value = node.output[0]
    if value not in outputs:
        raise InputError(f"{where}: the GRU's states do not lead to an output of the graph")
    return matrix, bias
