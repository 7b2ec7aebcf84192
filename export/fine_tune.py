"""Fine-tuning of a compensator's network for 8-bit recurrent weights, in the chip's arithmetic.

A network of zerodrift's own and an imported one take the same road.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import calibrate, describe_compensator, encode_inputs
from zerodrift.export.compose_import import calibrate_imported, describe_imported
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.imported import ImportedCompensator
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import FEATURE_HEADROOM, Calibration, FloatModel, quantize
from zerodrift.export.quantize_layers import quantize_layers, quantize_state_read_out
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import INT16_MAX, IntArray, choose_exponent
from zerodrift.operations.gru import FloatGru
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from zerodrift.train.compensator import Compensator
from zerodrift.train.fine_tune import Settings, Tuned, fine_tune
from zerodrift.train.integer_network import IntegerGruNetwork, IntegerHead
from zerodrift.train.onnx_export import build_onnx
from zerodrift.train.sequences import Sequence32

FOLDER, IMPORTED = "int8", "imported.npz"
"""Of the build directory, where the fine-tuned compensator is kept; and an imported network's."""
Array = NDArray[np.float64]
Report = Callable[[float, float], None]
GRU_ARRAYS = ("w_x", "w_h", "bias")


def tune_for_int8(
    compensator: Compensator,
    config: Config,
    runs: Sequence[Run],
    report: Report = lambda done, rms: None,
) -> tuple[Compensator, Tuned | None]:
    """Return a compensator whose network answers as before once its weights have 8 bits.

    Args:
        compensator: trained in float.
        config: the project.
        runs: the training runs.
        report: is told the share that is done and the difference so far.

    Raises:
        CheckError: no safe format exists.
    """
    if not compensator.is_recurrent:
        return compensator, None
    described = describe_compensator(compensator, config, runs)
    calibration = calibrate(compensator, described, runs)
    targets = [answer(compensator, run) for run in runs]
    tuned = tune_network(described, calibration, targets, runs, report)
    network = described.network
    assert network is not None
    names = [output.name for output in config.outputs]
    content = build_onnx(tuned.layers[0], network.head, network.head_bias, names)
    return replace(compensator, network=content), tuned


def tune_imported(
    compensator: ImportedCompensator,
    config: Config,
    runs: Sequence[Run],
    report: Report = lambda done, rms: None,
) -> Tuned:
    """Return recurrent layers for an imported network whose weights will have 8 bits.

    Args:
        compensator: the network as it came.
        config: the project.
        runs: the logs that it is calibrated on.
        report: is told the share that is done and the difference so far.

    Raises:
        CheckError: no safe format exists.
    """
    described = describe_imported(compensator, config, runs)
    calibration = calibrate_imported(compensator, described, runs)
    targets = [compensator.predict(run.at_rest()) for run in runs]
    return tune_network(described, calibration, targets, runs, report)


def tune_network(
    described: FloatModel,
    calibration: Calibration,
    targets: Sequence[Array],
    runs: Sequence[Run],
    report: Report,
) -> Tuned:
    """Return recurrent layers that answer as the float network does once they have 8 bits.

    Args:
        described: the float model.
        calibration: its ranges over the runs.
        targets: [n, K] what the float network adds to the drift, run by run.
        runs: to tune on.
        report: is told the share that is done and the difference so far.

    Raises:
        CheckError: no safe format exists.
    """
    network = described.network
    assert isinstance(network, FloatNetwork)
    exponents = np.array(
        [
            min(choose_exponent(FEATURE_HEADROOM * float(x), INT16_MAX), 15)
            for x in calibration.feature_max
        ]
    )
    model = quantize(described, calibration, "int8")
    wanted = [target - network.head_bias for target in targets]
    scale = np.sqrt(np.mean(np.concatenate(wanted) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    sequences = [
        Sequence32(run.group, counts.astype(np.float32), (target / scale).astype(np.float32))
        for run, counts, target in zip(runs, compute_features(model, runs), wanted, strict=True)
    ]
    memory = described.window or "stream"
    integer = build_integer_network(network, exponents, scale)
    return fine_tune(integer, sequences, memory, Settings(), report)


def build_integer_network(
    network: FloatNetwork, exponents: IntArray, scale: Array
) -> IntegerGruNetwork:
    """Return a float network as one that trains in the chip's arithmetic.

    Args:
        network: the trained network.
        exponents: [I] f with feature = count * 2**-f.
        scale: [K] by which its answers are divided.
    """
    read_out = quantize_state_read_out(network)
    return IntegerGruNetwork(
        network.layers,
        lambda layers: quantize_layers(layers, exponents, "int8"),
        2.0 ** -exponents.astype(np.float64),
        IntegerHead(read_out.head.weights, read_out.head_exponents),
        scale,
        read_out.dense,
    )


def answer(compensator: Compensator, run: Run) -> Array:
    """Return what the float network alone adds to the drift [n, K] of a stretch from rest."""
    run = run.at_rest()
    return compensator.predict(run) - replace(compensator, network=None).predict(run)


def compute_features(model: IntegerModel, runs: Sequence[Run]) -> list[IntArray]:
    """Return the network's features [n, I] of each run, as counts of the chip."""
    codes = [encode_inputs(model, run) for run in runs]
    longest = max(len(c) for c in codes)
    together = np.stack([np.pad(c, ((0, longest - len(c)), (0, 0)), "edge") for c in codes])
    steps: list[IntArray] = []
    Reference(model).run(together, observe=lambda _, values: steps.append(values["features"]))
    features = np.stack(steps, axis=1)
    return [features[i, : len(c)] for i, c in enumerate(codes)]


def load_or_tune(
    compensator: Compensator,
    config: Config,
    runs: Sequence[Run],
    progress: Callable[[str], None] = lambda _: None,
) -> Compensator:
    """Return the compensator fine-tuned for the project's weights, from build/ if it is there.

    With 16-bit weights that is the compensator itself.

    Args:
        compensator: trained in float.
        config: the project.
        runs: the training runs.
        progress: is told what is being done.
    """
    if config.weights != "int8" or not compensator.is_recurrent:
        return compensator
    folder = config.build_directory / FOLDER
    mark = _mark(compensator)
    try:
        kept = Compensator.load(folder, load_catalogue(config.plugin_files))
        if kept.trained_from == mark:
            return kept
    except InputError:
        pass  # missing or outdated: tuned below, which replaces it

    tuned, _ = tune_for_int8(compensator, config, runs, tell(progress))
    tuned = replace(tuned, trained_from=mark)
    tuned.save(config.directory, folder)
    return tuned


def load_or_tune_imported(
    compensator: ImportedCompensator,
    config: Config,
    runs: Sequence[Run],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[FloatGru, ...] | None:
    """Return the layers of an imported network for 8-bit weights, from build/ if they are there.

    With 16-bit weights that is None: the network is taken as it came.
    """
    if config.weights != "int8":
        return None
    path = config.build_directory / FOLDER / IMPORTED
    described = describe_imported(compensator, config, runs)
    network = described.network
    assert isinstance(network, FloatNetwork)
    digest = hashlib.sha256(f"{Settings()} {FEATURE_HEADROOM} {described.window}".encode())
    arrays: list[NDArray[Any]] = [a for g in network.layers for a in (g.w_x, g.w_h, g.bias)]
    arrays += [a for d in network.dense for a in (d.weight, d.bias)]
    arrays += [network.head, network.head_bias, compensator.front_end.center]
    arrays += [compensator.front_end.scale, *(encode_inputs(described, run) for run in runs)]
    for array in arrays:
        digest.update(f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    resets = [layer.reset for layer in network.layers]
    mark = digest.hexdigest() + "".join(resets)
    try:
        kept = load_checkpoint(path)
    except InputError:
        kept = None  # damaged: tuned below, which replaces it
    if kept is not None and kept.values.get("mark") == mark:
        stored = [[kept.arrays[f"{n}_{i}"] for n in GRU_ARRAYS] for i in range(len(resets))]
        return tuple(
            FloatGru(w_x, w_h, bias, reset)
            for (w_x, w_h, bias), reset in zip(stored, resets, strict=True)
        )
    layers = tune_imported(compensator, config, runs, tell(progress)).layers
    content = {
        f"{name}_{i}": getattr(gru, name) for i, gru in enumerate(layers) for name in GRU_ARRAYS
    }
    save_checkpoint(path, Checkpoint(content, {"mark": mark}))
    return layers


def tell(progress: Callable[[str], None]) -> Report:
    """Return a report that puts the progress into words."""

    def report(done: float, rms: float) -> None:
        progress(f"fine-tuning 8-bit weights, {100 * done:.0f} %: {100 * rms:.2g} % off the float")

    return report


def _mark(compensator: Compensator) -> str:
    """Return a mark of everything that a fine-tuning depends on."""
    digest = hashlib.sha256(f"{compensator.trained_from} {Settings()} {FEATURE_HEADROOM}".encode())
    digest.update(compensator.network or b"")
    return digest.hexdigest()
