"""From a network that another program trained, and logs to calibrate on, to the integer model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import LONGEST_WINDOW, Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.chip_codes import FLAG_MARGIN_K, RANGE_MARGIN
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.export.compose import (
    choose_lsb_per_unit,
    encode_inputs,
    find_flagged,
    finish_model,
    limit_rate,
    list_channels,
    measure_warm_up,
    refuse_logs_outside,
    widen,
)
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.imported import TEMPERATURE, ImportedCompensator, Scaling, read_features
from zerodrift.export.integer_model import IntegerModel, OutputFormat
from zerodrift.export.onnx_reader import ImportedNetwork
from zerodrift.export.quantize import Calibration, FloatModel, quantize
from zerodrift.operations.graph import GraphOperations
from zerodrift.operations.gru import FloatGru

Array = NDArray[np.float64]


def import_compensator(
    imported: ImportedNetwork,
    config: Config,
    runs: Sequence[Run],
    features: Sequence[str] | None = None,
    memory: str | int | None = None,
) -> tuple[ImportedCompensator, list[str]]:
    """Return an imported network as the compensator of a project, and what is to be noted.

    Args:
        imported: from the ONNX file.
        config: the project; its outputs are the network's, in their order.
        runs: to scale the features by.
        features: names of the network's inputs in order; by default the temperature, then [inputs].
        memory: "stream", or a window's length; by default what the file implies.

    Raises:
        InputError: features or outputs do not match the network, or the memory cannot be.
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
    scaling = Scaling(names, 0.5 * (low + high), np.where(half > 0.0, half, 1.0))
    return ImportedCompensator(imported.network, window, scaling), notes


def _choose_features(
    imported: ImportedNetwork, config: Config, features: Sequence[str] | None
) -> tuple[str, ...]:
    known = (TEMPERATURE, *config.inputs)
    count = imported.network.gru.w_x.shape[2]
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


def compose_imported_model(
    compensator: ImportedCompensator,
    config: Config,
    dataset: Dataset,
    layers: Sequence[FloatGru] | None = None,
) -> IntegerModel:
    """Return the quantized network, with its warm-up time measured on the calibration logs.

    Args:
        compensator: the network as it came; sets the ranges.
        config: the project.
        dataset: its logs.
        layers: fine-tuned recurrent layers, on the features of `describe_imported`; None for its
            own.

    Raises:
        CheckError: no safe format exists.
        InputError: a log leaves what the codes can say.
    """
    model = describe_imported(compensator, config, dataset.train)
    refuse_logs_outside(config, model, dataset)
    calibration = calibrate_imported(compensator, model, dataset.train)
    if layers is not None and isinstance(model.network, FloatNetwork):
        model = replace(model, network=model.network.with_layers(layers))
    cold = quantize(model, calibration, config.weights)
    steps = measure_warm_up(cold, dataset.train)
    return finish_model(cold, config, steps)


def describe_imported(
    compensator: ImportedCompensator, config: Config, runs: Sequence[Run]
) -> FloatModel:
    """Return the imported network as a float model with raw input channels."""
    scaling = compensator.front_end
    ops = GraphOperations(config.sample_period_s)
    names = ["temperature_degC" if name == TEMPERATURE else name for name in scaling.features]
    taps = tuple(ops.input(name) for name in names)
    count = len(config.outputs)
    outputs = tuple(
        OutputFormat(o.name, o.unit, choose_lsb_per_unit(o.full_scale), o.full_scale)
        for o in config.outputs
    )
    channels, sources = list_channels(taps, config, runs, outputs)
    return FloatModel(
        name=config.sensor_name,
        sample_period_s=config.sample_period_s,
        channels=channels,
        sources=sources,
        outputs=outputs,
        features=(),
        coefficients=np.zeros((0, count)),
        offset=np.zeros(count),
        taps=taps,
        tap_mean=scaling.center,
        whitening=np.diag(1.0 / scaling.scale),
        network=compensator.network.rescale_inputs(scaling.center, scaling.scale),
        window=compensator.window,
    )


def calibrate_imported(
    compensator: ImportedCompensator, model: FloatModel, runs: Sequence[Run]
) -> Calibration:
    """Return the ranges that the calibration runs showed, with their margins."""
    codes = np.concatenate([encode_inputs(model, run).astype(np.int64) for run in runs])
    limits, ranges = [], []
    for index, (column, channel) in enumerate(zip(codes.T, model.channels, strict=True)):
        low, high = int(column.min()), int(column.max())
        if index:
            ranges.append((index, *find_flagged(channel, [column], RANGE_MARGIN)))
        limits.append(widen(low, high, RANGE_MARGIN * (high - low) + 1, channel.bits))
    steps = [np.abs(np.diff(encode_inputs(model, run)[:, 0].astype(np.int64))) for run in runs]
    rate = max(int(step.max(initial=0)) for step in steps)
    features = np.concatenate([compensator.front_end.compute(run) for run in runs])
    drifts = np.concatenate([compensator.predict(run) for run in runs] + [r.drift for r in runs])
    low_drift, high_drift = drifts.min(axis=0), drifts.max(axis=0)
    margin = RANGE_MARGIN * (high_drift - low_drift)
    low, high = int(codes[:, 0].min()), int(codes[:, 0].max())
    return Calibration(
        code_limits=tuple(limits),
        feature_max=np.abs(features).max(axis=0),
        drift_low=low_drift - margin,
        drift_high=high_drift + margin,
        rate_max=limit_rate(model.channels[0], rate),
        warm_up_steps=0,
        input_ranges=tuple(ranges),
        temperature_range=widen(
            low, high, FLAG_MARGIN_K / model.channels[0].lsb, model.channels[0].bits
        ),
    )
