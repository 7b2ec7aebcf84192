"""The quantizer: from a float compensator and its calibration to an integer model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Guards, IntegerModel
from zerodrift.export.lowering import Lowering
from zerodrift.export.quantize_layers import LayerScales, append_network
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, INT32_MIN, choose_exponent
from zerodrift.operations.dense import COPY_BITS, FloatDense
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.formats import COEFFICIENT_LIMIT
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.operation import Node
from zerodrift.operations.recurrent import IntegerRecurrent, number_layers
from zerodrift.operations.signals import Signal, constant

# What the network's integers stand for: the float network with its unrounded weights.

STATE_BITS = 30


def describe_features(
    taps: Sequence[Signal], whitening: Array, tap_mean: Array, exponents: IntArray
) -> list[Signal]:
    """Return the features, which stand for whitening @ (taps - mean), limited to int16.

    Args:
        taps: J signals.
        whitening: [I, J].
        tap_mean: [J].
        exponents: [I] f with feature = integer * 2**-f.
    """
    centres = [constant(-float(mean)) for mean in tap_mean]
    features = []
    for i, row in enumerate(whitening.tolist()):
        feature = Signal("features", 2.0 ** -int(exponents[i]), index=i)
        features.append(feature.standing_for("linear", (*taps, *centres), *row, *row))
    return features


def describe_network(
    network: FloatNetwork,
    scales: LayerScales,
    nodes: Sequence[IntegerNode],
    features: Sequence[Signal],
) -> list[Signal]:
    """Return the head's signals [K] of a model with a network, without the head's bias.

    Where it is neither a chain nor one LSTM over the features, no more is said of what the head
    reads than that it carries errors on: of each state, where it is the states of one recurrent
    layer.
    """
    cells, gains = [layer.cell for layer in network.layers], network.head.tolist()
    lone = cells[0] if len(cells) == 1 and network.reads == (1,) else None
    if network.is_chain:
        below = _describe_states(network.grus, features)
        named = {layer: (name, own) for name, (layer, own) in scales.layers.items()}
        for k, cell in enumerate(cells, 1):
            if isinstance(cell, FloatDense):
                below = _describe_dense(cell, *named[k], below)
    elif isinstance(lone, FloatLstm):
        below = _describe_lstm("lstm", lone, features)
    else:
        read = next(node for node in nodes if node.name in nodes[-1].inputs)
        recurrent = isinstance(read, IntegerRecurrent)
        gains = gains if recurrent else [[1.0]] * len(gains)
        below = [
            Signal(read.name, 2.0**-STATE_BITS, index=j).standing_for("recurrent", features)
            for j in range(read.width if recurrent else 1)
        ]
    heads = []
    for k, row in enumerate(gains):
        head = Signal("head", 2.0 ** -int(scales.head[k]), index=k)
        heads.append(head.standing_for("linear", below, *row))
    return heads


def _describe_states(grus: Sequence[FloatGru], features: Sequence[Signal]) -> list[Signal]:
    """Return the topmost state's signals; they are made of the int16 copies of the one below."""
    below = list(features)
    for name, gru in zip(number_layers("gru", len(grus), "."), grus, strict=True):
        node, bits = ("gru", STATE_BITS) if gru is grus[-1] else (name, COPY_BITS)
        states = []
        for j in range(gru.w_h.shape[1]):
            row = [*gru.bias[:, j], *gru.w_x[:, j].ravel(), *gru.w_h[:, j].ravel()]
            state = Signal(node, 2.0**-bits, index=j)
            states.append(state.standing_for(f"gru_{gru.reset}", below, *map(float, row)))
        below = states
    return below


def _describe_lstm(name: str, lstm: FloatLstm, features: Sequence[Signal]) -> list[Signal]:
    """Return the signals of an LSTM's output over the features."""
    states = []
    for j in range(lstm.hidden):
        row = [*lstm.bias[:, j], *lstm.w_x[:, j].ravel(), *lstm.w_h[:, j].ravel()]
        state = Signal(name, 2.0**-STATE_BITS, index=j)
        states.append(state.standing_for("lstm", features, *map(float, row)))
    return states


def _describe_dense(
    layer: FloatDense, name: str, exponents: IntArray, below: list[Signal]
) -> list[Signal]:
    signals = []
    for i, row in enumerate(layer.weight.tolist()):
        signal = Signal(name, 2.0 ** -int(exponents[i]), index=i)
        numbers = (layer.low, layer.high, float(layer.bias[i]), *row)
        signals.append(signal.standing_for(f"dense_{layer.activation}", below, *numbers))
    return signals


def describe_answers(
    model: FloatModel, features: Sequence[Signal], heads: Sequence[Signal]
) -> tuple[Signal, ...]:
    """Return the drifts [K]: features . coefficients + offset, and the network's answer."""
    answers = []
    for k, output in enumerate(model.outputs):
        terms, gains = [*features], model.coefficients[:, k].tolist()
        terms.append(constant(float(model.offset[k])))
        gains.append(1.0)
        if model.network is not None:
            terms += [heads[k], constant(float(model.network.head_bias[k]))]
            gains += [1.0, 1.0]
        answer = Signal("drift", 1.0 / output.lsb_per_unit, index=k)
        answers.append(answer.standing_for("linear", terms, *gains))
    return tuple(answers)


# The quantizer: from a float compensator and its calibration to an integer model.

FEATURE_HEADROOM = 2.0
"""A feature may grow to this multiple of its calibrated maximum before it saturates: a lag of the
temperature is as large as its rate, and users heat faster than chambers do. The bit is not missed:
16 bits over twice the range give the same error as over 1.25 times (`make bench`)."""


@dataclass(frozen=True)
class Quantized:
    """An integer model, and where the float model's nodes are in it."""

    model: IntegerModel
    signals: Mapping[Node, Signal]
    """Of every node of the float graph."""
    features: tuple[Signal, ...]
    """Of the float model's features, as held beyond calibration."""
    answers: tuple[Signal, ...]
    """Of the drifts; what they stand for is the float model, with its unrounded parameters."""
    scales: LayerScales | None = None
    """Of the network's layers, where there is one."""


def quantize(model: FloatModel, calibration: Calibration, weights: str = "int16") -> IntegerModel:
    """Return the integer model of `quantize_graph`."""
    return quantize_graph(model, calibration, weights).model


def quantize_graph(
    model: FloatModel, calibration: Calibration, weights: str = "int16"
) -> Quantized:
    """Return the integer model, proven free of overflow for every input, and its float nodes.

    Args:
        model: the float compensator.
        calibration: ranges seen in the training logs.
        weights: "int16" or "int8" (recurrent weights of the GRU).

    Raises:
        CheckError: no safe format exists, or an operation has no integer form; says which.
    """
    lowering = _start_lowering(model, calibration.code_limits, calibration.ranges)
    lowered = [_lower_feature(lowering, model, j) for j in range(len(model.features))]
    signals, coefficients, constant = _gather(lowered, model.coefficients)
    offset = model.offset + constant
    heads, scales = list[Signal](), None
    if model.network is not None:
        heads, scales = _lower_network(lowering, model, model.network, calibration, weights)
        offset = offset + model.network.head_bias
    head_exponents = scales.head if scales is not None else None
    _lower_drift(lowering, model, signals, coefficients, head_exponents, offset, calibration)
    low, high = calibration.temperature_range or calibration.code_limits[0]
    integer = IntegerModel(
        name=model.name,
        sample_period_s=model.sample_period_s,
        channels=model.channels,
        nodes=tuple(lowering.nodes),
        outputs=model.outputs,
        guards=Guards(
            warm_up_steps=calibration.warm_up_steps,
            temperature_channel=0,
            temperature_low=low,
            temperature_high=high,
            rate_max=calibration.rate_max,
            ranges=calibration.input_ranges,
        ),
        variable_step=model.variable_step,
    )
    integer.prove()
    answers = describe_answers(model, lowered, heads)
    return Quantized(integer, lowering.signals, tuple(lowered), answers, scales)


def bound_features(
    model: FloatModel,
    code_limits: tuple[tuple[int, int], ...],
    ranges: Mapping[Node, tuple[float, float]],
) -> tuple[Array, Array]:
    """Return what offset and features of a model can add up to [K], at least and at most.

    It holds for every history of inputs within their limits: each feature may be at its own end.

    Args:
        model: the float compensator.
        code_limits, ranges: as of `Calibration`.

    Raises:
        CheckError: as `quantize_graph`.
    """
    lowering = _start_lowering(model, code_limits, ranges)
    lowered = [_lower_feature(lowering, model, j) for j in range(len(model.features))]
    signals, coefficients, constant = _gather(lowered, model.coefficients)
    low = high = model.offset + constant
    for signal, row in zip(signals, coefficients, strict=True):
        interval = lowering.intervals[signal.node][0]
        ends = np.array([interval.low * row, interval.high * row])
        low, high = low + ends.min(axis=0), high + ends.max(axis=0)
    return low, high


def _start_lowering(
    model: FloatModel,
    code_limits: tuple[tuple[int, int], ...],
    ranges: Mapping[Node, tuple[float, float]],
) -> Lowering:
    return Lowering(
        channels=model.channels,
        sources=model.sources,
        limits=code_limits,
        sample_period_s=model.sample_period_s,
        variable_step=model.variable_step,
        outputs=tuple(output.name for output in model.outputs),
        clock_origin_s=model.clock_origin_s,
        ranges=ranges,
    )


def _gather(signals: Sequence[Signal], coefficients: Array) -> tuple[list[Signal], Array, Array]:
    """Return a weighted sum of signals with every node once.

    Args:
        signals: J of them; some may be constant, or the same node at other scales.
        coefficients: [J, K] per physical unit.

    Returns:
        the nodes that move, M of them at scale 1; coefficients [M, K] per count; constant [K].
    """
    rows: dict[str, Array] = {}
    constant = np.zeros(coefficients.shape[1])
    for signal, row in zip(signals, coefficients, strict=True):
        constant = constant + signal.offset * row
        if signal.node:
            rows[signal.node] = rows.get(signal.node, 0.0) + signal.scale * row
    stacked = np.array(list(rows.values())).reshape(len(rows), coefficients.shape[1])
    return [Signal(node, 1.0) for node in rows], stacked, constant


def _lower_feature(lowering: Lowering, model: FloatModel, j: int) -> Signal:
    """Return the integer signal of a feature; a refusal names the feature."""
    try:
        return lowering.lower_feature(model.features[j])
    except CheckError as error:
        if not model.feature_names:
            raise
        raise CheckError(f"feature '{model.feature_names[j]}': {error}") from error


def _read_first_input(lowering: Lowering, model: FloatModel) -> Signal:
    """Return the temperature, for a node that would read nothing otherwise."""
    return lowering.lower(Node("input", source=next(iter(model.sources))))


def _lower_network(
    lowering: Lowering,
    model: FloatModel,
    network: FloatNetwork,
    calibration: Calibration,
    weights: str,
) -> tuple[list[Signal], LayerScales]:
    """Add features, layers and head; return the head's signals, and what the integers stand for."""
    assert model.whitening is not None and model.tap_mean is not None
    taps = [lowering.lower(node) for node in model.taps]
    exponents = choose_feature_exponents(calibration)
    inputs, rows, constant = _gather(taps, model.whitening.T * 2.0**exponents)
    constant = constant - model.whitening @ model.tap_mean * 2.0**exponents
    if not inputs:
        inputs, rows = [_read_first_input(lowering, model)], np.zeros((1, exponents.size))
    matrix = np.zeros((exponents.size, len(inputs)), dtype=np.int32)
    bias = np.zeros(exponents.size, dtype=np.int64)
    shifts = []
    for i in range(exponents.size):
        matrix[i], bias[i], shift = lowering.format_row(
            inputs, rows[:, i], float(constant[i]), f"features[{i}]", COEFFICIENT_LIMIT
        )
        shifts.append(shift)
    lowering.append(
        IntegerFeatures(
            name="features",
            inputs=tuple(t.node for t in inputs),
            matrix=matrix,
            bias=bias,
            shift=tuple(shifts),
        )
    )
    features = describe_features(taps, model.whitening, model.tap_mean, exponents)
    scales = append_network(lowering, network, exponents, weights, model.window)
    return describe_network(network, scales, lowering.nodes, features), scales


def choose_feature_exponents(calibration: Calibration) -> IntArray:
    """Return [I] f of the network's features, which stand for integer * 2**-f."""
    largest = FEATURE_HEADROOM * calibration.feature_max
    return np.array([min(choose_exponent(float(x), INT16_MAX), 15) for x in largest])


def _lower_drift(
    lowering: Lowering,
    model: FloatModel,
    signals: list[Signal],
    weights: Array,
    head_exponents: IntArray | None,
    offset: Array,
    calibration: Calibration,
) -> None:
    """Add the last node: per output the sum of features and head, limited to its range."""
    outputs = len(model.outputs)
    inputs = list(signals)
    if head_exponents is not None:
        inputs.append(Signal("head", 1.0))
    if not inputs:  # a constant model still reads its thermometer, for the flags
        inputs = [_read_first_input(lowering, model)]
    coefficients = np.zeros((outputs, len(inputs)), dtype=np.int64)
    bias = np.zeros(outputs, dtype=np.int64)
    shifts, lows, highs = [], [], []
    for k, output in enumerate(model.outputs):
        row = np.zeros(len(inputs))
        row[: len(signals)] = weights[:, k] * output.lsb_per_unit
        constant = float(offset[k] * output.lsb_per_unit)
        if head_exponents is not None:
            row[-1] = output.lsb_per_unit * 2.0 ** -float(head_exponents[k])
        coefficients[k], bias[k], shift = lowering.format_row(
            inputs, row, constant, f"drift[{output.name}]"
        )
        shifts.append(shift)
        lows.append(_limit(calibration.drift_low[k] * output.lsb_per_unit))
        highs.append(_limit(calibration.drift_high[k] * output.lsb_per_unit))
    has_head = head_exponents is not None
    lowering.append(
        IntegerDrift(
            name="drift",
            inputs=tuple(s.node for s in inputs),
            coefficients=coefficients[:, :-1] if has_head else coefficients,
            head_coefficients=coefficients[:, -1]
            if has_head
            else np.zeros(outputs, dtype=np.int64),
            bias=bias,
            shift=tuple(shifts),
            low=tuple(lows),
            high=tuple(highs),
            head=has_head,
        )
    )


def _limit(value: float) -> int:
    return int(min(max(round(value), INT32_MIN), INT32_MAX))
