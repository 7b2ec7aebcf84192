"""What a prediction leaves of each run's drift, with the run's own offset apart."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run

FindUsable = Callable[[Run], NDArray[np.bool_]]


@dataclass(frozen=True)
class RunError:
    """One run's drift and what a model leaves of it, its stretches laid end to end."""

    group: str
    """The run's name."""
    runs: tuple[Run, ...]
    """Its stretches."""
    drift: Array
    """[n, K] measured minus reference."""
    error: Array
    """[n, K] drift minus model, without the run's own offset."""
    offset: Array
    """[K] that was taken off; zeros where logs are not tared."""
    usable: NDArray[np.bool_]
    """[n, K] samples that count; where a converter stands at its rail they do not, if the model
    knows of it, and their error is zero."""
    weights: Array
    """[n, K] of the samples, 0 for what does not count; below 1 for outliers, see `Run.weights`."""
    steady: Array
    """[n, K] the error with outliers by their weights: of the drift that is fitted."""

    @property
    def stretches(self) -> tuple[Array, ...]:
        """The errors [n, K] stretch by stretch, outliers by their weights."""
        ends = np.cumsum([len(run) for run in self.runs])[:-1]
        return tuple(np.split(self.steady, ends))

    @property
    def outlier_rows(self) -> int:
        """Rows with an outlier in some output."""
        return int(sum(r.outliers.rows.sum() for r in self.runs if r.outliers is not None))


def collect_errors(
    runs: Sequence[Run],
    predictions: Mapping[str, Array],
    tared: bool,
    find_usable: FindUsable | None = None,
) -> dict[str, RunError]:
    """Return the errors of each run that has a prediction, by the run's group.

    Args:
        runs: stretches of runs.
        predictions: stretch's name -> [n, K] drift.
        tared: each log was zeroed on its own, so a run's mean error says nothing about the model
            and is taken off.
        find_usable: run -> [n, K] which samples count; by default all.
    """
    groups = dict.fromkeys(run.group for run in runs if run.name in predictions)
    collected = {}
    for group in groups:
        own = tuple(run for run in runs if run.group == group)
        drift = np.concatenate([run.drift for run in own])
        prediction = np.concatenate([predictions[run.name] for run in own])
        usable = np.ones(drift.shape, dtype=np.bool_)
        if find_usable is not None:
            usable = np.concatenate([find_usable(run) for run in own])
        weights = usable * np.concatenate([run.weights for run in own])
        error = drift - prediction
        offset = np.zeros(error.shape[1])
        if tared:
            offset = (error * weights).sum(axis=0) / np.maximum(weights.sum(axis=0), 1)
        left = np.where(usable, error - offset, 0.0)
        steady = left
        if any(run.outliers is not None for run in own):
            mixed = np.concatenate([run.steady_drift for run in own])
            steady = np.where(usable, mixed - prediction - offset, 0.0)
        collected[group] = RunError(group, own, drift, left, offset, usable, weights, steady)
    return collected


def pool_rmse(errors: Sequence[RunError]) -> Array:
    """Return the RMSE [K] over all samples that count."""
    squares = np.sum([np.sum(e.error**2, axis=0) for e in errors], axis=0)
    counts = np.sum([e.usable.sum(axis=0) for e in errors], axis=0)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))


def pool_steady_rmse(errors: Sequence[RunError]) -> Array:
    """Return the RMSE [K] over all samples that count, outliers by their weights."""
    squares = np.sum([np.sum(e.weights * e.error**2, axis=0) for e in errors], axis=0)
    counts = np.sum([e.weights.sum(axis=0) for e in errors], axis=0)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))
