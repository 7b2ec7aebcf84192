"""From zerodrift.toml and its logs to a trained compensator: a rehearsal, then the performance.

In the rehearsal some training runs are held out; it tells which start does best, after how many
epochs, and whether the network is worth its flash at all. In the performance the same training is
repeated with all runs, since a run left out is a run not learnt from. Many sensors of one design
take the same way at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.dataset.chip_codes import refuse_unsayable
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.train.bank_training import train_bank
from zerodrift.train.conclude import choose_length, conclude, is_worth_its_flash
from zerodrift.train.engine import Problem, Progress, Result, train_networks
from zerodrift.train.networks import Network, build_network
from zerodrift.train.optimise import Settings
from zerodrift.train.prepare import Prepared, prepare, read_settings, stand_alone
from zerodrift.train.scores import Stage, Trained, score
from zerodrift.train.sequences import Sequence32
from zerodrift.train.stages import Stages, fit_physics

REHEARSAL, PERFORMANCE = "rehearsal.npz", "performance.npz"
UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What one sensor's numbers might raise that nobody thought of; the others go on."""
Answer = Trained | Exception
Report = Callable[[Stage], None]


def list_checkpoints(config: Config) -> tuple[Path, ...]:
    """Return where trainings keep their state, which is removed with the result's arrival."""
    return tuple(config.build_directory / name for name in (REHEARSAL, PERFORMANCE))


@dataclass(frozen=True)
class Task:
    """One sensor whose network is to be trained."""

    config: Config
    dataset: Dataset
    settings: Settings
    prepared: Prepared


@dataclass(frozen=True)
class Handling:
    """What the training of networks is told beside the tasks."""

    device: str = "cpu"
    """"cpu" or "cuda"."""
    folder: Path | None = None
    """Where checkpoints are kept; None = nowhere."""
    resume: bool = True
    """Take up an interrupted training of these very inputs."""
    report: Report = lambda _: None
    """Called after each epoch."""


def train(
    config: Config,
    dataset: Dataset,
    *,
    epochs: int | None = None,
    starts: int | None = None,
    resume: bool = True,
    report: Report | None = None,
    catalogue: Catalogue | None = None,
) -> Trained:
    """Fit physics, then train the network on what it leaves; checkpoints go to build/.

    Args:
        config: the project.
        dataset: its runs.
        epochs: overrides `[network] epochs`.
        starts: overrides `[network] starts`.
        resume: take up an interrupted training of these very inputs.
        report: called after each epoch.
        catalogue: the known effects; by default the built-ins and the project's own.

    Raises:
        InputError: an effect cannot be fitted, a setting of the network is out of range, or a log
            leaves what the chip's codes can say.
    """
    catalogue = catalogue or load_catalogue(config.plugin_files)
    settings = read_settings(config.network, epochs, starts)
    handling = Handling(folder=config.build_directory, resume=resume)
    if report is not None:
        handling = replace(handling, report=report)
    begun = _begin(config, dataset, settings, catalogue, handling.report)
    if isinstance(begun, Trained):
        return begun
    (answer,) = _train_tasks([begun], handling)
    if isinstance(answer, Exception):
        raise answer
    return answer


def train_together(
    sensors: Sequence[tuple[Config, Dataset]], catalogue: Catalogue, *, device: str = "cpu"
) -> list[Answer]:
    """Return what `train` returns for each sensor, or the error that it would raise.

    Args:
        sensors: configuration and runs of each; effects, network and outputs are the same for all.
        catalogue: the known effects.
        device: where networks are trained: "cpu" or "cuda".
    """
    answers: dict[int, Answer] = {}
    tasks: dict[int, Task] = {}
    for i, (config, dataset) in enumerate(sensors):
        try:
            settings = read_settings(config.network)
            begun = _begin(config, dataset, settings, catalogue, lambda _: None)
        except (ZerodriftError, *UNFORESEEN) as error:
            answers[i] = error
            continue
        if isinstance(begun, Task):
            tasks[i] = begun
        else:
            answers[i] = begun
    found = _train_tasks(list(tasks.values()), Handling(device=device))
    answers |= dict(zip(tasks, found, strict=True))
    return [answers[i] for i in range(len(sensors))]


def _begin(
    config: Config, dataset: Dataset, settings: Settings, catalogue: Catalogue, report: Report
) -> Trained | Task:
    """Return the result where no network is trained by epochs, else what is to be trained."""
    refuse_unsayable(config, dataset)
    if config.network.kind not in ("none", "lag_bank"):
        return Task(config, dataset, settings, prepare(config, dataset, settings, catalogue))
    physics = fit_physics(config, dataset, dataset.train, catalogue)
    alone = stand_alone(config, dataset, physics, settings)
    if config.network.kind == "none":
        return Trained(alone, score(alone, dataset))
    return train_bank(alone, config, dataset, catalogue, report)


def _train_tasks(tasks: Sequence[Task], handling: Handling) -> list[Answer]:
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
