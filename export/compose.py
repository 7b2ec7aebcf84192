"""From the trained compensator and its logs to what the quantizer takes: graph and calibration."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zerodrift.config import Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.onnx_reader import read_network_bytes
from zerodrift.export.quantize import Calibration, FloatModel, quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.graph import GraphOperations, Node, list_nodes

if TYPE_CHECKING:  # torch is not needed to read what training left
    from zerodrift.train.compensator import Compensator

Array = NDArray[np.float64]

TEMPERATURE_LSB_DEGC = 0.0078125
"""One count of the TMP117, 2**-7 K (Texas Instruments, TMP117 data sheet, temperature register)."""
OUTPUT_STEPS = 1e6
"""One count of an output is the power of ten at or below full scale / 1e6."""
FLAG_MARGIN_K = 2.0
"""The temperature is flagged when it is further than this from the calibrated range."""
RANGE_MARGIN = 0.25
"""Share of the calibrated span by which temperature, channels and corrections may go beyond it
before they are limited, and share by which the temperature may move faster before it is flagged.
A little extrapolation beats none; a lot of it is worth nothing."""
WARM_SHARE = 1e-3
"""The model is warm when starts from cold and from rest differ by less than this share of the
correction's range, for good."""
WARM_UP_RUN_STEPS = 20_000


def compose_integer_model(
    compensator: "Compensator", config: Config, dataset: Dataset
) -> IntegerModel:
    """Return the quantized compensator, with its warm-up time measured on the training logs.

    Raises:
        CheckError: an effect has no fixed-point form, or no safe format exists.
    """
    model = describe_compensator(compensator, config, dataset.train)
    calibration = calibrate(compensator, model, dataset.train)
    cold = quantize(model, calibration, config.weights)
    steps = measure_warm_up(cold, dataset.train)
    return replace(cold, guards=replace(cold.guards, warm_up_steps=steps))


def describe_compensator(
    compensator: "Compensator", config: Config, runs: Sequence[Run]
) -> FloatModel:
    """Return the compensator as one float graph with raw input channels."""
    ops = GraphOperations(config.sample_period_s)
    physics = compensator.physics
    features = physics.graph(ops).features
    coefficients = physics.coefficients
    offset = np.zeros(len(config.outputs))
    front_end = compensator.front_end
    taps: tuple[Node, ...] = ()
    if front_end is not None:
        taps = front_end.graph(ops)
        offset = compensator.tap_offset
        moving = np.abs(compensator.linear).max(axis=1) > 0.0
        if moving.any():  # the linear part rides on the taps
            features = (*features, *taps)
            coefficients = np.concatenate([coefficients, compensator.tap_coefficients])
    channels, sources = _list_channels([*features, *taps], runs)
    return FloatModel(
        name=config.sensor_name,
        sample_period_s=config.sample_period_s,
        channels=channels,
        sources=sources,
        outputs=tuple(
            OutputFormat(o.name, o.unit, _choose_lsb_per_unit(o.full_scale), o.full_scale)
            for o in config.outputs
        ),
        features=features,
        coefficients=coefficients,
        offset=offset,
        taps=taps,
        tap_mean=front_end.mean if front_end is not None else None,
        whitening=front_end.matrix if front_end is not None else None,
        network=read_network_bytes(compensator.network, "the trained network")
        if compensator.network is not None
        else None,
        window=0 if compensator.memory == "stream" else int(compensator.memory),
    )


def _list_channels(
    roots: Sequence[Node], runs: Sequence[Run]
) -> tuple[tuple[Channel, ...], dict[str, int]]:
    """Return the raw inputs that the graph needs; the temperature is always the first."""
    channels = [Channel("temperature", "degC", TEMPERATURE_LSB_DEGC)]
    sources = {"temperature_degC": 0}
    for node in list_nodes(roots):
        name = node.source
        if node.op == "input" and name not in sources and all(name in r.inputs for r in runs):
            low, high = _find_span([run.inputs[name] for run in runs])
            lsb = 2.0 ** math.ceil(math.log2(max(abs(low), abs(high), 1e-30) / 16384.0))
            sources[name] = len(channels)
            channels.append(Channel(name, "as logged", lsb))
    return tuple(channels), sources


def _find_span(arrays: Sequence[Array]) -> tuple[float, float]:
    return min(float(a.min()) for a in arrays), max(float(a.max()) for a in arrays)


def _choose_lsb_per_unit(full_scale: float) -> int:
    decades = math.ceil(math.log10(OUTPUT_STEPS / full_scale))
    return int(10 ** max(0, min(9, decades)))


def encode_inputs(model: FloatModel | IntegerModel, run: Run) -> NDArray[np.int16]:
    """Return the raw codes [n, C] that the hardware would have given for a run."""
    columns = []
    for channel in model.channels:
        values = run.temperature_degC if channel.name == "temperature" else run.inputs[channel.name]
        codes = np.round((values - channel.offset) / channel.lsb)
        columns.append(np.clip(codes, -32768, 32767).astype(np.int16))
    return np.stack(columns, axis=1)


def calibrate(compensator: "Compensator", model: FloatModel, runs: Sequence[Run]) -> Calibration:
    """Return the ranges that the training runs showed, with their margins."""
    limits = []
    codes = [encode_inputs(model, run).astype(np.int64) for run in runs]
    spans = []
    for index in range(len(model.channels)):
        low = min(int(c[:, index].min()) for c in codes)
        high = max(int(c[:, index].max()) for c in codes)
        spans.append((low, high))
        limits.append(_widen(low, high, RANGE_MARGIN * (high - low) + 1))
    rate = max(int(np.abs(np.diff(c[:, 0])).max(initial=0)) for c in codes)
    largest = np.zeros(0)
    if compensator.front_end is not None:
        features = [compensator.front_end.compute(run) for run in runs]
        largest = np.max([np.abs(x).max(axis=0) for x in features], axis=0)
    drifts = [compensator.predict(run) for run in runs] + [run.drift for run in runs]
    low_drift = np.min([d.min(axis=0) for d in drifts], axis=0)
    high_drift = np.max([d.max(axis=0) for d in drifts], axis=0)
    margin_drift = RANGE_MARGIN * (high_drift - low_drift)
    return Calibration(
        code_limits=tuple(limits),
        feature_max=largest,
        drift_low=low_drift - margin_drift,
        drift_high=high_drift + margin_drift,
        rate_max=min(math.ceil(rate * (1.0 + RANGE_MARGIN)) + 2, 65535),
        warm_up_steps=0,
        temperature_range=_widen(*spans[0], FLAG_MARGIN_K / model.channels[0].lsb),
    )


def _widen(low: int, high: int, margin: float) -> tuple[int, int]:
    """Return the int16 codes low - margin .. high + margin."""
    return max(low - round(margin), -32768), min(high + round(margin), 32767)


def measure_warm_up(model: IntegerModel, runs: Sequence[Run]) -> int:
    """Return the steps after which a cold start agrees with a start at rest, on the longest run."""
    layer = model.recurrent
    if layer is None or layer.window:
        return 0  # everything but a carried state starts at rest even from cold
    codes = encode_inputs(model, max(runs, key=len))[None, :WARM_UP_RUN_STEPS]
    reference = Reference(model)
    first = codes[:, 0].astype(np.int64)
    starts = [reference.start(first, settled=settled).pack() for settled in (False, True)]
    state = reference.start(first, settled=True).unpack(np.concatenate(starts))
    drift = reference.run(np.repeat(codes, 2, axis=0), state=state).drift.astype(np.int64)
    cold, rest = drift
    span = np.array(model.drift.high, dtype=np.float64) - np.array(model.drift.low)
    differs = (np.abs(cold - rest) > WARM_SHARE * span).any(axis=1)
    return int(np.flatnonzero(differs)[-1]) + 1 if differs.any() else 0


def predict_integer(model: IntegerModel, run: Run) -> Array:
    """Return the drift [n, K] that the chip computes for a run, in each output's unit."""
    trace = Reference(model).run(encode_inputs(model, run)[None])
    scale = np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)
    return np.asarray(trace.drift[0] / scale)
