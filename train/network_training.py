"""Networks that are trained by epochs, of many sensors at once: a validation, then all runs.

In the validation training some runs are held out; it shows which start is best, after how many
epochs, and whether the network is worth its flash at all. The final training repeats it with all
runs, since a run left out is a run not learnt from.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from zerodrift.base.config import Config, NetworkConfig
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import Stage
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.train.attempts import Problem
from zerodrift.train.compensator import Compensator, TrainedAs, calibrate
from zerodrift.train.engine import EpochProgress, Result, train_networks
from zerodrift.train.networks import GruNetwork, LstmNetwork, Network, build_network
from zerodrift.train.onnx_export import build_layers_onnx, build_lstm_onnx, build_onnx
from zerodrift.train.prepare import (
    FINAL,
    FREE,
    UNFORESEEN,
    VALIDATION,
    Answer,
    Handling,
    Prepared,
    Task,
    walk_of,
)
from zerodrift.train.scores import WORTH_ITS_FLASH, ContractingCost, Trained, score
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings
from zerodrift.train.stages import Stages

# After training: whether the network is kept, and the compensator.


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


TrainAll = Callable[
    [Sequence[Problem], str, Callable[[EpochProgress], None]], list[Result | InputError]
]
"""Trains problems with a checkpoint of some name."""


# Networks that are trained by epochs, of many sensors at once: a validation, then all runs.


def train_tasks(tasks: Sequence[Task], handling: Handling) -> list[Answer]:
    """Train all networks with runs held out, then those that are worth their flash on all runs."""
    starts = max((len(task.settings.starts) for task in tasks), default=1)
    share = starts / (starts + 1)

    def tell_validation(p: EpochProgress) -> None:
        handling.report(Stage(share * p.done, f"held out {p.best_rmse:.3f}"))

    def tell_final(p: EpochProgress) -> None:
        done = share + (1.0 - share) * p.done
        handling.report(Stage(done, f"all runs, {p.train_rmse:.3f}"))

    def run(
        problems: Sequence[Problem], name: str, tell: Callable[[EpochProgress], None]
    ) -> list[Result | InputError]:
        checkpoint = handling.folder / name if handling.folder else None
        return train_networks(
            problems,
            device=handling.device,
            checkpoint=checkpoint,
            resume=handling.resume,
            report=tell,
        )

    validations = run([pose_validation(task) for task in tasks], VALIDATION, tell_validation)
    costs = _measure_costs(tasks, validations, run)
    worth = {
        i: pose_final(tasks[i], validation)
        for i, validation in enumerate(validations)
        if isinstance(validation, Result) and is_worth_its_flash(validation)
    }
    final = dict(zip(worth, run(list(worth.values()), FINAL, tell_final), strict=True))
    return [
        _conclude(task, validation, final.get(i), costs.get(i))
        for i, (task, validation) in enumerate(zip(tasks, validations, strict=True))
    ]


def _measure_costs(
    tasks: Sequence[Task], validations: Sequence[Result | InputError], run: TrainAll
) -> dict[int, ContractingCost]:
    """Return what `[network] contracting` costs by the task's number, where it is asked for."""
    asked = [i for i, task in enumerate(tasks) if task.config.network.options.get("contracting")]
    if not asked:
        return {}
    free = run([pose_validation(_free(tasks[i])) for i in asked], FREE, lambda _: None)
    costs = {}
    for i, other in zip(asked, free, strict=True):
        own = validations[i]
        if isinstance(own, Result) and isinstance(other, Result):
            left_out = bool(tasks[i].prepared.split.held_out)
            ratio = own.rmse / max(other.rmse, 1e-300)
            costs[i] = ContractingCost(own.rmse, other.rmse, ratio, left_out)
    return costs


def _free(task: Task) -> Task:
    """Return the training of the same network without the constraint."""
    network = task.config.network
    options = {name: value for name, value in network.options.items() if name != "contracting"}
    config = replace(task.config, network=replace(network, options=options))
    return replace(task, config=config)


def _conclude(
    task: Task,
    validation: Result | InputError,
    final: Result | InputError | None,
    cost: ContractingCost | None,
) -> Answer:
    """Return one sensor's compensator, or what ended its training."""
    if isinstance(validation, InputError):
        return validation
    if isinstance(final, InputError):
        return final
    try:
        trained = conclude(task.config, task.dataset, task.prepared, validation, final)
    except (ZerodriftError, *UNFORESEEN) as error:
        return error
    if cost is None:
        return trained
    notes = (*trained.compensator.notes, str(cost))
    compensator = replace(trained.compensator, notes=notes)
    return replace(trained, compensator=compensator, contracting=cost)


def pose_validation(task: Task) -> Problem:
    """Return one sensor's training with runs held out."""
    stages, split = task.prepared.validated, task.prepared.split
    held_out = stages.make_sequences(split.held_out, split.skip)
    return _pose(task, stages, stages.make_sequences(split.fit), held_out)


def pose_final(task: Task, validation: Result) -> Problem:
    """Return one sensor's training with all runs, from the start that did best."""
    stages = task.prepared.stages
    problem = _pose(task, stages, stages.make_sequences(task.dataset.train), ())
    epochs = choose_length(validation, task.settings.epochs)
    return replace(
        problem, settings=replace(task.settings, starts=(validation.start,), epochs=epochs)
    )


def _pose(
    task: Task, stages: Stages, sequences: Sequence[Sequence32], held_out: Sequence[Sequence32]
) -> Problem:
    return replace(pose(task.config.network, task.settings, stages, sequences), held_out=held_out)


def pose(
    network: NetworkConfig, settings: Settings, stages: Stages, sequences: Sequence[Sequence32]
) -> Problem:
    """Return the training of a network on what was solved before it, nothing held out.

    Args:
        network: `[network]`.
        settings: starts, epochs and rates.
        stages: fitted to the same runs.
        sequences: the runs as the stages show them to it.
    """
    width = stages.front_end.width

    def build(generator: torch.Generator) -> Network:
        return build_network(network, width, len(stages.scale), generator)

    return Problem(build, sequences, (), settings, stages.tared)
