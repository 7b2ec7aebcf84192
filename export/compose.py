"""From the trained compensator and its logs to the quantizer's input: graph and calibration."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.config import LONGEST_WINDOW, Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.chip_codes import (
    FLAG_MARGIN_K,
    MEASURED,
    RANGE_MARGIN,
    choose_codes,
    read_source,
    refuse_outside,
)
from zerodrift.dataset.runs import Dataset, Run, predict_along
from zerodrift.export.channels import list_channels
from zerodrift.export.encoding import encode_channel, find_held
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import (
    Channel,
    IntegerModel,
    OutputFormat,
    code_type,
    convert_codes,
)
from zerodrift.export.onnx_reader import ImportedNetwork, read_imported_bytes
from zerodrift.export.quantize import Quantized, bound_features, quantize_graph
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.backend import GraphOperations, evaluate
from zerodrift.operations.formats import RANGE_SPANS
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.operations.times import count_us
from zerodrift.physics.signals import LATEST_RELATIVE_TIME_S
from zerodrift.physics.summary import summarise_model
from zerodrift.train.onnx_export import OnnxNetwork

if TYPE_CHECKING:
    from zerodrift.train.compensator import Compensator


OUTPUT_STEPS = 1e6
"""One count of an output is the power of ten at or below full scale / 1e6."""
WARM_SHARE = 1e-3
"""The model is warm when starts from cold and from rest differ by less than this share of the
correction's range, for good."""
WARM_UP_RUN_STEPS = 20_000
POWER_ON, FIRST_ROW = "power_on", "first row of a log"
"""Note of a model whose logs do not count their time from power-on."""


def compose_integer_model(model: FloatModel, config: Config, dataset: Dataset) -> IntegerModel:
    """Return the integer model of `compose_quantized`."""
    return compose_quantized(model, config, dataset).model


def compose_quantized(model: FloatModel, config: Config, dataset: Dataset) -> Quantized:
    """Return the quantized compensator, with its warm-up time measured on the training logs.

    Raises:
        CheckError: an effect has no fixed-point form, or no safe format exists.
        InputError: a log leaves the range of the codes.
    """
    refuse_logs_outside(config, model, dataset)
    quantized = quantize_graph(model, calibrate(model, dataset.train), config.weights)
    cold = quantized.model
    if model.plan is not None and model.plan.starts_at_first_row:
        cold = replace(cold, notes={**cold.notes, POWER_ON: FIRST_ROW})
    warm = replace(
        cold,
        guards=replace(cold.guards, warm_up_steps=measure_warm_up(cold, dataset.train)),
        prefix=config.firmware_prefix,
        guarded=config.firmware_guard,
        tare=config.firmware_tare,
    )
    return replace(quantized, model=warm)


def refuse_logs_outside(config: Config, model: FloatModel, dataset: Dataset) -> None:
    """Refuse logs with a value that no code of the firmware's inputs represents.

    Raises:
        InputError: names file and line, run, value, what the codes hold, and what to do.
    """
    codes = [choose_codes(config, c.source, dataset.train, c.lsb) for c in model.channels]
    refuse_outside(config, codes, [*dataset.train, *dataset.test, *dataset.dwell])


def describe_compensator(
    compensator: "Compensator", config: Config, runs: Sequence[Run]
) -> FloatModel:
    """Return the compensator as one float graph with raw input channels."""
    ops = GraphOperations(config.sample_period_s)
    physics = compensator.physics
    features = physics.graph(ops).features
    names = physics.feature_names
    coefficients = physics.coefficients
    offset = np.zeros(len(config.outputs))
    front_end = compensator.front_end
    taps: tuple[Node, ...] = ()
    bank = compensator.bank
    if bank is not None:
        features = (*features, *bank.graph(ops))
        names = (*names, *bank.names)
        coefficients = np.concatenate([coefficients + bank.correction, bank.coefficients])
    if front_end is not None:
        taps = front_end.graph(ops)
        offset = compensator.tap_offset
        moving = np.abs(compensator.linear).max(axis=1) > 0.0
        if moving.any():  # the linear part is in the taps' coefficients
            features = (*features, *taps)
            names = (*names, *(str(tap) for tap in front_end.taps))
            coefficients = np.concatenate([coefficients, compensator.tap_coefficients])
    outputs = list_outputs(config)
    channels, sources = list_channels([*features, *taps], config, runs, outputs)
    return FloatModel(
        name=config.sensor_name,
        sample_period_s=config.sample_period_s,
        channels=channels,
        sources=sources,
        outputs=outputs,
        features=features,
        feature_names=names,
        clock_origin_s=physics.plan.clock_origin_s,
        coefficients=coefficients,
        offset=offset,
        taps=taps,
        tap_mean=front_end.mean if front_end is not None else None,
        whitening=front_end.matrix if front_end is not None else None,
        network=_read_network(compensator),
        window=compensator.window,
        plan=physics.plan,
        tared=compensator.tared,
        set_aside=physics.set_aside,
        effects=summarise_model(physics),
        variable_step=config.variable_step,
        physics=_describe_physics(compensator, config, runs),
    )


def _describe_physics(
    compensator: "Compensator", config: Config, runs: Sequence[Run]
) -> FloatModel | None:
    """Return the physical model alone, if something was learnt beside it."""
    if compensator.network is None and compensator.bank is None:
        return None
    alone = replace(compensator, front_end=None, network=None, bank=None)
    return describe_compensator(alone, config, runs)


def _read_network(compensator: "Compensator") -> FloatNetwork | None:
    if compensator.network is None:
        return None
    if compensator.is_recurrent:
        network = read_imported_bytes(compensator.network, "the trained network").network
        return replace(network, trained=OnnxNetwork(compensator.network))
    layers = compensator.feed_forward
    return FloatNetwork.stack(layers.dense, layers.head, layers.head_bias)


def list_outputs(config: Config) -> tuple[OutputFormat, ...]:
    """Return how the chip counts each of the project's outputs."""
    return tuple(
        OutputFormat(o.name, o.unit, choose_lsb_per_unit(o.full_scale), o.full_scale)
        for o in config.outputs
    )


def choose_lsb_per_unit(full_scale: float) -> int:
    """Return the counts of one unit: the power of ten that gives full scale a million of them."""
    decades = math.ceil(math.log10(OUTPUT_STEPS / full_scale))
    return int(10 ** max(0, min(9, decades)))


def encode_inputs(model: FloatModel | IntegerModel, run: Run) -> CodeArray:
    """Return the codes [n, C] that the hardware would have given for a run, raw where they are.

    Of a model with a variable step they are followed by the microseconds since the row before.

    Raises:
        InputError: no code represents a value.
    """
    names = [output.name for output in model.outputs]
    columns = []
    for channel in model.channels:
        values = read_source(names, channel.source, run)
        cold = None
        if channel.conversion is not None and channel.conversion.junction is not None:
            cold = encode_junction(model.channels, channel.conversion.junction.channel, run, names)
        codes, outside = encode_channel(channel, values, cold)
        if outside.any():
            raise _explain_outside(channel, run, values, int(outside.argmax()))
        columns.append(codes)
    if model.variable_step:
        times_us = np.full(len(run), count_us(model.sample_period_s), dtype=np.float64)
        times_us[0] = 0.0  # the log begins at rest
        return np.stack([*columns, times_us], axis=1).astype(np.int64)
    return np.stack(columns, axis=1).astype(code_type(model.channels))


def encode_junction(
    channels: Sequence[Channel], index: int, run: Run, outputs: Sequence[str]
) -> IntArray:
    """Return the codes [n] of the channel that measures a cold junction, converted if they are."""
    channel = channels[index]
    codes, _ = encode_channel(channel, read_source(outputs, channel.source, run))
    given = codes.astype(np.int64)
    return given if channel.conversion is None else channel.conversion.convert(given)


def encode_quantities(model: FloatModel | IntegerModel, run: Run) -> IntArray:
    """Return the channels' own codes [n, C] of a run, into which raw ones are converted."""
    codes = encode_inputs(model, run)[:, : len(model.channels)]
    return convert_codes(model.channels, codes)


def _explain_outside(channel: Channel, run: Run, values: Array, row: int) -> InputError:
    low, high = (f"{value:.10g}" for value in find_held(channel))
    return InputError(
        f"{run.source}: run '{run.name}', at {run.time_s[row]:g} s: '{channel.name}' is "
        f"{values[row]:.10g}; its codes hold {low} to {high} and one of them may mean no reading. "
        "Correct the log, or give the column a table with a range in zerodrift.toml, and build the "
        "firmware again."
    )


def count_elapsed(model: IntegerModel, run: Run) -> int:
    """Return the steps since power-on at the first sample of a run.

    The log's time counts from power-on, unless the physical model found that its logs cannot (the
    model's note says so) or it is no time since power-on at all: then the log's first row counts.
    """
    first_s = float(run.time_s[0])
    if model.notes.get(POWER_ON) == FIRST_ROW or not 0.0 <= first_s < LATEST_RELATIVE_TIME_S:
        first_s -= first_s if run.start_s is None else run.start_s
    return round(first_s / run.sample_period_s)


def calibrate(model: FloatModel, runs: Sequence[Run]) -> Calibration:
    """Return the ranges that the training runs showed, with their margins.

    The correction is limited to what the features can give anywhere within these ranges, whatever
    came before, and to what a network was seen to add to them.
    """
    limits, ranges = [], []
    names = [output.name for output in model.outputs]
    codes = [encode_quantities(model, run) for run in runs]
    for index, channel in enumerate(model.channels):
        columns = [c[:, index] for c in codes]
        spans = RANGE_SPANS if model.sources.get("clock_s") == index else RANGE_MARGIN
        if index:
            ranges.append((index, *find_flagged(channel, columns, spans)))
        if channel.source.startswith(MEASURED):  # the limits are those of the load
            k = names.index(channel.source.removeprefix(MEASURED))
            columns = [np.round(r.reference[:, k] / channel.lsb).astype(np.int64) for r in runs]
        low, high = min(int(c.min()) for c in columns), max(int(c.max()) for c in columns)
        margin = spans * (high - low) + 1
        limits.append(widen(low, high, margin, channel.bits))
    span = (min(int(c[:, 0].min()) for c in codes), max(int(c[:, 0].max()) for c in codes))
    rate = max(int(np.abs(np.diff(c[:, 0])).max(initial=0)) for c in codes)
    largest = np.zeros(0)
    if model.taps:
        inputs = [model.compute_network_inputs(run) for run in runs]
        largest = np.max([np.abs(x).max(axis=0) for x in inputs], axis=0)
    limits_known = tuple(limits)
    known = measure_ranges(model, runs)
    lowest, highest = bound_features(model, limits_known, known)
    if model.network is not None:
        learnt = [model.predict_network(run) for run in runs]
        low_learnt = np.min([x.min(axis=0) for x in learnt], axis=0)
        high_learnt = np.max([x.max(axis=0) for x in learnt], axis=0)
        margin_learnt = RANGE_MARGIN * (high_learnt - low_learnt)
        lowest, highest = lowest + low_learnt - margin_learnt, highest + high_learnt + margin_learnt
    return Calibration(
        code_limits=limits_known,
        feature_max=largest,
        drift_low=lowest,
        drift_high=highest,
        rate_max=limit_rate(model.channels[0], rate),
        warm_up_steps=0,
        input_ranges=tuple(ranges),
        temperature_range=widen(
            *span, FLAG_MARGIN_K / model.channels[0].lsb, model.channels[0].bits
        ),
        ranges=known,
    )


def find_flagged(channel: Channel, columns: Sequence[IntArray], spans: float) -> tuple[int, int]:
    """Return the codes beyond which an input is flagged; there is one beyond on either side."""
    low, high = min(int(c.min()) for c in columns), max(int(c.max()) for c in columns)
    margin = round(spans * (high - low)) + 1
    return max(low - margin, channel.least + 2), min(high + margin, channel.most - 2)


def limit_rate(thermometer: Channel, largest: int) -> int:
    """Return the codes that the temperature may move in a step, from the largest that it did."""
    return min(math.ceil(largest * (1.0 + RANGE_MARGIN)) + 2, 2 * thermometer.most + 1, 2**31 - 1)


def measure_ranges(model: FloatModel, runs: Sequence[Run]) -> dict[Node, tuple[float, float]]:
    """Return the lowest and highest value of every node of the graph over the runs."""
    nodes = list_nodes([*model.features, *model.taps])
    lows, highs = np.full(len(nodes), np.inf), np.full(len(nodes), -np.inf)
    for run in runs:
        values = evaluate(nodes, model.read_inputs(run), run.sample_period_s)
        lows = np.minimum(lows, [float(v.min()) for v in values])
        highs = np.maximum(highs, [float(v.max()) for v in values])
    return {
        node: (float(low), float(high)) for node, low, high in zip(nodes, lows, highs, strict=True)
    }


def widen(low: int, high: int, margin: float, bits: int) -> tuple[int, int]:
    """Return the codes low - margin .. high + margin, as far as they fit."""
    limit = 2 ** (bits - 1)
    return max(low - round(margin), -limit), min(high + round(margin), limit - 1)


def measure_warm_up(model: IntegerModel, runs: Sequence[Run]) -> int:
    """Return the steps after which a cold start agrees with a start at rest, on the longest run."""
    if not model.streams:
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
    if run.before is not None:
        return predict_along(lambda whole: predict_integer(model, whole), run)
    codes = encode_inputs(model, run)[None]
    trace = Reference(model).run(codes, elapsed=count_elapsed(model, run))
    scale = np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)
    return np.asarray(trace.drift[0] / scale)


# From a network that another program trained, and logs to scale by, to the float model.

TEMPERATURE = "temperature"
"""Name of the feature that is the chip's own thermometer; others are names of [inputs]."""


def describe_imported(
    imported: ImportedNetwork,
    config: Config,
    runs: Sequence[Run],
    features: Sequence[str] | None = None,
    memory: str | int | None = None,
) -> tuple[FloatModel, list[str]]:
    """Return an imported network as the float model of a project, and notes for the user.

    Its features are brought to -1 .. 1 before they become int16; the network takes it back.

    Args:
        imported: from the ONNX file.
        config: the project; its outputs are the network's, in their order.
        runs: to scale the features by.
        features: names of the network's inputs in order; by default the temperature, then [inputs].
        memory: "stream", or a window's length; by default what the file implies.

    Raises:
        InputError: features or outputs do not match the network, or the memory is not possible.
    """
    names = _choose_features(imported, config, features)
    count = imported.network.head.shape[0]
    if count != len(config.outputs):
        raise InputError(
            f"{config.path}: [outputs] has {len(config.outputs)} tables"
            f" ({', '.join(o.name for o in config.outputs)}), output '{imported.output_name}' of"
            f" the network has {count} columns; expected one table per column, in their order."
        )
    window, notes = _choose_window(imported, memory)
    columns = np.concatenate([read_features(run, names) for run in runs])
    low, high = columns.min(axis=0), columns.max(axis=0)
    half = 0.5 * (high - low)
    center, scale = 0.5 * (low + high), np.where(half > 0.0, half, 1.0)
    ops = GraphOperations(config.sample_period_s)
    taps = tuple(ops.input("temperature_degC" if n == TEMPERATURE else n) for n in names)
    outputs = list_outputs(config)
    channels, sources = list_channels(taps, config, runs, outputs)
    model = FloatModel(
        name=config.sensor_name,
        sample_period_s=config.sample_period_s,
        channels=channels,
        sources=sources,
        outputs=outputs,
        features=(),
        coefficients=np.zeros((0, count)),
        offset=np.zeros(count),
        taps=taps,
        tap_mean=center,
        whitening=np.diag(1.0 / scale),
        network=imported.network.rescale_inputs(center, scale),
        window=window,
        variable_step=config.variable_step,
    )
    return model, notes


def read_features(run: Run, features: Sequence[str]) -> Array:
    """Return the network's inputs [n, I] of a run, as logged."""
    columns = [run.temperature_degC if f == TEMPERATURE else run.inputs[f] for f in features]
    return np.stack(columns, axis=1)


def _choose_features(
    imported: ImportedNetwork, config: Config, features: Sequence[str] | None
) -> tuple[str, ...]:
    known = (TEMPERATURE, *config.inputs)
    count = imported.network.inputs
    for name in features or ():
        if name not in known:
            raise InputError(
                f"--features: '{name}' is no signal of {config.path.name}{nearest(name, known)}"
                f" It has {', '.join(known)}; name its column under [inputs]."
            )
    names = tuple(features) if features else known if len(known) == count else (TEMPERATURE,)
    if len(names) != count or len(set(names)) != count:
        raise InputError(
            f"the network's input '{imported.input_name}' has {count} features, {len(names)} are"
            f" named ({', '.join(names)}); expected --features with {count} different ones of"
            f" {', '.join(known)}, in the network's order."
        )
    return names


def _choose_window(imported: ImportedNetwork, memory: str | int | None) -> tuple[int, list[str]]:
    """Return the window's length, 0 for a carried state, and what is to be noted."""
    notes = []
    window = imported.window if memory is None else 0 if memory == "stream" else int(memory)
    if not 0 <= window <= LONGEST_WINDOW:
        raise InputError(
            f"--memory: a window of {window} samples; expected 1 to {LONGEST_WINDOW}, or stream."
        )
    if memory is None and imported.initial_state != "input":
        if imported.last_only and not imported.steps:
            notes.append(
                "the file answers for the last sample of a sequence of any length; its state is"
                " carried from sample to sample. If it was trained on windows, give --memory N."
            )
        elif not imported.last_only and imported.steps:
            notes.append(
                f"the file answers for each of {imported.steps} samples; its state is carried from"
                " sample to sample beyond them. For windows give --memory N."
            )
    if imported.initial_state == "constant":
        if window:
            raise InputError(
                "the network starts each window from a state other than zero, which has no"
                " fixed-point form; expected zeros. Export it without, or give --memory stream."
            )
        notes.append(
            "the initial state in the file is not used: the firmware starts at rest (settle) or"
            " from zero (init)."
        )
    return window, notes
