"""Many sensors of one design trained at once: what `train` does for one, network steps batched."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from zerodrift.base.config import Config
from zerodrift.base.errors import ZerodriftError
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.catalogue import Catalogue
from zerodrift.train.batch import Problem, train_batch
from zerodrift.train.networks import GruNetwork, build_network
from zerodrift.train.optimise import Result
from zerodrift.train.scores import Trained
from zerodrift.train.sequences import Sequence32
from zerodrift.train.split import split_runs
from zerodrift.train.stages import Stages, fit_physics, fit_stages
from zerodrift.train.training import (
    Prepared,
    choose_length,
    conclude,
    is_worth_its_flash,
    read_settings,
    stand_alone,
    train,
)

UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What one sensor's numbers might raise that nobody thought of; the others go on."""
Failure = Exception
Answer = Trained | Failure


def is_batched(config: Config) -> bool:
    """Return whether networks of this kind are trained at once: streaming GRUs."""
    return config.network.kind == "gru" and config.network.memory == "stream"


def train_together(
    sensors: Sequence[tuple[Config, Dataset]],
    catalogue: Catalogue,
    *,
    device: str = "cpu",
    report: Callable[[float], None] = lambda _: None,
) -> list[Answer]:
    """Return what `train` returns for each sensor, or the error that it would raise.

    Args:
        sensors: configuration and runs of each; effects, network and outputs are the same for all.
        catalogue: the known effects.
        device: where networks are trained: "cpu" or "cuda".
        report: is told the share of the networks' training that is done, 0 .. 1.
    """
    answers: list[Answer | None] = [None] * len(sensors)
    prepared: dict[int, Prepared] = {}
    for i, (config, dataset) in enumerate(sensors):
        try:
            if is_batched(config):
                prepared[i] = prepare(config, dataset, catalogue)
            else:
                config.build_directory.mkdir(parents=True, exist_ok=True)
                answers[i] = train(config, dataset, catalogue=catalogue)
        except (ZerodriftError, *UNFORESEEN) as error:
            answers[i] = error
    for i, answer in _train_networks(sensors, prepared, device, report).items():
        answers[i] = answer
    return [answer for answer in answers if answer is not None]


def prepare(config: Config, dataset: Dataset, catalogue: Catalogue) -> Prepared:
    """Return what is fitted before a network is trained.

    Raises:
        InputError: an effect cannot be fitted, or a setting of the network is out of range.
    """
    physics = fit_physics(config, dataset, dataset.train, catalogue)
    build_network(config.network, 1, 1, torch.Generator())
    split = split_runs(dataset.train)
    rehearsed = fit_stages(config, fit_physics(config, dataset, split.fit, catalogue), split.fit)
    stages = fit_stages(config, physics, dataset.train)
    alone = stand_alone(config, dataset, physics, read_settings(config.network))
    return Prepared(alone, split, rehearsed, stages)


def _train_networks(
    sensors: Sequence[tuple[Config, Dataset]],
    prepared: dict[int, Prepared],
    device: str,
    report: Callable[[float], None],
) -> dict[int, Answer]:
    """Rehearse all networks, then train those that are worth their flash on all runs."""
    answers: dict[int, Answer] = {}
    rehearsals: dict[int, Result] = {}
    problems = [pose_rehearsal(sensors[i][0], p) for i, p in prepared.items()]
    found = train_batch(problems, device=device, report=lambda x: report(0.6 * x))
    for i, rehearsal in zip(prepared, found, strict=True):
        if isinstance(rehearsal, Result):
            rehearsals[i] = rehearsal
        else:
            answers[i] = rehearsal
    worth = [i for i, rehearsal in rehearsals.items() if is_worth_its_flash(rehearsal)]
    problems = []
    for i in worth:
        config, stages = sensors[i][0], prepared[i].stages
        problem = _pose(config, stages, stages.make_sequences(sensors[i][1].train), ())
        epochs = choose_length(rehearsals[i], problem.settings.epochs)
        settings = replace(problem.settings, starts=(rehearsals[i].start,), epochs=epochs)
        problems.append(replace(problem, settings=settings))
    performed: dict[int, Result] = {}
    found = train_batch(problems, device=device, report=lambda x: report(0.6 + 0.4 * x))
    for i, result in zip(worth, found, strict=True):
        if isinstance(result, Result):
            performed[i] = result
        else:
            answers[i] = result
    for i, rehearsal in rehearsals.items():
        if i in answers:
            continue
        try:
            config, dataset = sensors[i]
            answers[i] = conclude(config, dataset, prepared[i], rehearsal, performed.get(i))
        except (ZerodriftError, *UNFORESEEN) as error:
            answers[i] = error
    return answers


def pose_rehearsal(config: Config, prepared: Prepared) -> Problem:
    """Return one sensor's training with runs held out as a problem of the batch."""
    stages, split = prepared.rehearsed, prepared.split
    held_out = stages.make_sequences(split.held_out, split.skip)
    return _pose(config, stages, stages.make_sequences(split.fit), held_out)


def _pose(
    config: Config,
    stages: Stages,
    sequences: Sequence[Sequence32],
    held_out: Sequence[Sequence32],
) -> Problem:
    """Return one sensor's training as a problem of the batch."""

    def build(generator: torch.Generator) -> GruNetwork:
        network = build_network(
            config.network, stages.front_end.width, len(stages.scale), generator
        )
        assert isinstance(network, GruNetwork)
        return network

    return Problem(build, sequences, held_out, read_settings(config.network), stages.tared)
