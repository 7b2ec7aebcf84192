"""Networks that are trained by epochs: a rehearsal, then the performance, of many sensors at once.

In the rehearsal some training runs are held out; it tells which start does best, after how many
epochs, and whether the network is worth its flash at all. In the performance the same training is
repeated with all runs, since a run left out is a run not learnt from.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.train.conclude import choose_length, conclude, is_worth_its_flash
from zerodrift.train.engine import Problem, Progress, Result, train_networks
from zerodrift.train.networks import Network, build_network
from zerodrift.train.scores import Stage
from zerodrift.train.sequences import Sequence32
from zerodrift.train.stages import Stages
from zerodrift.train.tasks import PERFORMANCE, REHEARSAL, UNFORESEEN, Answer, Handling, Task


def train_tasks(tasks: Sequence[Task], handling: Handling) -> list[Answer]:
    """Rehearse all networks, then train those that are worth their flash on all runs."""
    starts = max((len(task.settings.starts) for task in tasks), default=1)
    share = starts / (starts + 1)

    def tell_rehearsal(p: Progress) -> None:
        handling.report(Stage(share * p.done, f"held out {p.best_rmse:.3f}"))

    def tell_performance(p: Progress) -> None:
        done = share + (1.0 - share) * p.done
        handling.report(Stage(done, f"all runs, {p.train_rmse:.3f}"))

    def run(
        problems: Sequence[Problem], name: str, tell: Callable[[Progress], None]
    ) -> list[Result | InputError]:
        checkpoint = handling.folder / name if handling.folder else None
        return train_networks(
            problems,
            device=handling.device,
            checkpoint=checkpoint,
            resume=handling.resume,
            report=tell,
        )

    rehearsals = run([pose_rehearsal(task) for task in tasks], REHEARSAL, tell_rehearsal)
    worth = {
        i: pose_performance(tasks[i], rehearsal)
        for i, rehearsal in enumerate(rehearsals)
        if isinstance(rehearsal, Result) and is_worth_its_flash(rehearsal)
    }
    performed = dict(
        zip(worth, run(list(worth.values()), PERFORMANCE, tell_performance), strict=True)
    )
    return [
        _conclude(task, rehearsal, performed.get(i))
        for i, (task, rehearsal) in enumerate(zip(tasks, rehearsals, strict=True))
    ]


def _conclude(
    task: Task, rehearsal: Result | InputError, performed: Result | InputError | None
) -> Answer:
    """Return one sensor's compensator, or what ended its training."""
    if isinstance(rehearsal, InputError):
        return rehearsal
    if isinstance(performed, InputError):
        return performed
    try:
        return conclude(task.config, task.dataset, task.prepared, rehearsal, performed)
    except (ZerodriftError, *UNFORESEEN) as error:
        return error


def pose_rehearsal(task: Task) -> Problem:
    """Return one sensor's training with runs held out."""
    stages, split = task.prepared.rehearsed, task.prepared.split
    held_out = stages.make_sequences(split.held_out, split.skip)
    return _pose(task, stages, stages.make_sequences(split.fit), held_out)


def pose_performance(task: Task, rehearsal: Result) -> Problem:
    """Return one sensor's training with all runs, from the start that did best in the rehearsal."""
    stages = task.prepared.stages
    problem = _pose(task, stages, stages.make_sequences(task.dataset.train), ())
    epochs = choose_length(rehearsal, task.settings.epochs)
    return replace(
        problem, settings=replace(task.settings, starts=(rehearsal.start,), epochs=epochs)
    )


def _pose(
    task: Task, stages: Stages, sequences: Sequence[Sequence32], held_out: Sequence[Sequence32]
) -> Problem:
    network, width = task.config.network, stages.front_end.width

    def build(generator: torch.Generator) -> Network:
        return build_network(network, width, len(stages.scale), generator)

    return Problem(build, sequences, held_out, task.settings, stages.tared)
