"""Networks that are trained by epochs, of many sensors at once: a validation, then all runs.

In the validation training some runs are held out; it shows which start is best, after how many
epochs, and whether the network is worth its flash at all. The final training repeats it with all
runs, since a run left out is a run not learnt from.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from zerodrift.base.config import NetworkConfig
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import Stage
from zerodrift.train.conclude import choose_length, conclude, is_worth_its_flash
from zerodrift.train.engine import EpochProgress, Problem, Result, train_networks
from zerodrift.train.networks import Network, build_network
from zerodrift.train.scores import ContractingCost
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings
from zerodrift.train.stages import Stages
from zerodrift.train.tasks import FINAL, FREE, UNFORESEEN, VALIDATION, Answer, Handling, Task

Run = Callable[[Sequence[Problem], str, Callable[[EpochProgress], None]], list[Result | InputError]]
"""Trains problems with a checkpoint of some name."""


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
    tasks: Sequence[Task], validations: Sequence[Result | InputError], run: Run
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
