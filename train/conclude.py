"""After training: whether the network is kept, and the compensator."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from zerodrift.base.config import Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.train.compensator import Compensator, TrainedAs, calibrate
from zerodrift.train.engine import Result
from zerodrift.train.networks import GruNetwork, LstmNetwork, build_network
from zerodrift.train.onnx_export import build_layers_onnx, build_lstm_onnx, build_onnx
from zerodrift.train.prepare import Prepared, walk_of
from zerodrift.train.scores import WORTH_ITS_FLASH, Trained, score
from zerodrift.train.stages import Stages


def is_worth_its_flash(validation: Result) -> bool:
    """Return whether the network helped on the runs held out."""
    return validation.rmse < WORTH_ITS_FLASH * validation.rmse_without


def choose_length(validation: Result, epochs: int) -> int:
    """Return the epochs of the final training.

    A cycle that is cut short ends at a high learning rate, so the whole cycle is used, unless the
    validation error had by then risen to that without a network; then a shorter cycle is used.
    """
    whole = validation.last_rmse < WORTH_ITS_FLASH * validation.rmse_without
    return epochs if whole else validation.epoch


def conclude(
    config: Config,
    dataset: Dataset,
    prepared: Prepared,
    validation: Result,
    result: Result | None,
) -> Trained:
    """Return the compensator and its errors once the network is trained.

    Args:
        config: the project.
        dataset: its runs.
        prepared: what was fitted before the network.
        validation: the network trained with runs held out.
        result: the network trained on all runs; None leaves it out.
    """
    alone, validated, split = prepared.alone, prepared.validated, prepared.split
    compensator = assemble(alone, prepared.stages, dataset.train, config, result)
    if result is None:
        note = (
            "the network found nothing that carries over to the runs held out "
            f"(error {validation.rmse / validation.rmse_without:.3f} of that without it), and was "
            "left out"
        )
        compensator = replace(compensator, notes=(*compensator.notes, note))
    if dataset.test:
        return Trained(compensator, score(compensator, dataset))
    kept = validation if compensator.network is not None else None
    left_out = assemble(
        replace(alone, physics=validated.physics), validated, split.fit, config, kept
    )
    return Trained(compensator, score(compensator, dataset, left_out, split))


def assemble(
    alone: Compensator,
    stages: Stages,
    runs: Sequence[Run],
    config: Config,
    result: Result | None,
) -> Compensator:
    """Return the compensator of fitted stages and a trained network, calibrated on its runs.

    Args:
        alone: the compensator of physics alone.
        stages: what was solved before the network.
        runs: what they were fitted to.
        config: the project.
        result: the trained network, or None to leave it out.
    """
    if result is None and not stages.linear.any():
        return alone
    network = None
    if result is not None:
        network = _to_onnx(config, stages, result)
    whole = replace(
        alone,
        front_end=stages.front_end,
        linear=stages.linear,
        constant=stages.constant,
        tared=stages.tared,
        network=network,
        memory=walk_of(config.network),
        trained_as=None if result is None else TrainedAs(result.start, result.epoch),
    )
    features = [stages.front_end.compute(run) for run in runs]
    predictions = [whole.predict(run) for run in runs]
    return replace(whole, calibration=calibrate(runs, features, predictions))


def _to_onnx(config: Config, stages: Stages, result: Result) -> bytes:
    """Return the ONNX file of a trained network, its head in the outputs' units."""
    network = build_network(
        config.network, stages.front_end.width, len(stages.scale), torch.Generator()
    )
    network.load_state_dict({k: torch.from_numpy(v) for k, v in result.weights.items()})
    head = network.head.detach().numpy() * stages.scale[:, None]
    bias = network.head_bias.detach().numpy() * stages.scale
    names = [output.name for output in config.outputs]
    if isinstance(network, LstmNetwork):
        return build_lstm_onnx(network.to_float(), head, bias, names)
    if not isinstance(network, GruNetwork):
        return build_layers_onnx(FloatFeedForward(network.to_dense(), head, bias), names)
    return build_onnx(network.to_float(), head, bias, names)
