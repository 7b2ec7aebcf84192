"""What a trained compensator achieves per output: in-sample and held out, beside physics alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.train.compensator import Compensator
from zerodrift.train.sequences import Split

WORTH_ITS_FLASH = 0.97
"""What learns the rest is kept if it brings the error on held-out runs below this multiple."""


@dataclass(frozen=True)
class StageRmse:
    """RMSE [K] over some runs, in the outputs' units."""

    uncompensated: Array
    physics: Array
    """Of the physical model alone."""
    compensated: Array
    """Of the whole compensator."""


@dataclass(frozen=True)
class Scores:
    """Errors over the runs that were learnt from, and over others."""

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    in_sample: StageRmse
    held_out: StageRmse
    held_out_runs: tuple[str, ...]
    explanation: str
    """What "held out" means here, and whether runs' own offsets are taken off."""
    on_test_logs: bool
    """Whether the held-out runs are the test logs; else training runs that were left out."""


@dataclass(frozen=True)
class ContractingCost:
    """What `[network] contracting = true` costs: errors beside those of a network trained freely.

    In multiples of what physics leaves, on the training runs that were left out, which also chose
    the epoch of both; where none could be, in training.
    """

    rmse: float
    rmse_free: float
    ratio: float
    """The first over the second."""
    left_out: bool
    """Whether runs were left out."""

    def __str__(self) -> str:
        """Return it in a sentence."""
        where = "on the runs left out" if self.left_out else "in training"
        return (
            f"[network] contracting = true: {where} the error is {self.ratio:.3f} times that of"
            " the same network trained without it"
        )


@dataclass(frozen=True)
class Trained:
    """A trained compensator and what it achieves."""

    compensator: Compensator
    scores: Scores
    contracting: ContractingCost | None = None
    """With `[network] contracting = true`: what it costs."""


def score(
    compensator: Compensator,
    dataset: Dataset,
    refit: Compensator | None = None,
    split: Split | None = None,
) -> Scores:
    """Return the errors of a compensator.

    Args:
        compensator: trained on all training runs.
        dataset: the runs; its test runs are the held-out ones where there are any.
        refit: without test runs, the same trained without the runs that `split_runs` held out.
        split: which those were.
    """
    tared = compensator.tared
    if dataset.test:
        judge, runs, skip = compensator, dataset.test, {}
        explanation = "held out: the test logs"
    elif refit and split:
        judge, runs, skip = refit, split.held_out, dict(split.skip)
        explanation = f"{split.explanation}; they also chose the epoch, which flatters a little"
    else:
        judge, runs, skip = compensator, (), {}
        explanation = "nothing was held out; `zerodrift compare` leaves one run out at a time"
    if tared:
        explanation += "; the logs are tared, so each run's own offset is taken off"
    return Scores(
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        in_sample=measure(compensator, dataset.train, tared),
        held_out=measure(judge, runs, tared, skip),
        held_out_runs=tuple(dict.fromkeys(run.group for run in runs)),
        explanation=explanation,
        on_test_logs=bool(dataset.test),
    )


def measure(
    compensator: Compensator,
    runs: Sequence[Run],
    tared: bool,
    skip: Mapping[str, int] | None = None,
) -> StageRmse:
    """Return the errors of a compensator over runs; NaN where there are none.

    Args:
        compensator: what predicts.
        runs: what is measured.
        tared: take off each group's mean error, which belongs to its tare.
        skip: run's name -> samples at its start that do not count.
    """

    def rmse(predictions: Sequence[Array]) -> Array:
        by_group: dict[str, list[Array]] = {}
        for run, prediction in zip(runs, predictions, strict=True):
            error = (run.drift - prediction)[(skip or {}).get(run.name, 0) :]
            by_group.setdefault(run.group, []).append(error)
        if not by_group:
            return np.full(len(compensator.outputs), np.nan)
        groups = [np.concatenate(parts) for parts in by_group.values()]
        rest = [g - g.mean(axis=0) if tared else g for g in groups]
        return np.asarray(np.sqrt(np.mean(np.concatenate(rest) ** 2, axis=0)))

    physics = rmse(compensator.physics.predict_all(runs))
    is_alone = compensator.is_physics_alone and all(run.before is None for run in runs)
    return StageRmse(
        uncompensated=rmse([np.zeros_like(run.drift) for run in runs]),
        physics=physics,
        compensated=physics if is_alone else rmse(compensator.predict_all(runs)),
    )
