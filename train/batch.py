"""The training loop of many networks at once: every sensor and start with weights of its own.

Each network goes through the very steps that `zerodrift.train.optimise.Trainer` would take it
through alone - the same first weights, chunks, order, learning rate, limit of the gradient - so
one sensor is a batch of one, and the results differ by rounding only.
"""

from collections.abc import Callable, Sequence

import torch

from zerodrift.base.errors import InputError
from zerodrift.train.batch_data import Attempt, Problem
from zerodrift.train.batch_loop import Training
from zerodrift.train.optimise import Result

__all__ = ["Problem", "train_batch"]

AT_ONCE = 256
"""Networks that walk through the epochs together on the CPU."""
SAMPLES_AT_ONCE = 4_000_000
"""Samples of all networks that walk together, each run counted as long as the longest: they take
some 150 bytes each."""
BLOCK = 32
"""Networks in one pass forward and back on the CPU: more of them do not stay in its cache."""


def train_batch(
    problems: Sequence[Problem],
    *,
    device: str = "cpu",
    report: Callable[[float], None] = lambda _: None,
) -> list[Result | InputError]:
    """Return what `Trainer.run` would return for each problem, all trained at once.

    Args:
        problems: streams of one kind of network; the numbers of features, runs and samples differ
            as they like.
        device: where the tensors are: "cpu" or "cuda".
        report: is told the share that is done, 0 .. 1.

    Returns:
        For each problem its best start, or why its training diverged.
    """
    torch.set_num_threads(1)  # with two, steps this small take far longer
    attempts = []
    for index, problem in enumerate(problems):
        s = problem.settings
        chunks = sum(-(-len(x) // s.chunk) for x in problem.sequences)
        batches = max(1, -(-chunks // s.batch))
        width = problem.sequences[0].features.shape[1]
        attempts += [Attempt(index, start, s.epochs, batches, width) for start in s.starts]
    largest = max((len(p.sequences) * max(map(len, p.sequences)) for p in problems), default=1)
    room = max(1, SAMPLES_AT_ONCE // largest)
    at_once = min(AT_ONCE, room) if device == "cpu" else room
    total = sum(a.epochs for a in attempts)
    done = 0.0
    for part in _arrange(problems, attempts, at_once):
        share = sum(a.epochs for a in part) / total

        def tell(x: float, before: float = done, share: float = share) -> None:
            report(before + share * x)

        block = BLOCK if device == "cpu" else len(part)
        Training(problems, part, device, block).run(tell)
        done += share
    return [_choose(attempts, index) for index in range(len(problems))]


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
    best: Attempt | None = None
    for attempt in attempts:
        if attempt.problem != problem:
            continue
        if attempt.error is not None:
            return attempt.error
        if best is None or attempt.best_rmse < best.best_rmse:
            best = attempt
    assert best is not None
    return Result(
        weights=best.best,
        start=best.start,
        epoch=best.best_epoch,
        rmse=best.best_rmse,
        last_rmse=best.last_rmse,
        rmse_without=best.rmse_without,
    )
