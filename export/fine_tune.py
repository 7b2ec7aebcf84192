"""Fine-tuning of a compensator's network for 8-bit recurrent weights, in the chip's arithmetic.

zerodrift's own networks and imported ones are treated alike.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.extras import TRAIN, require
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import calibrate, encode_inputs
from zerodrift.export.float_model import FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import (
    FEATURE_HEADROOM,
    Quantized,
    choose_feature_exponents,
    quantize_graph,
)
from zerodrift.export.quantize_layers import quantize_grus
from zerodrift.export.reference import Reference
from zerodrift.operations.dense import FloatDense, IntegerDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.head import IntegerHead
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from zerodrift.train.onnx_export import OnnxNetwork, build_onnx
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Tuning

if TYPE_CHECKING:  # PyTorch is loaded where something is tuned
    from zerodrift.train.integer_network import IntegerGruNetwork, Tuned

FOLDER, LAYERS = "int8", "layers.npz"
"""Of the build directory, where the fine-tuned layers are kept."""
Report = Callable[[float, float], None]
GRU_ARRAYS = ("w_x", "w_h", "bias")


def tune_for_int8(
    model: FloatModel, runs: Sequence[Run], report: Report = lambda done, rms: None
) -> tuple[FloatModel, "Tuned"]:
    """Return the float model with layers that keep their answers after rounding to 8 bits.

    Args:
        model: the float model; its network is recurrent.
        runs: the training runs, or those that an imported network is calibrated on.
        report: called with the share that is done and the difference so far.

    Raises:
        CheckError: no safe format exists.
        InputError: PyTorch is not installed.
    """
    require(TRAIN, '[quantization] weights = "int8"')
    from zerodrift.train.integer_network import fine_tune

    network = model.network
    assert network is not None
    calibration = calibrate(model, runs)
    targets = [model.predict_network(run) for run in runs]
    rounded = quantize_graph(model, calibration, "int8")
    wanted = [target - network.head_bias for target in targets]
    scale = np.sqrt(np.mean(np.concatenate(wanted) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    sequences = [
        Sequence32(run.group, counts.astype(np.float32), (target / scale).astype(np.float32))
        for run, counts, target in zip(
            runs, compute_features(rounded.model, runs), wanted, strict=True
        )
    ]
    memory = model.window or "stream"
    exponents = choose_feature_exponents(calibration)
    integer = build_integer_network(network, rounded, exponents, scale)
    tuned = fine_tune(integer, sequences, memory, Tuning(), report)
    return replace_layers(model, tuned.layers), tuned


def replace_layers(model: FloatModel, layers: Sequence[FloatGru]) -> FloatModel:
    """Return the float model with other recurrent layers."""
    network = model.network
    assert network is not None
    other = network.replace_grus(layers)
    if network.trained is not None:
        names = [output.name for output in model.outputs]
        content = build_onnx(layers[0], network.head, network.head_bias, names)
        other = replace(other, trained=OnnxNetwork(content))
    return replace(model, network=other)


def build_integer_network(
    network: FloatNetwork, rounded: Quantized, exponents: IntArray, scale: Array
) -> "IntegerGruNetwork":
    """Return a float network as one that trains in the chip's arithmetic.

    Args:
        network: the trained network.
        rounded: its integer model, whose dense layers and head are held.
        exponents: [I] f with feature = count * 2**-f.
        scale: [K] by which its answers are divided.
    """
    from zerodrift.train.integer_network import IntegerGruNetwork, TorchIntegerHead

    assert rounded.scales is not None
    (head,) = (node for node in rounded.model.nodes if isinstance(node, IntegerHead))
    return IntegerGruNetwork(
        network.grus,
        lambda grus: quantize_grus(grus, exponents, "int8"),
        2.0 ** -exponents.astype(np.float64),
        TorchIntegerHead(head.weights, rounded.scales.head),
        scale,
        [node for node in rounded.model.nodes if isinstance(node, IntegerDense)],
    )


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
    model: FloatModel,
    config: Config,
    runs: Sequence[Run],
    progress: Callable[[str], None] = lambda _: None,
) -> FloatModel:
    """Return the float model fine-tuned for the project's weights, from build/ if it is there.

    With 16-bit weights, or without a recurrent network, that is the model itself.

    Args:
        model: the float model.
        config: the project.
        runs: the training runs.
        progress: called with a description of each stage of the work.
    """
    network = model.network
    if config.weights != "int8" or network is None or not network.grus:
        return model
    path = config.build_directory / FOLDER / LAYERS
    mark = _mark(model, network, runs)
    resets = [gru.reset for gru in network.grus]
    try:
        kept = load_checkpoint(path)
    except InputError:
        kept = None  # damaged: tuned below, which replaces it
    if kept is not None and kept.values.get("mark") == mark:
        stored = [
            [kept.arrays[f"{n}_{i}"].astype(np.float64, copy=False) for n in GRU_ARRAYS]
            for i in range(len(resets))
        ]
        layers = [
            FloatGru(w_x, w_h, bias, reset)
            for (w_x, w_h, bias), reset in zip(stored, resets, strict=True)
        ]
        return replace_layers(model, layers)
    tuned, found = tune_for_int8(model, runs, tell(progress))
    content = {
        f"{name}_{i}": getattr(gru, name)
        for i, gru in enumerate(found.layers)
        for name in GRU_ARRAYS
    }
    save_checkpoint(path, Checkpoint(content, {"mark": mark}))
    return tuned


def tell(progress: Callable[[str], None]) -> Report:
    """Return a report that puts the progress into words."""

    def report(done: float, rms: float) -> None:
        progress(f"fine-tuning 8-bit weights, {100 * done:.0f} %: {100 * rms:.2g} % off the float")

    return report


def _mark(model: FloatModel, network: FloatNetwork, runs: Sequence[Run]) -> str:
    """Return a mark of everything that a fine-tuning depends on."""
    assert model.tap_mean is not None and model.whitening is not None
    recipe = ", ".join(f"{name}={value!r}" for name, value in asdict(Tuning()).items())
    digest = hashlib.sha256(f"Settings({recipe}) {FEATURE_HEADROOM} {model.window}".encode())
    digest.update(f"{model.taps} {[gru.reset for gru in network.grus]}".encode())
    arrays: list[NDArray[np.generic]] = [a for g in network.grus for a in (g.w_x, g.w_h, g.bias)]
    dense = (n.cell for n in network.layers if isinstance(n.cell, FloatDense))
    arrays += [a for d in dense for a in (d.weight, d.bias)]
    arrays += [network.head, network.head_bias, model.tap_mean, model.whitening]
    arrays += [encode_inputs(model, run) for run in runs]
    for array in arrays:
        digest.update(f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
