"""The quantizer: from a float compensator and its calibration to an integer model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.errors import CheckError
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Guards, IntegerModel
from zerodrift.export.layered_network import FloatLayeredNetwork
from zerodrift.export.lowering import Lowering
from zerodrift.export.quantize_layered import LayeredScales, append_layered
from zerodrift.export.quantize_layers import append_network
from zerodrift.export.real_network import (
    describe_answers,
    describe_features,
    describe_layered,
    describe_network,
)
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, INT32_MIN, choose_exponent
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.formats import COEFFICIENT_LIMIT
from zerodrift.operations.graph import Node
from zerodrift.operations.signals import Signal

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
    scales: LayeredScales | None = None
    """Of the layers of a network whose layers may read several others."""


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
    lowering = Lowering(
        channels=model.channels,
        sources=model.sources,
        limits=calibration.code_limits,
        sample_period_s=model.sample_period_s,
        variable_step=model.variable_step,
        outputs=tuple(output.name for output in model.outputs),
        clock_origin_s=model.clock_origin_s,
        ranges=calibration.ranges,
    )
    lowered = [_lower_feature(lowering, model, j) for j in range(len(model.features))]
    signals, coefficients, constant = _gather(lowered, model.coefficients)
    offset = model.offset + constant
    head_exponents, heads, scales = None, list[Signal](), None
    if model.network is not None:
        lowered_network = _lower_network(lowering, model, model.network, calibration, weights)
        head_exponents, heads, scales = lowered_network
        offset = offset + model.network.head_bias
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


def _gather(
    signals: Sequence[Signal], coefficients: Array
) -> tuple[list[Signal], Array, NDArray[np.float64]]:
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
    network: FloatNetwork | FloatLayeredNetwork | FloatFeedForward,
    calibration: Calibration,
    weights: str,
) -> tuple[NDArray[np.int64], list[Signal], LayeredScales | None]:
    """Add features, layers and head; return the exponent of each head row, and its signals.

    Where a layer may read several others, also what the layers' integers stand for.
    """
    assert model.whitening is not None and model.tap_mean is not None
    taps = [lowering.lower(node) for node in model.taps]
    exponents = np.array(
        [
            min(choose_exponent(FEATURE_HEADROOM * float(largest), INT16_MAX), 15)
            for largest in calibration.feature_max
        ]
    )
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
    if isinstance(network, FloatLayeredNetwork):
        scales = append_layered(lowering, network, exponents, weights, model.window)
        heads = describe_layered(network, scales, lowering.nodes, features)
        return scales.head, heads, scales
    read_out = append_network(lowering, network, exponents, weights, model.window)
    return read_out.head_exponents, describe_network(network, features, read_out), None


def _lower_drift(
    lowering: Lowering,
    model: FloatModel,
    signals: list[Signal],
    weights: Array,
    head_exponents: NDArray[np.int64] | None,
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
