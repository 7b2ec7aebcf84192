"""Trains any number of networks at once; one sensor is a batch of one.

Each network has weights, chunks, order and learning rate of its own, and makes the same steps as it
would alone; training together changes the order of sums, so that results differ by rounding. The
same call gives the same weights to the bit on one machine, also where it was interrupted and taken
up again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from zerodrift.base.errors import InputError
from zerodrift.train.attempts import (
    Attempt,
    Problem,
    Standing,
    load_standings,
    mark_problems,
    save_standings,
)
from zerodrift.train.epochs import Training
from zerodrift.train.sequences import Array32

# Training problems, the starts of each, and a start's state in a checkpoint.


# What a checkpoint of a training holds: where each attempt stands, and a mark of the inputs.


__all__ = ["EpochProgress", "Problem", "Result", "train_networks"]

AT_ONCE = 256
"""Networks that walk through the epochs together on the CPU."""
SAMPLES_AT_ONCE = 4_000_000
"""Samples of all networks that walk together, each run counted as long as the longest: they take
some 150 bytes each."""
BLOCK = 32
"""Networks in one pass forward and back on the CPU: more of them do not stay in its cache."""


@dataclass(frozen=True)
class EpochProgress:
    """The progress of a training after an epoch, for a progress bar."""

    done: float
    """Share of all epochs of all networks, 0 .. 1."""
    train_rmse: float
    """Of this epoch, averaged over the networks in step, in multiples of what physics leaves."""
    best_rmse: float
    """On the held-out runs (without any: in training), best so far of any network."""


@dataclass(frozen=True)
class Result:
    """The network that did best on the held-out runs."""

    weights: Mapping[str, Array32]
    start: int
    epoch: int
    """0 means that no epoch did better than physics alone."""
    rmse: float
    """On the held-out runs (without any: in training), in multiples of what physics leaves."""
    last_rmse: float
    """The same at the end of the cycle."""
    rmse_without: float
    """The same with the network silent."""


def train_networks(
    problems: Sequence[Problem],
    *,
    device: str = "cpu",
    checkpoint: Path | None = None,
    resume: bool = True,
    report: Callable[[EpochProgress], None] = lambda _: None,
) -> list[Result | InputError]:
    """Return for each problem its best start, or why its training diverged.

    Args:
        problems: of one kind of network; the numbers of features, runs and samples differ as they
            like.
        device: where the tensors are: "cpu" or "cuda".
        checkpoint: file to keep the state in, as often as the networks are judged.
        resume: take up the checkpoint, if there is one of these very inputs.
        report: called after each epoch.
    """
    torch.set_num_threads(1)  # with two, steps this small take far longer
    attempts = _list_attempts(problems)
    mark = mark_problems(problems) if checkpoint else ""
    stood = load_standings(checkpoint, mark, attempts) if checkpoint and resume else {}
    for number, standing in stood.items():
        if standing.epoch == attempts[number].epochs:
            attempts[number].take_up(standing)
    largest = max((len(p.sequences) * max(map(len, p.sequences)) for p in problems), default=1)
    room = max(1, SAMPLES_AT_ONCE // largest)
    at_once = min(AT_ONCE, room) if device == "cpu" else room
    total = sum(a.epochs for a in attempts)
    for part in _arrange(problems, attempts, at_once):
        going = [a for a in part if a.is_active]
        if not going:
            continue
        training = Training(problems, going, device, BLOCK if device == "cpu" else len(going))
        for i, a in enumerate(going):
            if a.number in stood:
                training.restore(i, stood[a.number])

        def follow(train_rmse: float, judged: bool, training: Training = training) -> None:
            if checkpoint and judged:
                save_standings(checkpoint, mark, _list_standings(attempts, training))
            done = sum(a.epoch if a.error is None else a.epochs for a in attempts) / total
            report(EpochProgress(done, train_rmse, min(a.best_rmse for a in attempts)))

        training.run(follow)
    return [_choose(attempts, index) for index in range(len(problems))]


def _list_attempts(problems: Sequence[Problem]) -> list[Attempt]:
    """Return the starts of all problems."""
    pairs = [(index, start) for index, p in enumerate(problems) for start in p.settings.starts]
    return [
        Attempt(
            number, index, start, problems[index].settings.epochs, problems[index].count_batches()
        )
        for number, (index, start) in enumerate(pairs)
    ]


def _list_standings(attempts: Sequence[Attempt], training: Training) -> dict[int, Standing]:
    """Return where every attempt stands that is complete or on its way."""
    found = {a.number: a.stand({}) for a in attempts if a.epoch == a.epochs}
    going = enumerate(training.attempts)
    return found | {a.number: training.export(i) for i, a in going if a.error is None}


def _arrange(
    problems: Sequence[Problem], attempts: Sequence[Attempt], at_once: int
) -> list[list[Attempt]]:
    """Return the attempts in parts that are trained in step: those that are judged alike."""
    alike: dict[tuple[bool, bool], list[Attempt]] = {}
    for attempt in attempts:
        problem = problems[attempt.problem]
        alike.setdefault((problem.tared, bool(problem.held_out)), []).append(attempt)
    parts = []
    for found in alike.values():
        # Those that end an epoch together go together.
        found.sort(key=lambda a: (a.batches, a.epochs))
        parts += [found[i : i + at_once] for i in range(0, len(found), at_once)]
    return parts


def _choose(attempts: Sequence[Attempt], problem: int) -> Result | InputError:
    """Return the best start of a problem, the earlier one where they are equal."""
    mine = [a for a in attempts if a.problem == problem]
    for attempt in mine:
        if attempt.error is not None:
            return attempt.error
    best = min(mine, key=lambda a: a.best_rmse)
    return Result(
        weights=best.best,
        start=best.start,
        epoch=best.best_epoch,
        rmse=best.best_rmse,
        last_rmse=best.last_rmse,
        rmse_without=best.rmse_without,
    )
