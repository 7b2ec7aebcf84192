"""The effect of each operator of a float ONNX graph on the reader's values, family by family.

Only what has an exact counterpart on the chip is accepted: changes of shape, elementwise sums and
products with constants, matrix products with constants, GRUs, and a few activations.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import onnx

from zerodrift.base.arrays import Array
from zerodrift.export.onnx_values import (
    RESHAPED,
    Attributes,
    Axis,
    Constant,
    Dims,
    Fill,
    Moment,
    OnnxSignal,
    OnnxSource,
    Operator,
    Pending,
    RawInput,
    Refused,
    Unsupported,
    Value,
    axes_of,
    bind,
    concat_shapes,
    is_data,
    join_signals,
    pick_array,
)
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru import onnx as gru_onnx
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm import onnx as lstm_onnx
from zerodrift.operations.lstm.cell import FloatLstm

# The effect of the recurrent operators of a float ONNX graph on the reader's values.


def gru(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """GRU: a new source of signals, its states."""
    values = values + [None] * (6 - len(values))
    w, r = pick_array(values[1], "W"), pick_array(values[2], "R")
    b = None if values[3] is None else pick_array(values[3], "B")
    try:
        layer = gru_onnx.from_onnx_gates(attributes, w, r, b)
    except ValueError as error:
        raise Unsupported(str(error)) from error
    return list(_add_layer(node, attributes, values, layer))


def lstm(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """LSTM: a new source of signals, its outputs h; c may not be used elsewhere."""
    values = values + [None] * (8 - len(values))
    w, r = pick_array(values[1], "W"), pick_array(values[2], "R")
    b, p = (
        None if v is None else pick_array(v, n) for v, n in ((values[3], "B"), (values[7], "P"))
    )
    try:
        layer = lstm_onnx.from_onnx_gates(attributes, w, r, b, p)
    except ValueError as error:
        raise Unsupported(str(error)) from error
    cell = Refused(
        f"LSTM '{node.name or ', '.join(node.output)}': its cell state Y_c is read by another node;"
        " only its outputs Y and Y_h may be"
    )
    return [*_add_layer(node, attributes, values, layer), cell]


def _add_layer(
    node: onnx.NodeProto,
    attributes: Attributes,
    values: list[Value],
    layer: FloatGru | FloatLstm,
) -> tuple[OnnxSignal, OnnxSignal]:
    """Return all outputs and the last one of a recurrent layer over X."""
    data, layout = values[0], attributes.get("layout", 0)
    inputs = layer.w_x.shape[2]
    if isinstance(data, RawInput):
        data = bind(data, inputs, 2) if len(data.axes) == 3 else data
    if not isinstance(data, OnnxSignal) or len(data.axes) != 3:
        raise Unsupported("its input X is not data of three axes")
    if data.last and not data.of_one:
        raise Unsupported("its input is the last sample of another layer; expected all of them")
    time, batch = data.axes[layout], data.axes[1 - layout]
    if data.axes[2].role != "feature" or data.matrix.shape[0] != inputs:
        raise Unsupported(f"it reads {inputs} values that are not the features")
    time.take_role("time")
    batch.take_role("batch")
    _check_lengths(values[4], time)
    outside = layer.bias.copy()
    outside[: len(layer.w_x)] += layer.w_x @ data.bias
    layer = replace(layer, w_x=layer.w_x @ data.matrix, bias=outside)
    hidden = layer.w_h.shape[1]
    source = OnnxSource(hidden, data.source, layer, node.name or node.op_type, time)
    one, feature = Axis(1, "one"), Axis(hidden, "feature")
    axes = (batch, time, one, feature) if layout else (time, one, batch, feature)
    states = OnnxSignal(source, axes, np.eye(hidden), np.zeros(hidden))
    end = (batch, one, feature) if layout else (one, batch, feature)
    return states, replace(states, axes=end, last=True)


def _check_lengths(lengths: Value, time: Axis) -> None:
    """Refuse lengths of sequences that are not all of the sequence."""
    if lengths is None:
        return
    if isinstance(lengths, Constant):
        found = {int(n) for n in lengths.array.ravel()}
    elif isinstance(lengths, Fill):
        found = {int(lengths.value)}
    elif isinstance(lengths, Dims) and all(e is time for e in lengths.entries):
        return
    else:
        raise Unsupported(
            "it is given lengths of sequences (sequence_lens) that are computed, or an input; the"
            " firmware has one sequence that does not end. Export it without"
        )
    if time.size is None:
        raise Unsupported(
            f"it is given sequence_lens of {sorted(found)}, and the file does not state the length"
            " of the sequence. Export it without sequence_lens, or with a fixed length"
        )
    if found != {time.size}:
        raise Unsupported(
            f"it is given sequence_lens of {sorted(found)} for sequences of {time.size} samples;"
            " only all of them can be. Export it without sequence_lens"
        )


# Layer normalisation in a float ONNX graph: as one operator, or taken apart.
#
# Before opset 17 PyTorch writes ReduceMean, Sub, Pow, ReduceMean, Add, Sqrt, Div. What stands
# between is followed as a `Moment`, which means something only as a part of a normalisation.

OUTSIDE = (
    "it uses a mean or a deviation over the features of a sample outside a layer normalisation,"
    " (x - mean) / sqrt(mean((x - mean)^2) + epsilon), which is what the chip can do of it. Export"
    " the normalisation by opset 17 or newer, as one LayerNormalization"
)


def is_same(a: OnnxSignal, b: OnnxSignal) -> bool:
    """Tell whether two signals are one value of the graph."""
    return (
        a.source is b.source
        and a.last == b.last
        and a.axes == b.axes
        and np.array_equal(a.matrix, b.matrix)
        and np.array_equal(a.bias, b.bias)
    )


def _follow(value: Value) -> OnnxSignal | None:
    """Return data as a signal over its last axis; None where it is none."""
    if isinstance(value, RawInput):
        size = value.axes[-1].size if value.axes else None
        return None if size is None else bind(value, size, len(value.axes) - 1)
    return value if isinstance(value, OnnxSignal) else None


def _require_features(signal: OnnxSignal, axes: list[int]) -> None:
    """Refuse a normalisation over anything but the features, along the last axis."""
    rank = len(signal.axes)
    if [a % rank for a in axes] != [rank - 1] or signal.axes[-1].role != "feature":
        roles = [signal.axes[a % rank].role or "unknown" for a in axes]
        raise Unsupported(
            f"it normalises over the axes {axes} ({', '.join(roles)}); expected the features alone,"
            " along the last axis"
        )


def layer_norm(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """LayerNormalization over the features."""
    if len([name for name in node.output if name]) > 1:
        raise Unsupported("its mean or deviation is used too; only the normalised values may be")
    signal = _follow(values[0])
    if signal is None:
        raise Unsupported("it is used on something that is not followed")
    rank = len(signal.axes)
    first = attributes.get("axis", -1) % rank
    _require_features(signal, list(range(first, rank)))
    width = signal.matrix.shape[0]
    gain, offset = np.ones(width), np.zeros(width)
    for k, row in ((1, gain), (2, offset)):
        if len(values) > k and values[k] is not None:
            given = pick_array(values[k], ("scale", "bias")[k - 1]).astype(np.float64)
            if given.size not in (1, width):
                raise Unsupported(f"it has {given.size} gains or biases for {width} features")
            row[:] = given.ravel()
    return [normalise(signal, attributes.get("epsilon", 1e-5), node, gain, offset)]


def normalise(
    signal: OnnxSignal,
    epsilon: float,
    node: onnx.NodeProto,
    gain: Array | None = None,
    offset: Array | None = None,
) -> OnnxSignal:
    """Return gain (signal - mean) / sqrt(variance + epsilon) + offset.

    What is the same for all features does not matter, and a factor c of all of them is one of
    epsilon, 1 / c^2: so a layer's own numbers are read as they are. Any other mixture of them
    becomes a dense layer first.
    """
    if not epsilon > 0.0:
        raise Unsupported(
            f"its epsilon is {epsilon:g}; expected one above 0, since equal values would be divided"
            " by 0"
        )
    width = signal.matrix.shape[0]
    gain = np.ones(width) if gain is None else gain
    offset = np.zeros(width) if offset is None else offset
    source, factor = signal.source, _find_factor(signal)
    name = node.name or node.op_type
    if source.layer is None or factor is None:
        layer = FloatDense(signal.matrix, signal.bias, "clip")
        source, factor = OnnxSource(width, source, layer, name), 1.0
    norm = FloatLayerNorm(np.sign(factor) * gain, offset, epsilon / factor**2)
    top = OnnxSource(width, source, norm, name)
    return replace(signal, source=top, matrix=np.eye(width), bias=np.zeros(width))


def _find_factor(signal: OnnxSignal) -> float | None:
    """Return c where a signal is c times its source, and something that all features share."""
    matrix, bias = signal.matrix, signal.bias
    factor = float(matrix[0, 0])
    plain = matrix.shape[0] == matrix.shape[1] and factor != 0.0
    if plain and (matrix == factor * np.eye(len(matrix))).all() and (bias == bias[0]).all():
        return factor
    return None


def reduce_mean(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """ReduceMean of a signal, or of its squares less the mean."""
    axes = attributes.get("axes")
    if axes is None and len(values) > 1 and values[1] is not None:
        axes = pick_array(values[1], "axes").ravel().tolist()
    if not axes or not attributes.get("keepdims", 1):
        raise Unsupported(f"not supported: {OUTSIDE}")
    given, axes = values[0], [int(a) for a in axes]
    if isinstance(given, Moment):
        _require_features(given.of, axes)
        if given.stage == "square":
            return [replace(given, stage="variance")]
        raise Unsupported(OUTSIDE)
    signal = _follow(given)
    if signal is None:
        raise Unsupported("it is used on something that is not followed")
    rank = len(signal.axes)
    if [a % rank for a in axes] != [rank - 1] or signal.axes[-1].role != "feature":
        raise Unsupported(
            "not supported: it takes a mean over another axis than the features, the last one."
            " Only a layer normalisation over the features of a sample can be followed"
        )
    return [Moment(signal, "mean")]


def combine(node: onnx.NodeProto, values: list[Value]) -> list[Value]:
    """Add, Sub, Mul, Div, Pow, Sqrt and Reciprocal on the way of a normalisation."""
    a, b = (*values, None)[:2]
    match node.op_type, a, b:
        case "Sub", _, Moment(stage="mean") if not isinstance(a, Moment):
            signal = _follow(a)
            if signal is not None and is_same(signal, b.of):
                return [replace(b, stage="centered")]
        case "Pow", Moment(stage="centered"), _ if _number(b) == 2.0:
            return [replace(a, stage="square")]
        case "Mul", Moment(stage="centered"), Moment(stage="centered") if is_same(a.of, b.of):
            return [replace(a, stage="square")]
        case "Add", Moment(stage="variance"), _ if _number(b) is not None:
            return [replace(a, epsilon=a.epsilon + (_number(b) or 0.0))]
        case "Add", _, Moment(stage="variance") if _number(a) is not None:
            return [replace(b, epsilon=b.epsilon + (_number(a) or 0.0))]
        case "Sqrt", Moment(stage="variance"), _:
            return [replace(a, stage="deviation")]
        case "Pow", Moment(stage="variance"), _ if _number(b) in (0.5, -0.5):
            return [replace(a, stage="deviation" if _number(b) == 0.5 else "inverse")]
        case "Reciprocal", Moment(stage="deviation"), _:
            return [replace(a, stage="inverse")]
        case "Div", Moment(stage="centered"), Moment(stage="deviation") if is_same(a.of, b.of):
            return [normalise(a.of, b.epsilon, node)]
        case "Mul", Moment(stage="centered"), Moment(stage="inverse") if is_same(a.of, b.of):
            return [normalise(a.of, b.epsilon, node)]
        case "Mul", Moment(stage="inverse"), Moment(stage="centered") if is_same(a.of, b.of):
            return [normalise(a.of, a.epsilon, node)]
        case (("Identity" | "Cast" | "Dropout"), Moment(), _):
            return [a]
    raise Unsupported(OUTSIDE)


def _number(value: Value) -> float | None:
    """Return a constant that is one number; None where it is none."""
    try:
        array = pick_array(value, "operand")
    except Unsupported:
        return None
    return float(array.ravel()[0]) if array.size == 1 else None


# The effect of each operator of a float ONNX graph on the reader's values, family by family.

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
