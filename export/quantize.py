"""The quantizer: a float compensator and what it saw in calibration become an integer model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.errors import CheckError
from zerodrift.export.integer_model import Channel, Guards, IntegerModel, OutputFormat
from zerodrift.export.lowering import Lowering, Signal
from zerodrift.export.onnx_reader import FloatNetwork
from zerodrift.export.quantize_gru import quantize_gru, quantize_head
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, INT32_MIN, choose_exponent
from zerodrift.operations.graph import Node
from zerodrift.operations.network import (
    IntegerDrift,
    IntegerFeatures,
    IntegerGruLayer,
    IntegerHead,
)

Array = NDArray[np.float64]

FEATURE_HEADROOM = 1.25
"""A feature may grow to this multiple of its calibrated maximum before it saturates."""
COEFFICIENT_LIMIT = 2**30
SUM_LIMIT = 2**61
"""The 64-bit sums of drift and features stay below this, halves and biases included."""


@dataclass(frozen=True)
class FloatModel:
    """A whole compensator in float: drift = features . coefficients + offset + network(taps)."""

    name: str
    sample_period_s: float
    channels: tuple[Channel, ...]
    sources: dict[str, int]
    """Signal name of the graph -> channel index."""
    outputs: tuple[OutputFormat, ...]
    features: tuple[Node, ...]
    coefficients: Array
    """[J, K] output units per feature unit."""
    offset: Array
    """[K] output units."""
    taps: tuple[Node, ...] = ()
    tap_mean: Array | None = None
    """[I]."""
    whitening: Array | None = None
    """[I', I]: the network's input is whitening @ (taps - mean)."""
    network: FloatNetwork | None = None
    window: int = 0
    """0: the network's state is carried from sample to sample."""


@dataclass(frozen=True)
class Calibration:
    """What the training logs showed: the ranges that formats and guards are chosen from."""

    code_limits: tuple[tuple[int, int], ...]
    """Per channel: inputs outside are limited to these codes."""
    feature_max: Array
    """[I'] largest absolute value of each network input."""
    drift_low: Array
    drift_high: Array
    """[K] the correction is limited to this range, in output units."""
    rate_max: int
    """Temperature codes per step."""
    warm_up_steps: int
    temperature_range: tuple[int, int] | None = None
    """Codes outside of which the temperature is flagged; None for its code limits."""


def quantize(model: FloatModel, calibration: Calibration, weights: str = "int16") -> IntegerModel:
    """Return the integer model, proven free of overflow for every input.

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
    )
    lowered = [lowering.lower(node) for node in model.features]
    constant = np.array([s.node == "" for s in lowered], dtype=bool)
    signals = [s for s in lowered if s.node]
    coefficients = model.coefficients[~constant]
    offset = (
        model.offset
        + np.array([s.offset for s in lowered if not s.node]) @ (model.coefficients[constant])
    )
    head_exponents = None
    if model.network is not None:
        head_exponents = _lower_network(lowering, model, model.network, calibration, weights)
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
        ),
    )
    integer.prove()
    return integer


def _lower_network(
    lowering: Lowering,
    model: FloatModel,
    network: FloatNetwork,
    calibration: Calibration,
    weights: str,
) -> NDArray[np.int64]:
    """Add features, GRU and head; return the exponent of each head row."""
    assert model.whitening is not None and model.tap_mean is not None
    taps = [lowering.lower(node) for node in model.taps]
    exponents = np.array(
        [
            min(choose_exponent(FEATURE_HEADROOM * float(largest), INT16_MAX), 15)
            for largest in calibration.feature_max
        ]
    )
    count = model.whitening.shape[0]
    matrix = np.zeros((count, len(taps)), dtype=np.int32)
    bias = np.zeros(count, dtype=np.int64)
    shifts = []
    for i in range(count):
        row = model.whitening[i] * 2.0 ** exponents[i]
        constant = float(row @ (np.array([t.offset for t in taps]) - model.tap_mean))
        matrix[i], bias[i], shift = _format_row(lowering, taps, row, constant, f"features[{i}]")
        shifts.append(shift)
    lowering.append(
        IntegerFeatures(
            name="features",
            inputs=tuple(t.node for t in taps),
            matrix=matrix,
            bias=bias,
            shift=tuple(shifts),
        )
    )
    gru = quantize_gru(network.gru, exponents, weights)
    lowering.append(IntegerGruLayer(name="gru", inputs=("features",), gru=gru, window=model.window))
    head, head_exponents = quantize_head(network.head)
    lowering.append(IntegerHead(name="head", inputs=("gru",), weights=head))
    return head_exponents


def _format_row(
    lowering: Lowering, signals: list[Signal], row: Array, constant: float, where: str
) -> tuple[NDArray[np.int64], int, int]:
    """Return integer coefficients, bias (half folded in) and shift of a 64-bit sum of signals.

    Args:
        lowering: knows the signals' intervals.
        signals: the J inputs.
        row: [J] wanted result per physical unit of each signal.
        constant: wanted result of the signals' zeros.
        where: names the row in messages.
    """
    scaled = row * np.array([s.scale for s in signals]) if signals else np.zeros(0)
    reach = abs(constant) + sum(
        abs(float(c)) * lowering.intervals[s.node][0].magnitude
        for c, s in zip(scaled, signals, strict=True)
    )
    largest = float(np.abs(scaled).max(initial=0.0))
    shift = min(choose_exponent(largest, COEFFICIENT_LIMIT), choose_exponent(reach, SUM_LIMIT), 56)
    if shift < 0:
        raise CheckError(
            f"{where}: the coefficients of {[s.node for s in signals]} are too large for a 64-bit"
            " sum; the model is refused. Use a coarser output unit."
        )
    half = 1 << shift >> 1
    coefficients = np.array([round(float(c) * 2.0**shift) for c in scaled], dtype=np.int64)
    return coefficients, round(constant * 2.0**shift) + half, shift


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
        inputs = [lowering.lower(Node("input", source=next(iter(model.sources))))]
    coefficients = np.zeros((outputs, len(inputs)), dtype=np.int64)
    bias = np.zeros(outputs, dtype=np.int64)
    shifts, lows, highs = [], [], []
    for k, output in enumerate(model.outputs):
        row = np.zeros(len(inputs))
        row[: len(signals)] = weights[:, k] * output.lsb_per_unit
        physical_offsets = np.array([s.offset for s in inputs])
        constant = float(offset[k] * output.lsb_per_unit + row @ physical_offsets)
        if head_exponents is not None:
            row[-1] = output.lsb_per_unit * 2.0 ** -float(head_exponents[k])
        coefficients[k], bias[k], shift = _format_row(
            lowering, inputs, row, constant, f"drift[{output.name}]"
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
