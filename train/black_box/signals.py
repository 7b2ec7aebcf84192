"""Inputs and targets of black boxes: every signal of the logs, and the model's residual."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.model import PhysicalModel

ELAPSED = "elapsed"
"""The seconds of a stretch, as a signal."""


@dataclass(frozen=True)
class Lesson:
    """The residuals of a model in training runs, each to be predicted from the other runs."""

    runs: tuple[Run, ...]
    """Training runs; those of one group are left out together."""
    rests: tuple[Array, ...]
    """[n, K] per run: drift that the model, fitted to all of them, leaves."""
    without: Mapping[str, Array]
    """Run's name -> [n, K] drift that the model predicts when it is fitted to the others."""
    names: tuple[str, ...]
    """Signals that move: temperature, inputs, loads, time."""
    signals: tuple[Array, ...]
    """[n, S] per run, each of mean 0 and RMS 1 over all runs."""
    tared: bool
    """Each run has an offset of its own, which is not there to be learnt."""

    def name_groups(self) -> tuple[str, ...]:
        """Return the runs as the user knows them."""
        return tuple(dict.fromkeys(run.group for run in self.runs))


def pose(model: PhysicalModel, dataset: Dataset, tared: bool) -> Lesson:
    """Return the residuals of a model in the training runs, with all signals.

    The model's shared parameters come from all runs; its prediction for a run left out comes from
    coefficients fitted to the others.

    Args:
        model: fitted to all training runs.
        dataset: with two training runs or more, and no test runs.
        tared: whether each run has an offset of its own.
    """
    runs = dataset.train
    names, signals = _list_signals(runs, dataset.outputs)
    return Lesson(
        runs=runs,
        rests=tuple(run.steady_drift - model.predict(run) for run in runs),
        without=hold_out(model, dataset).predictions,
        names=names,
        signals=signals,
        tared=tared,
    )


def _list_signals(
    runs: Sequence[Run], outputs: Sequence[str]
) -> tuple[tuple[str, ...], tuple[Array, ...]]:
    """Return the names and, per run, the values [n, S] of the signals that move."""

    def read(run: Run) -> dict[str, Array]:
        loads = {f"load_{name}": run.reference[:, k] for k, name in enumerate(outputs)}
        time = run.sample_period_s * np.arange(len(run), dtype=np.float64)
        return {"T": run.temperature_degC, **run.inputs, **loads, ELAPSED: time}

    found = [read(run) for run in runs]
    shared = [name for name in found[0] if all(name in signals for signals in found)]
    columns = {name: np.concatenate([signals[name] for signals in found]) for name in shared}
    moving = tuple(name for name, x in columns.items() if float(np.ptp(x)) > 0.0)
    middle = {name: (columns[name].mean(), columns[name].std()) for name in moving}
    values = tuple(
        np.stack([(signals[n] - middle[n][0]) / middle[n][1] for n in moving], axis=1)
        for signals in found
    )
    return moving, values


def measure_unit(lesson: Lesson) -> Array:
    """Return the RMS [K] of what is left; 1 where nothing is."""
    unit = np.sqrt(np.mean(np.concatenate(lesson.rests) ** 2, axis=0))
    unit[unit == 0.0] = 1.0
    return np.asarray(unit)


def average(x: Array, block: int) -> Array:
    """Return the means [n // block, ...] of blocks of rows; what is left at the end is dropped."""
    rows = len(x) // block
    return np.asarray(x[: rows * block].reshape(rows, block, *x.shape[1:]).mean(axis=1))


def choose_block(runs: Sequence[Run], most_rows: int) -> int:
    """Return the rows of a block mean so that all runs together have no more than `most_rows`."""
    block = -(-sum(len(run) for run in runs) // most_rows)
    return max(1, min(block, min(len(run) for run in runs) // 8))
