"""From a network that another program trained, and logs to scale by, to the float model."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import LONGEST_WINDOW, Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.runs import Run
from zerodrift.export.channels import list_channels
from zerodrift.export.compose import list_outputs
from zerodrift.export.float_model import FloatModel
from zerodrift.export.onnx_reader import ImportedNetwork
from zerodrift.operations.backend import GraphOperations

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
