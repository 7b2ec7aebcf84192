"""What models that left a training run out say of it, where no test logs are configured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config
from zerodrift.dataset.chip_codes import FLAG_MARGIN_K, RANGE_MARGIN
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.bank_training import assemble_bank, fit_bank
from zerodrift.train.compensator import Compensator
from zerodrift.train.stages import fit_physics

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class LeftOut:
    """Predictions for every training run by models that did not learn from it."""

    method: str
    """leave one run out | blocks of one run."""
    floating: tuple[Array, ...]
    """[n, K] per training run, of the float model."""
    physics: tuple[Array, ...] | None
    """[n, K] per training run, of the physical model alone; None where nothing was learnt beside
    it."""
    covered: tuple[Mask, ...]
    """[n] per training run: rows whose temperature, inputs and loads the other runs reach."""


def leave_out(config: Config, dataset: Dataset, compensator: Compensator) -> LeftOut | None:
    """Return what is predicted for each training run from the others.

    The physical model and the lag bank are fitted again without each run; a network is not, for it
    takes too long.

    Args:
        config: the project.
        dataset: its runs.
        compensator: trained on all training runs.

    Returns:
        None where nothing need be left out, since there are test runs, or nothing can be: a
        network, or a lag bank of a single run.
    """
    if dataset.test:
        return None
    alone = hold_out(compensator.physics, dataset)
    physics = tuple(alone.predictions[run.name] for run in dataset.train)
    groups = tuple(dict.fromkeys(run.group for run in dataset.train))
    if len(groups) > 1:
        covered = tuple(_find_covered(run, dataset.train) for run in dataset.train)
    else:
        covered = tuple(np.ones(len(run), dtype=np.bool_) for run in dataset.train)
    if compensator.bank is None:
        if compensator.network is not None:
            return None
        return LeftOut(alone.method, physics, None, covered)
    if len(groups) < 2:
        return None
    floating: dict[str, Array] = {}
    for group in groups:
        others = tuple(run for run in dataset.train if run.group != group)
        understudy = _fit_without(config, dataset, others, compensator)
        own = [run for run in dataset.train if run.group == group]
        floating |= {
            run.name: answer for run, answer in zip(own, understudy.predict_all(own), strict=True)
        }
    return LeftOut(
        alone.method, tuple(floating[run.name] for run in dataset.train), physics, covered
    )


def _fit_without(
    config: Config, dataset: Dataset, others: Sequence[Run], compensator: Compensator
) -> Compensator:
    """Return physics and lag bank fitted to some runs, from the start."""
    catalogue = load_catalogue(config.plugin_files)
    physics = fit_physics(config, dataset, others, catalogue)
    alone = replace(
        compensator, physics=physics, tared=physics.tared, bank=None, network=None, front_end=None
    )
    return assemble_bank(alone, fit_bank(config, physics, others), others)


def _find_covered(run: Run, runs: Sequence[Run]) -> Mask:
    """Return [n] rows of a run within what the runs of other groups reach, as a chip's flags do."""
    others = [other for other in runs if other.group != run.group]
    covered = np.ones(len(run), dtype=np.bool_)

    def ask(own: Array, theirs: Sequence[Array], margin: float | None = None) -> None:
        low, high = min(float(x.min()) for x in theirs), max(float(x.max()) for x in theirs)
        spare = RANGE_MARGIN * (high - low) if margin is None else margin
        covered[(own < low - spare) | (own > high + spare)] = False

    ask(run.temperature_degC, [other.temperature_degC for other in others], FLAG_MARGIN_K)
    for name, values in run.inputs.items():
        ask(values, [other.inputs[name] for other in others])
    for k in range(run.reference.shape[1]):
        ask(run.reference[:, k], [other.reference[:, k] for other in others])
    return covered
