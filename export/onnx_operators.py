"""What each operator of a float ONNX graph does to the reader's values; one function per family.

Only what has an exact counterpart on the chip is accepted: changes of shape, elementwise sums and
products with constants, matrix products with constants, GRUs, and a few activations.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import onnx
from numpy.typing import NDArray

from zerodrift.export.onnx_shapes import (
    RESHAPED,
    Attributes,
    Operator,
    axes_of,
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
)
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.onnx import from_onnx_gates

Array = NDArray[np.float64]

SUPPORTED = (
    "supported are forward GRUs with sigmoid and tanh; changes of shape; Add, Sub, Mul, Div, MatMul"
    " and Gemm with constants; the last sample of the states; and after the GRU Relu, LeakyRelu,"
    " PRelu, Clip, Tanh, Sigmoid and HardSigmoid"
)


def elementwise(node: onnx.NodeProto, _: Attributes, values: list[Value]) -> list[Value]:
    """Add, Sub, Mul, Div of data with a constant, or of two signals of one source."""
    op, (a, b) = node.op_type, values
    if any(isinstance(v, Dims) for v in values):
        return [_calculate(op, values)]
    if isinstance(a, OnnxSignal) and isinstance(b, OnnxSignal) and op in ("Add", "Sub"):
        if a.source is not b.source or a.axes != b.axes or a.last != b.last:
            raise Unsupported("it joins two branches of the graph")
        sign = 1.0 if op == "Add" else -1.0
        return [replace(a, matrix=a.matrix + sign * b.matrix, bias=a.bias + sign * b.bias)]
    data, other = (a, b) if is_data(a) else (b, a)
    if is_data(other):
        raise Unsupported("it joins two branches of the graph")
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
    signal = values[0]
    if not isinstance(signal, OnnxSignal) or signal.source.below is None:
        raise Unsupported("an activation before the GRU")
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
    if not (isinstance(a, OnnxSignal) and isinstance(b, OnnxSignal)) or a.source.below is None:
        raise Unsupported("it compares signals before the GRU")
    same = a.source is b.source and a.axes[:-1] == b.axes[:-1] and a.last == b.last
    if not same or a.matrix.shape != b.matrix.shape or a.axes[-1].role != b.axes[-1].role:
        raise Unsupported("it compares two branches of the graph")
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


def gru(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """GRU: a new source of signals, its states."""
    values = values + [None] * (6 - len(values))
    data = values[0]
    layout = attributes.get("layout", 0)
    w, r = pick_array(values[1], "W"), pick_array(values[2], "R")
    b = None if values[3] is None else pick_array(values[3], "B")
    try:
        layer = from_onnx_gates(attributes, w, r, b)
    except ValueError as error:
        raise Unsupported(str(error)) from error
    if values[4] is not None:
        raise Unsupported("it is given lengths of sequences (sequence_lens)")
    if isinstance(data, RawInput):
        data = bind(data, layer.w_x.shape[2], 2) if len(data.axes) == 3 else data
    if not isinstance(data, OnnxSignal) or len(data.axes) != 3:
        raise Unsupported("its input X is not data of three axes")
    if data.last or isinstance(data.source.layer, FloatDense):
        raise Unsupported("its input is the last sample, or has been through an activation")
    time, batch = data.axes[layout], data.axes[1 - layout]
    if data.axes[2].role != "feature" or data.matrix.shape[0] != layer.w_x.shape[2]:
        raise Unsupported(f"it reads {layer.w_x.shape[2]} values that are not the features")
    time.take_role("time")
    batch.take_role("batch")
    outside = layer.bias.copy()
    outside[:3] += layer.w_x @ data.bias
    layer = replace(layer, w_x=layer.w_x @ data.matrix, bias=outside)
    hidden = layer.w_h.shape[1]
    source = OnnxSource(hidden, data.source, layer, node.name or "GRU", time)
    one, feature = Axis(1, "one"), Axis(hidden, "feature")
    axes = (batch, time, one, feature) if layout else (time, one, batch, feature)
    states = OnnxSignal(source, axes, np.eye(hidden), np.zeros(hidden))
    end = (batch, one, feature) if layout else (one, batch, feature)
    return [states, replace(states, axes=end, last=True)]


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
