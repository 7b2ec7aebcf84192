"""Fine-tuning of a compensator's network for 8-bit recurrent weights, in the chip's arithmetic."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.config import Config
from zerodrift.dataset.runs import Run
from zerodrift.errors import InputError
from zerodrift.export.compose import calibrate, describe_compensator, encode_inputs
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.onnx_reader import FloatNetwork
from zerodrift.export.quantize import FEATURE_HEADROOM, quantize
from zerodrift.export.quantize_gru import quantize_gru, quantize_head
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import INT16_MAX, IntArray, choose_exponent
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.train.fine_tune import Settings, Tuned, fine_tune
from zerodrift.train.integer_network import IntegerGruNetwork, IntegerHead
from zerodrift.train.onnx_export import build_onnx
from zerodrift.train.sequences import Sequence32

FOLDER = "int8"
"""Of the build directory, where the fine-tuned compensator is kept."""
Array = NDArray[np.float64]


def tune_for_int8(
    compensator: Compensator,
    config: Config,
    runs: Sequence[Run],
    report: Callable[[float, float], None] = lambda done, rms: None,
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
    if compensator.network is None:
        return compensator, None
    described = describe_compensator(compensator, config, runs)
    assert described.network is not None
    calibration = calibrate(compensator, described, runs)
    model = quantize(described, calibration, "int8")
    exponents = np.array(
        [
            min(choose_exponent(FEATURE_HEADROOM * float(x), INT16_MAX), 15)
            for x in calibration.feature_max
        ]
    )
    targets = [answer(compensator, run) - described.network.head_bias for run in runs]
    scale = np.sqrt(np.mean(np.concatenate(targets) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    sequences = [
        Sequence32(run.group, counts.astype(np.float32), (target / scale).astype(np.float32))
        for run, counts, target in zip(runs, compute_features(model, runs), targets, strict=True)
    ]
    network = build_integer_network(described.network, exponents, scale)
    tuned = fine_tune(network, sequences, compensator.memory, Settings(), report)
    names = [output.name for output in config.outputs]
    content = build_onnx(tuned.gru, described.network.head, described.network.head_bias, names)
    return replace(compensator, network=content), tuned


def build_integer_network(
    network: FloatNetwork, exponents: IntArray, scale: Array
) -> IntegerGruNetwork:
    """Return a float network as one that trains in the chip's arithmetic.

    Args:
        network: the trained network.
        exponents: [I] f with feature = count * 2**-f.
        scale: [K] by which its answers are divided.
    """
    return IntegerGruNetwork(
        network.gru,
        lambda gru: quantize_gru(gru, exponents, "int8"),
        2.0 ** -exponents.astype(np.float64),
        IntegerHead(*quantize_head(network.head)),
        scale,
    )


def answer(compensator: Compensator, run: Run) -> Array:
    """Return what the float network alone adds to a run's drift [n, K]."""
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
    if config.weights != "int8" or compensator.network is None:
        return compensator
    folder = config.build_directory / FOLDER
    mark = _mark(compensator)
    try:
        kept = Compensator.load(folder, load_catalogue(config.plugin_files))
        if kept.trained_from == mark:
            return kept
    except InputError:
        pass  # missing or outdated: tuned below, which replaces it

    def report(done: float, rms: float) -> None:
        progress(f"fine-tuning 8-bit weights, {100 * done:.0f} %: {100 * rms:.2g} % off the float")

    tuned, _ = tune_for_int8(compensator, config, runs, report)
    tuned = replace(tuned, trained_from=mark)
    folder.mkdir(parents=True, exist_ok=True)
    tuned.save(folder)
    return tuned


def _mark(compensator: Compensator) -> str:
    """Return a mark of everything that a fine-tuning depends on."""
    digest = hashlib.sha256(f"{compensator.trained_from} {Settings()} {FEATURE_HEADROOM}".encode())
    digest.update(compensator.network or b"")
    return digest.hexdigest()
