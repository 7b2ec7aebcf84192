"""What the model leaves against what the formula says of it, on runs left out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.formula.proposal import Formula
from zerodrift.diagnosis.judgement import Fitted

MOST_POINTS = 400
"""Of an output, over all runs."""
DIGITS = 5


@dataclass(frozen=True)
class FormulaCurve:
    """Points of one output, each the mean of a stretch of a run, in the output's unit.

    Both from models that the run is left out of; where logs are tared, without the run's own mean.
    """

    formula: tuple[float, ...]
    """What the formula adds to the model."""
    remainder: tuple[float, ...]
    """What the model without it leaves: equal, where the formula is all that is missing."""


def trace_formula(formula: Formula, dataset: Dataset) -> Mapping[str, FormulaCurve]:
    """Return output -> points of the remainder against the formula.

    Args:
        formula: as fitted.
        dataset: the runs it was fitted to.
    """
    revision = formula.revision
    left, said = _join(revision.before), _join(revision.after)
    total = sum(len(error) for error in left.values())
    block = max(1, -(-total // MOST_POINTS))
    points: list[list[Array]] = [[], []]
    for group, error in left.items():
        added = error - said[group]
        for found, rows in zip(points, (added, error), strict=True):
            whole = len(rows) // block
            if not whole:
                continue
            means = rows[: whole * block].reshape(whole, block, -1).mean(axis=1)
            found.append(means - rows.mean(axis=0) if revision.tared else means)
    x, y = (np.concatenate(found) for found in points)
    return {
        name: FormulaCurve(_round(x[:, k]), _round(y[:, k]))
        for k, name in enumerate(dataset.outputs)
    }


def _join(fitted: Fitted) -> dict[str, Array]:
    """Return what a model leaves of each run [n, K], outliers by their weights."""
    return {group: error.steady for group, error in fitted.errors.items()}


def _round(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{x:.{DIGITS}g}") for x in values)
