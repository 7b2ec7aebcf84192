"""What every method of compensation offers: fit to runs, predict a run, tell its cost."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Run

RECIPE, QUICK = "recipe", "quick"
SCHEDULES = (RECIPE, QUICK)


@dataclass(frozen=True)
class Options:
    """What a comparison may vary; a method that has no use for an option leaves it alone."""

    spacing_s: float = 10.0
    """Between the samples of a window; the paper does not say, and 0.1 s drowns the slope."""
    schedule: str = QUICK
    """"recipe": Adam at 1e-3, batches of 128, 2000 epochs, as the paper; "quick": the same network
    by one learning-rate cycle."""
    epochs: int = 0
    """0: the schedule's own."""
    thermometers: tuple[str, ...] = ()
    """Inputs beside the chip's temperature that a method may see; the paper's see none."""
    effects: tuple[EffectConfig, ...] = ()
    """The physical model of "physics" and of what builds on it."""
    outputs: tuple[str, ...] = ()
    """Names of the outputs; empty: y0, y1, ..."""
    full_scale: tuple[float, ...] = ()
    """Of the outputs; empty: the largest reading."""
    report: Callable[[int, float, "Fitted"], None] | None = field(default=None, compare=False)
    """Called after an epoch of a network's training with its number, the CPU seconds so far and the
    network as it is, for courses of the error; its own time is not counted."""
    report_epochs: tuple[int, ...] = ()
    """After which epochs; empty: after each."""


class Fitted(Protocol):
    """A fitted method."""

    @property
    def parameters(self) -> int:
        """Numbers that were learnt."""
        ...

    @property
    def macs_per_step(self) -> int:
        """Multiplications and additions of a step on the chip."""
        ...

    @property
    def fit_cpu_s(self) -> float:
        """CPU seconds of the fit, search included."""
        ...

    @property
    def exportable(self) -> bool:
        """Whether `zerodrift firmware` makes C of this kind of model."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """What the fit has to say."""
        ...

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of a run that starts at rest."""
        ...


class Fit(Protocol):
    """The function that fits a method."""

    def __call__(self, runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        """Return the method fitted to the drift of training runs."""
        ...


@dataclass(frozen=True)
class Method:
    """One method of the comparison."""

    name: str
    title: str
    """For tables."""
    family: str
    """linear | network | physics | baseline."""
    run: Fit
    paper: bool = False
    """Whether the paper has it in its tables."""
    seeded: bool = True
    """Whether the seed changes anything."""

    def fit(self, runs: Sequence[Run], *, seed: int = 0, options: Options | None = None) -> Fitted:
        """Return the method fitted to the drift of training runs.

        Raises:
            InputError: the runs cannot be fitted, or an optional package is missing.
        """
        return self.run(runs, seed=seed, options=options or Options())


@dataclass(frozen=True)
class FittedFunction:
    """A fitted method that is a function of a run."""

    function: Callable[[Run], Array]
    parameters: int
    macs_per_step: int
    fit_cpu_s: float
    exportable: bool
    notes: tuple[str, ...] = ()

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of a run that starts at rest."""
        return self.function(run)


def list_outputs(
    runs: Sequence[Run], options: Options
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return names and full scales of the outputs, made up where the options have none."""
    count = runs[0].measured.shape[1]
    names = options.outputs or tuple(f"y{k}" for k in range(count))
    largest = np.max([np.abs(run.measured).max(axis=0) for run in runs], axis=0)
    scales = options.full_scale or tuple(float(x) for x in np.maximum(largest, 1e-9))
    return names, scales
