"""Layer normalisation in a float ONNX graph: as one operator, or taken apart.

Before opset 17 PyTorch writes ReduceMean, Sub, Pow, ReduceMean, Add, Sqrt, Div. What stands between
is followed as a `Moment`, which means something only as a part of a normalisation.
"""

from dataclasses import replace

import numpy as np
import onnx

from zerodrift.base.arrays import Array
from zerodrift.export.onnx_shapes import Attributes, pick_array
from zerodrift.export.onnx_values import (
    Moment,
    OnnxSignal,
    OnnxSource,
    RawInput,
    Unsupported,
    Value,
    bind,
)
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.layer_norm import FloatLayerNorm

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
