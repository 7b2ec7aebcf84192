"""The trained network as a float ONNX file: always the same bytes for the same weights.

Inputs `features` [T, B, I] and `initial_h` [1, B, H], of an LSTM also `initial_c`; outputs `drift`
[T, B, K] in the outputs' units and `hidden` [T, B, H]. The file is written with onnx.helper alone,
so that nothing of PyTorch's exporter, its version or the clock gets into it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.operations.dense import FloatDense, FloatFeedForward
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru.onnx import from_onnx_gates, to_onnx_gates
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.lstm.onnx import from_onnx_gates as lstm_from_onnx
from zerodrift.operations.lstm.onnx import to_onnx_gates as lstm_to_onnx

if TYPE_CHECKING:
    import onnxruntime


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
    node = helper.make_node(
        "GRU",
        ["features", "gru.W", "gru.R", "gru.B", "", "initial_h"],
        ["states"],
        name="gru",
        hidden_size=gru.w_h.shape[1],
        linear_before_reset=int(gru.reset == "after"),
    )
    return _build_recurrent(node, to_onnx_gates(gru), head, head_bias, outputs)


def build_lstm_onnx(
    lstm: FloatLstm, head: Array, head_bias: Array, outputs: Sequence[str]
) -> bytes:
    """Return the ONNX file of an LSTM and its head; see `build_onnx`."""
    node = helper.make_node(
        "LSTM",
        ["features", "lstm.W", "lstm.R", "lstm.B", "", "initial_h", "initial_c"],
        ["states"],
        name="lstm",
        hidden_size=lstm.hidden,
    )
    return _build_recurrent(node, lstm_to_onnx(lstm), head, head_bias, outputs)


def _build_recurrent(
    node: onnx.NodeProto,
    gates: tuple[Array, Array, Array],
    head: Array,
    head_bias: Array,
    outputs: Sequence[str],
) -> bytes:
    """Return the file of a recurrent node with its weights W, R, B, and a head."""
    w, r, b = gates
    features, hidden, count = w.shape[1], r.shape[1], head.shape[0]
    constants = {
        f"{node.name}.W": w[None],
        f"{node.name}.R": r[None],
        f"{node.name}.B": b[None],
        "head.weight": head.T,
        "head.bias": head_bias,
    }
    initializers = [
        numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name)
        for name, value in constants.items()
    ]
    initializers.append(numpy_helper.from_array(np.array([1], dtype=np.int64), "direction"))
    states = [name for name in node.input if name.startswith("initial")]
    nodes = [
        node,
        helper.make_node("Squeeze", ["states", "direction"], ["hidden"], name="squeeze"),
        helper.make_node("MatMul", ["hidden", "head.weight"], ["unbiased"], name="head"),
        helper.make_node("Add", ["unbiased", "head.bias"], ["drift"], name="bias"),
    ]
    return _write_file(
        nodes,
        [
            _describe("features", ("T", "B", features)),
            *(_describe(name, (1, "B", hidden)) for name in states),
        ],
        [_describe("drift", ("T", "B", count)), _describe("hidden", ("T", "B", hidden))],
        initializers,
        outputs,
    )


def build_layers_onnx(network: FloatFeedForward, outputs: Sequence[str]) -> bytes:
    """Return the ONNX file of dense layers and a head: `features` [N, I] to `drift` [N, K].

    Args:
        network: tanh layers, or rectifiers.
        outputs: the outputs' names, for readers of the file.
    """
    constants: dict[str, Array] = {}
    nodes = []
    last = "features"
    for i, layer in enumerate(network.dense):
        name = f"dense_{i}"
        constants |= {f"{name}.weight": layer.weight.T, f"{name}.bias": layer.bias}
        activation = "Tanh" if layer.activation == "tanh" else "Relu"
        nodes += [
            helper.make_node("MatMul", [last, f"{name}.weight"], [f"{name}.product"], name=name),
            helper.make_node(
                "Add", [f"{name}.product", f"{name}.bias"], [f"{name}.sum"], name=f"{name}.add"
            ),
            helper.make_node(activation, [f"{name}.sum"], [f"{name}.out"], name=f"{name}.bend"),
        ]
        last = f"{name}.out"
    constants |= {"head.weight": network.head.T, "head.bias": network.head_bias}
    nodes += [
        helper.make_node("MatMul", [last, "head.weight"], ["unbiased"], name="head"),
        helper.make_node("Add", ["unbiased", "head.bias"], ["drift"], name="bias"),
    ]
    initializers = [
        numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name)
        for name, value in constants.items()
    ]
    features, count = network.dense[0].weight.shape[1], network.head.shape[0]
    return _write_file(
        nodes,
        [_describe("features", ("N", features))],
        [_describe("drift", ("N", count))],
        initializers,
        outputs,
    )


def _write_file(
    nodes: Sequence[onnx.NodeProto],
    inputs: Sequence[onnx.ValueInfoProto],
    results: Sequence[onnx.ValueInfoProto],
    initializers: Sequence[onnx.TensorProto],
    outputs: Sequence[str],
) -> bytes:
    graph = helper.make_graph(
        nodes,
        "drift",
        inputs,
        results,
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


def read_onnx_weights(content: bytes, where: str) -> dict[str, Array]:
    """Return the weights of a file that this module wrote, by name, in the file's order.

    Raises:
        InputError: the file is damaged.
    """
    with _refuse_damage(where):
        found = _read_constants(onnx.load_model_from_string(content))
        return {k: v.astype(np.float64) for k, v in found.items() if v.dtype.kind == "f"}


def read_onnx_layers(content: bytes, where: str) -> FloatFeedForward:
    """Return the layers of a file that `build_layers_onnx` wrote.

    Raises:
        InputError: the file is damaged or another program's.
    """
    weights = read_onnx_weights(content, where)
    with _refuse_damage(where):
        model = onnx.load_model_from_string(content)
        bends = [n.op_type for n in model.graph.node if n.op_type in ("Tanh", "Relu")]
        dense = tuple(
            FloatDense(weights[f"dense_{i}.weight"].T, weights[f"dense_{i}.bias"], "tanh")
            if bend == "Tanh"
            else FloatDense(
                weights[f"dense_{i}.weight"].T, weights[f"dense_{i}.bias"], "clip", low=0.0
            )
            for i, bend in enumerate(bends)
        )
        return FloatFeedForward(dense, weights["head.weight"].T, weights["head.bias"])


def read_onnx_gru(content: bytes, where: str) -> FloatGru:
    """Return the recurrence of a file that `build_onnx` wrote.

    Raises:
        InputError: the file is damaged or another program's.
    """
    with _refuse_damage(where):
        model = onnx.load_model_from_string(content)
        constants = _read_constants(model)
        node = next(node for node in model.graph.node if node.op_type == "GRU")
        attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
        return from_onnx_gates(attributes, *(constants[f"gru.{name}"] for name in "WRB"))


def read_onnx_recurrent(content: bytes, where: str) -> FloatGru | FloatLstm:
    """Return the recurrence of a file that `build_onnx` or `build_lstm_onnx` wrote.

    Raises:
        InputError: the file is damaged or another program's.
    """
    with _refuse_damage(where):
        model = onnx.load_model_from_string(content)
        constants = _read_constants(model)
        if any(node.op_type == "LSTM" for node in model.graph.node):
            return lstm_from_onnx({}, *(constants[f"lstm.{name}"] for name in "WRB"))
    return read_onnx_gru(content, where)


def _read_constants(model: onnx.ModelProto) -> dict[str, NDArray[Any]]:
    return {t.name: numpy_helper.to_array(t) for t in model.graph.initializer}


@contextmanager
def _refuse_damage(where: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # protobuf raises its own kinds, without a common base
        raise InputError(
            f"{where}: this is no network of zerodrift ({error}). Run `zerodrift train` again."
        ) from error


def _describe(name: str, shape: Sequence[str | int]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape))


# The file of a trained recurrent network, run by onnxruntime: PyTorch is not needed.

WINDOWS_AT_ONCE = 4096
"""Windows that are run together: enough to keep the loop over time short."""


@dataclass(frozen=True)
class OnnxNetwork:
    """What `zerodrift.train.onnx_export.build_onnx` wrote."""

    content: bytes

    def run(self, features: Array, window: int) -> Array:
        """Return the network's drift [n, K] for features [n, I] of a run that starts at rest.

        Args:
            features: of the whole run.
            window: samples that each answer is from; 0 carries the state from sample to sample.
        """
        if not window:
            rest = self._cell.settle(features[:1])
            return self._ask(features[:, None, :], rest)[:, 0]
        padded = np.concatenate([np.repeat(features[:1], window - 1, axis=0), features])
        windows = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)  # [n, I, N]
        answers = []
        for begin in range(0, len(features), WINDOWS_AT_ONCE):
            part = windows[begin : begin + WINDOWS_AT_ONCE].transpose(2, 0, 1)
            zero = np.zeros((part.shape[1], self._carried))
            answers.append(self._ask(part, zero)[-1])
        return np.concatenate(answers)

    @cached_property
    def _cell(self) -> FloatGru | FloatLstm:
        return read_onnx_recurrent(self.content, "the trained network")

    @property
    def _carried(self) -> int:
        """Width of the state: h, of an LSTM beside c."""
        return int(self._cell.w_h.shape[1]) * (2 if isinstance(self._cell, FloatLstm) else 1)

    @cached_property
    def _session(self) -> "onnxruntime.InferenceSession":
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        return onnxruntime.InferenceSession(
            self.content, options, providers=["CPUExecutionProvider"]
        )

    def _ask(self, features: Array, state: Array) -> Array:
        """Return drift [T, B, K] for features [T, B, I] and first states [B, carried]."""
        hidden = self._cell.w_h.shape[1]
        feed = {
            "features": np.ascontiguousarray(features, dtype=np.float32),
            "initial_h": state[None, :, :hidden].astype(np.float32),
        }
        if isinstance(self._cell, FloatLstm):
            feed["initial_c"] = state[None, :, hidden:].astype(np.float32)
        return np.asarray(self._session.run(["drift"], feed)[0], dtype=np.float64)
