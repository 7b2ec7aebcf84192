"""The simplest compensators: none, a constant, a line in temperature; what is beyond a constant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.fit import fit

LINE = EffectConfig("zero_tempco", {"order": 1})


@dataclass(frozen=True)
class SimpleModel:
    """A compensator that any project could have without a model, fitted to its training runs."""

    name: str
    """constant | line."""
    fitted: Mapping[str, Array]
    """Training run's name -> [n, K] what it predicts."""
    held_out: Mapping[str, Array]
    """Run's name -> [n, K] what it predicts for runs that it did not learn from: the test runs
    where there are any, else each training run in turn."""


def fit_baselines(dataset: Dataset, *, tared: bool) -> tuple[SimpleModel, ...]:
    """Return a constant and a line in temperature, fitted as the project's own effects are.

    Args:
        dataset: its runs.
        tared: each run has an offset of its own. A constant is then no compensation at all, and is
            not among them.
    """
    line = _fit("line", (LINE,), dataset, tared=tared)
    return (line,) if tared else (fit_constant(dataset, tared=False), line)


def fit_constant(dataset: Dataset, *, tared: bool) -> SimpleModel:
    """Return the mean drift of the training runs as a compensator; each run counts once if tared.

    Args:
        dataset: its runs.
        tared: each run has an offset of its own.
    """
    return _fit("constant", (), dataset, tared=tared)


def explain_share(left: Array, constant: Array) -> Array:
    """Return the share [K] of a squared error that is gone, beyond what a constant takes away.

    Negative where the constant alone does better; 0 where it leaves nothing.

    Args:
        left: [K] sum of a model's squared errors, each run's own offset apart where logs are tared.
        constant: [K] the same of a constant that was fitted to the same runs.
    """
    there = constant > 0.0
    return np.asarray(np.where(there, 1.0 - left / np.where(there, constant, 1.0), 0.0))


def _fit(
    name: str, effects: Sequence[EffectConfig], dataset: Dataset, *, tared: bool
) -> SimpleModel:
    runs = tuple(replace(run, tared=tared) for run in dataset.train)
    model = fit(
        effects,
        runs,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
    )
    return SimpleModel(
        name,
        {run.name: model.predict(run) for run in runs},
        hold_out(model, replace(dataset, train=runs)).predictions,
    )
