"""The trained network as a float ONNX file: always the same bytes for the same weights.

Inputs `features` [T, B, I] and `initial_h` [1, B, H]; outputs `drift` [T, B, K] in the outputs'
units and `hidden` [T, B, H]. The file is written with onnx.helper alone, so that nothing of
PyTorch's exporter, its version or the clock gets into it.
"""

from collections.abc import Sequence

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from zerodrift.errors import InputError
from zerodrift.operations.gru import FloatGru

Array = NDArray[np.float64]

OPSET, IR_VERSION = 17, 8
"""Old enough for every runtime in use, new enough for Squeeze with its axes as an input."""


def build_onnx(gru: FloatGru, head: Array, head_bias: Array, outputs: Sequence[str]) -> bytes:
    """Return the ONNX file of a GRU and its head.

    Args:
        gru: the recurrence.
        head: [K, H] in output units per unit of state.
        head_bias: [K] in output units.
        outputs: the outputs' names, for readers of the file.
    """
    hidden, features = gru.w_x.shape[1:]
    count = head.shape[0]
    w, r, b = _to_onnx_gates(gru)
    constants = {
        "gru.W": w[None],
        "gru.R": r[None],
        "gru.B": b[None],
        "head.weight": head.T,
        "head.bias": head_bias,
    }
    initializers = [
        numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name)
        for name, value in constants.items()
    ]
    initializers.append(numpy_helper.from_array(np.array([1], dtype=np.int64), "direction"))
    nodes = [
        helper.make_node(
            "GRU",
            ["features", "gru.W", "gru.R", "gru.B", "", "initial_h"],
            ["states"],
            name="gru",
            hidden_size=hidden,
            linear_before_reset=int(gru.reset == "after"),
        ),
        helper.make_node("Squeeze", ["states", "direction"], ["hidden"], name="squeeze"),
        helper.make_node("MatMul", ["hidden", "head.weight"], ["unbiased"], name="head"),
        helper.make_node("Add", ["unbiased", "head.bias"], ["drift"], name="bias"),
    ]
    graph = helper.make_graph(
        nodes,
        "drift",
        [_describe("features", ("T", "B", features)), _describe("initial_h", (1, "B", hidden))],
        [_describe("drift", ("T", "B", count)), _describe("hidden", ("T", "B", hidden))],
        initializers,
        doc_string="outputs: " + ", ".join(outputs),
    )
    model = helper.make_model(
        graph,
        producer_name="zerodrift",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def read_onnx_gru(content: bytes, where: str) -> FloatGru:
    """Return the recurrence of a file that `build_onnx` wrote.

    Raises:
        InputError: the file is damaged or another program's.
    """
    try:
        model = onnx.load_model_from_string(content)
        constants = {
            t.name: numpy_helper.to_array(t).astype(np.float64) for t in model.graph.initializer
        }
        w, r, b = (constants[f"gru.{name}"][0] for name in "WRB")
        node = next(node for node in model.graph.node if node.op_type == "GRU")
        after = any(a.name == "linear_before_reset" and a.i == 1 for a in node.attribute)
        hidden = r.shape[1]
        w_z, w_r, w_n = w.reshape(3, hidden, -1)
        r_z, r_r, r_n = r.reshape(3, hidden, hidden)
        b_z, b_r, b_n, _, _, inside = b.reshape(6, hidden)
    except Exception as error:  # protobuf raises its own kinds, without a common base
        raise InputError(
            f"{where}: this is no network of zerodrift ({error}). Run `zerodrift train` again."
        ) from error
    return FloatGru(
        w_x=np.stack([w_r, -w_z, w_n]),
        w_h=np.stack([r_r, -r_z, r_n]),
        bias=np.stack([b_r, -b_z, b_n, inside]),
        reset="after" if after else "before",
    )


def _to_onnx_gates(gru: FloatGru) -> tuple[Array, Array, Array]:
    """Return W [3 H, I], R [3 H, H] and B [6 H] in ONNX's order z, r, h; z is 1 - u."""
    order, sign = (1, 0, 2), np.array([-1.0, 1.0, 1.0])
    w = sign[:, None, None] * gru.w_x[order, ...]
    r = sign[:, None, None] * gru.w_h[order, ...]
    outside = sign[:, None] * gru.bias[order, ...]
    inside = np.zeros_like(outside)
    if gru.reset == "after":
        inside[2] = gru.bias[3]
    hidden = gru.w_x.shape[1]
    b = np.concatenate([outside, inside]).reshape(6 * hidden)
    return w.reshape(3 * hidden, -1), r.reshape(3 * hidden, hidden), b


def _describe(name: str, shape: Sequence[str | int]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape))
