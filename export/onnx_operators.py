"""The effect of each operator of a float ONNX graph on the reader's values, family by family.

Only what has an exact counterpart on the chip is accepted: changes of shape, elementwise sums and
products with constants, matrix products with constants, GRUs, and a few activations.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import onnx

from zerodrift.base.arrays import Array
from zerodrift.export.onnx_layer_norm import layer_norm, reduce_mean
from zerodrift.export.onnx_recurrent import gru, lstm
from zerodrift.export.onnx_shapes import (
    RESHAPED,
    Attributes,
    Operator,
    axes_of,
    concat_shapes,
    is_data,
    pick_array,
)
from zerodrift.export.onnx_values import (
    Axis,
    Dims,
    OnnxSignal,
    OnnxSource,
    Pending,
    RawInput,
    Unsupported,
    Value,
    bind,
    join_signals,
)
from zerodrift.operations.dense import FloatDense

SUPPORTED = (
    "supported are forward GRUs and LSTMs with sigmoid and tanh; changes of shape; Add, Sub, Mul,"
    " Div, MatMul and Gemm with constants; sums and Concat of branches; the last sample of the"
    " states; Relu, LeakyRelu, PRelu, Clip, Tanh, Sigmoid and HardSigmoid; layer normalisation over"
    " the features"
)

_NORMALIZED = (
    "it divides by what it computes anew at every sample, for which the chip has no operation but"
    " LayerNormalization over the features. Train with LayerNorm, or with BatchNorm, which is"
    " folded into the weights"
)
_MIN_GRU = (
    "export one step of it with the state as an input and an output, and train it with a tanh or a"
    " sigmoid over its candidate: one that is not bounded has no format that is proven"
)
REMEDIES = {
    **dict.fromkeys(
        (
            "SkipLayerNormalization",
            "SimplifiedLayerNormalization",
            "RMSNormalization",
            "GroupNormalization",
            "InstanceNormalization",
            "MeanVarianceNormalization",
        ),
        _NORMALIZED,
    ),
    **dict.fromkeys(
        ("Loop", "Scan", "If"),
        "it is control flow. Export the operators GRU and LSTM, or one step of the network with its"
        " states as inputs and outputs",
    ),
    "RNN": "train a GRU or an LSTM in its place",
    **dict.fromkeys(
        ("CumSum", "CumProd", "LogCumSumExp"),
        "it sums over time, as cells trained by parallel scans (minGRU, minLSTM) do. Where this is"
        f" a minGRU, {_MIN_GRU}. Otherwise train a GRU or an LSTM in its place",
    ),
    **dict.fromkeys(
        ("Where", "Less", "Greater", "LessOrEqual", "GreaterOrEqual"),
        "it chooses between two values, for which the chip has no operation. Where this is a"
        f" minGRU, {_MIN_GRU}",
    ),
}
"""Operator that is refused -> why, and what to change."""


def bind_features(value: Value, position: int) -> OnnxSignal:
    """Return data as a signal; the features of an input are taken to lie along an axis.

    Raises:
        Unsupported: it is no data, or nothing tells how many features there are.
    """
    if isinstance(value, RawInput):
        size = value.axes[position].size
        if size is None:
            raise Unsupported(
                f"the file does not state the length of axis {position} of input '{value.name}';"
                " export it with a fixed number of features"
            )
        return bind(value, size, position)
    if not isinstance(value, OnnxSignal):
        raise Unsupported("it is used on something that is not followed")
    return value


def align_signals(values: list[Value], position: int) -> list[OnnxSignal]:
    """Return data as signals of one source, all of whose axes but the feature's are the same.

    Args:
        values: what is to be joined.
        position: of the features among the axes.

    Raises:
        Unsupported: an axis is another one; or no features lie there.
    """
    known = next((v for v in values if isinstance(v, OnnxSignal)), None)
    if known is not None:
        position = next((i for i, a in enumerate(known.axes) if a.role == "feature"), position)
    signals = [bind_features(value, position) for value in values]
    first = signals[0]
    for other in signals[1:]:
        if len(other.axes) != len(first.axes):
            raise Unsupported("it joins two branches of the graph with different axes")
        for i, (a, b) in enumerate(zip(first.axes, other.axes, strict=True)):
            if i == position:
                same = a.role == b.role == "feature"
            else:
                same = a is b or (a.is_one and b.is_one)
            if not same:
                raise Unsupported(f"it joins two branches of the graph whose axes {i} differ")
    return join_signals(signals)


def concat(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Concat of features of several branches, or of shapes, fills and states."""
    data = [v for v in values if isinstance(v, OnnxSignal | RawInput)]
    if len(data) < len(values) or len(data) < 2:
        return concat_shapes(node, attributes, values)
    at = attributes["axis"] % len(axes_of(data[0]))
    signals = [v for v in data if isinstance(v, OnnxSignal)]
    if not signals or any(s.axes[at].role != "feature" for s in signals):
        return concat_shapes(node, attributes, values)
    joined = align_signals(values, at)
    matrix = np.concatenate([s.matrix for s in joined])
    bias = np.concatenate([s.bias for s in joined])
    axes = (*joined[0].axes[:at], Axis(len(bias), "feature"), *joined[0].axes[at + 1 :])
    return [replace(joined[0], axes=axes, matrix=matrix, bias=bias)]


def elementwise(node: onnx.NodeProto, _: Attributes, values: list[Value]) -> list[Value]:
    """Add, Sub, Mul, Div of data with a constant, or of two signals of one source."""
    op, (a, b) = node.op_type, values
    if any(isinstance(v, Dims) for v in values):
        return [_calculate(op, values)]
    if is_data(a) and is_data(b) and op in ("Add", "Sub"):
        first, second = align_signals([a, b], len(axes_of(a)) - 1)
        if first.matrix.shape != second.matrix.shape:
            raise Unsupported(
                f"it adds {first.matrix.shape[0]} and {second.matrix.shape[0]} values; expected as"
                " many of each"
            )
        sign = 1.0 if op == "Add" else -1.0
        matrix, bias = first.matrix + sign * second.matrix, first.bias + sign * second.bias
        return [replace(first, matrix=matrix, bias=bias)]
    data, other = (a, b) if is_data(a) else (b, a)
    if is_data(other):
        raise Unsupported(
            "it is a product of two signals; only recurrent layers and cells, sums and"
            " concatenations may join branches. Put one of them into the network's inputs. Where"
            f" this is a minGRU, {_MIN_GRU}. Where it is a gated cell of another kind (SRU,"
            " minLSTM), train a GRU or an LSTM"
        )
    array = pick_array(other, "second operand").astype(np.float64)
    if data is b and op == "Div":
        raise Unsupported("it divides by data")
    if data is b and op == "Sub":
        return [_apply(_apply(data, "Mul", np.array(-1.0)), "Add", array)]
    return [_apply(data, op, array)]


def negate(_: onnx.NodeProto, __: Attributes, values: list[Value]) -> list[Value]:
    """Neg."""
    return [_apply(values[0], "Mul", np.array(-1.0))]


def _apply(data: Value, op: str, array: Array) -> Value:
    if isinstance(data, RawInput):
        return replace(data, pending=(*data.pending, Pending(op, array, data.axes)))
    if isinstance(data, OnnxSignal):
        return data.apply(op, array, data.axes)
    raise Unsupported("it is used on something that is not followed")


def _calculate(op: str, values: list[Value]) -> Value:
    """Return sums and products of shapes where they are known numbers."""
    lists = []
    for value in values:
        if isinstance(value, Dims):
            lists.append(value)
        else:
            numbers = pick_array(value, "operand")
            lists.append(Dims(tuple(int(n) for n in numbers.ravel()), numbers.ndim == 0))
    length = max(len(x.entries) for x in lists)
    a, b = ((x.entries * length)[:length] if len(x.entries) == 1 else x.entries for x in lists)
    table: dict[str, Callable[[int, int], int]] = {
        "Add": lambda x, y: x + y,
        "Sub": lambda x, y: x - y,
        "Mul": lambda x, y: x * y,
        "Div": lambda x, y: x // y if y else 0,
    }
    entries: list[int | Axis | None] = []
    for x, y in zip(a, b, strict=True):
        if isinstance(x, int) and isinstance(y, int):
            entries.append(table[op](x, y))
        elif op in ("Mul", "Div") and y == 1:
            entries.append(x)
        elif op == "Mul" and x == 1:
            entries.append(y)
        else:
            entries.append(None)
    return Dims(tuple(entries), all(x.scalar for x in lists))


def matmul(_: onnx.NodeProto, __: Attributes, values: list[Value]) -> list[Value]:
    """MatMul of data with a constant matrix."""
    if not is_data(values[0]):
        raise Unsupported("its first operand is no data")
    weight = pick_array(values[1], "second operand").astype(np.float64)
    if weight.ndim != 2:
        raise Unsupported(f"its constant has shape {weight.shape}; expected a matrix")
    signal = _bind_last(values[0], weight.shape[0])
    return [signal.mix(weight.T, np.zeros(weight.shape[1]))]


def gemm(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Gemm of data with a constant matrix and bias."""
    if attributes.get("transA", 0) or not is_data(values[0]):
        raise Unsupported("its first operand is transposed, or no data")
    weight = pick_array(values[1], "second operand").astype(np.float64)
    weight = weight if attributes.get("transB", 0) else weight.T
    weight = weight * attributes.get("alpha", 1.0)
    bias = np.zeros(weight.shape[0])
    if len(values) > 2 and values[2] is not None:
        given = pick_array(values[2], "bias").astype(np.float64)
        bias = np.broadcast_to(given.ravel(), bias.shape) * attributes.get("beta", 1.0)
    return [_bind_last(values[0], weight.shape[1]).mix(weight, bias)]


def _bind_last(value: Value, width: int) -> OnnxSignal:
    """Return data as a signal whose last axis holds its features."""
    signal = bind(value, width, len(value.axes) - 1) if isinstance(value, RawInput) else value
    if not isinstance(signal, OnnxSignal):
        raise Unsupported("it is used on something that is not followed")
    if signal.axes[-1].role != "feature" or signal.matrix.shape[0] != width:
        raise Unsupported(f"it mixes {width} values that are not the features")
    return signal


def normalize(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """BatchNormalization of an exported network: a gain and an offset per channel (axis 1)."""
    if attributes.get("training_mode", 0):
        raise Unsupported("it is in training mode")
    scale, offset, mean, var = (pick_array(v, "parameter").astype(np.float64) for v in values[1:5])
    gain = scale / np.sqrt(var + attributes.get("epsilon", 1e-5))
    rank = len(axes_of(values[0]))
    column = (-1, *([1] * max(rank - 2, 0)))
    product = _apply(values[0], "Mul", gain.reshape(column))
    return [_apply(product, "Add", (offset - gain * mean).reshape(column))]


def activate(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Relu, LeakyRelu, PRelu, Tanh, Sigmoid, HardSigmoid, Clip, Min, Max."""
    if node.op_type in ("Min", "Max") and len(values) == 2 and is_data(values[1]):
        if is_data(values[0]):
            return [_compare(node, *values)]
        values = values[::-1]
    signal = bind_features(values[0], len(axes_of(values[0])) - 1)
    m, b = signal.matrix, signal.bias
    one, none = np.eye(len(m)), np.zeros(len(m))
    match node.op_type:
        case "Relu":
            return [_add_dense(signal, FloatDense(m, b, "clip", 0.0), one, none, node)]
        case "LeakyRelu" | "PRelu":
            if node.op_type == "PRelu":
                slope = pick_array(values[1], "slope").astype(np.float64)
                alpha = np.broadcast_to(slope.ravel(), (len(m),))
            else:
                alpha = np.full(len(m), attributes.get("alpha", 0.01))
            # x for x > 0, alpha x below: relu(x) - alpha relu(-x)
            both = FloatDense(np.concatenate([m, -m]), np.concatenate([b, -b]), "clip", 0.0)
            return [_add_dense(signal, both, np.hstack([one, -np.diag(alpha)]), none, node)]
        case "Tanh":
            return [_add_dense(signal, FloatDense(m, b, "tanh"), one, none, node)]
        case "Sigmoid":  # (1 + tanh(x / 2)) / 2
            half = FloatDense(0.5 * m, 0.5 * b, "tanh")
            return [_add_dense(signal, half, 0.5 * one, none + 0.5, node)]
        case "HardSigmoid":
            alpha, beta = attributes.get("alpha", 0.2), attributes.get("beta", 0.5)
            clipped = FloatDense(alpha * m, alpha * b + beta, "clip", 0.0, 1.0)
            return [_add_dense(signal, clipped, one, none, node)]
    low, high = _read_limits(node, attributes, values)
    if low > high:
        raise Unsupported(f"its limits {low} .. {high} are empty")
    return [_add_dense(signal, FloatDense(m, b, "clip", low, high), one, none, node)]


def _compare(node: onnx.NodeProto, a: Value, b: Value) -> OnnxSignal:
    """Return the larger or smaller of two signals from the same layer.

    max(a, b) = b + relu(a - b) and min(a, b) = b - relu(b - a), with b = relu(b) - relu(-b).
    """
    a, b = align_signals([a, b], len(axes_of(a)) - 1)
    if a.matrix.shape != b.matrix.shape:
        raise Unsupported("it compares different numbers of values")
    sign = 1.0 if node.op_type == "Max" else -1.0
    rows = np.concatenate([sign * (a.matrix - b.matrix), b.matrix, -b.matrix])
    biases = np.concatenate([sign * (a.bias - b.bias), b.bias, -b.bias])
    one = np.eye(len(a.matrix))
    layer = FloatDense(rows, biases, "clip", 0.0)
    return _add_dense(a, layer, np.hstack([sign * one, one, -one]), np.zeros(len(one)), node)


def _read_limits(
    node: onnx.NodeProto, attributes: Attributes, values: list[Value]
) -> tuple[float, float]:
    """Return the limits of Clip, or of Min or Max with a number."""
    given = [None if v is None else pick_array(v, "limit", finite=False) for v in values[1:3]]
    if any(limit is not None and limit.size != 1 for limit in given):
        raise Unsupported("its limits are not single numbers")
    numbers = [None if limit is None else float(limit.ravel()[0]) for limit in given]
    if node.op_type == "Clip":
        low = numbers[0] if numbers else attributes.get("min")
        high = numbers[1] if len(numbers) > 1 else attributes.get("max")
    elif len(numbers) != 1 or numbers[0] is None:
        raise Unsupported("it compares two branches of the graph")
    else:
        low, high = (numbers[0], None) if node.op_type == "Max" else (None, numbers[0])
    return (-np.inf if low is None else float(low)), (np.inf if high is None else float(high))


def _add_dense(
    signal: OnnxSignal, layer: FloatDense, matrix: Array, bias: Array, node: onnx.NodeProto
) -> OnnxSignal:
    """Return matrix layer + bias, where the layer reads what the signal reads."""
    source = OnnxSource(layer.weight.shape[0], signal.source, layer, node.name or node.op_type)
    return replace(signal, source=source, matrix=matrix, bias=bias)


OPERATORS: dict[str, Operator] = RESHAPED | {
    "Add": elementwise,
    "Sub": elementwise,
    "Mul": elementwise,
    "Div": elementwise,
    "Neg": negate,
    "MatMul": matmul,
    "Gemm": gemm,
    "BatchNormalization": normalize,
    "GRU": gru,
    "LSTM": lstm,
    "Concat": concat,
    "LayerNormalization": layer_norm,
    "ReduceMean": reduce_mean,
    **dict.fromkeys(
        (
            "Relu",
            "LeakyRelu",
            "PRelu",
            "Tanh",
            "Sigmoid",
            "HardSigmoid",
            "Clip",
            "Min",
            "Max",
        ),
        activate,
    ),
}
