"""Predictions for training runs by models that left them out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.chip_codes import FLAG_MARGIN_K, RANGE_MARGIN
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.train.prepare import Handling
from zerodrift.train.refits import Original, Refit, train_refits
from zerodrift.train.stages import fit_physics
from zerodrift.train.training import assemble_bank, fit_bank

PARTS = "leave runs out in {} parts"
ONE_RUN = (
    "a lag bank that left out the only training run would have learnt from none; expected two runs"
    " or more. Record another"
)


@dataclass(frozen=True)
class LeftOut:
    """Predictions for every training run by models that did not learn from it."""

    method: str
    """leave one run out | blocks of one run | leave runs out in N parts."""
    floating: tuple[Array, ...]
    """[n, K] per training run, of the float model."""
    physics: tuple[Array, ...] | None
    """[n, K] per training run, of the physical model alone; None where nothing was learnt beside
    it."""
    covered: tuple[Mask, ...]
    """[n] per training run: rows whose temperature, inputs and loads the other runs reach."""
    by_epochs: bool = False
    """Whether a network was trained again for it."""


def choose_judge(left_out: LeftOut | None, dataset: Dataset) -> LeftOut | None:
    """Return what the gate judges by; None where there are test runs, and for networks."""
    if dataset.test or left_out is None or left_out.by_epochs:
        return None
    return left_out


def leave_out(config: Config, dataset: Dataset, compensator: Compensator) -> LeftOut | None:
    """Return what is predicted for each training run from the others, where that is quick.

    The physical model and the lag bank are fitted again without each run; a network that is trained
    by epochs is not: `leave_out_together` trains it again.

    Args:
        config: the project.
        dataset: its runs.
        compensator: trained on all training runs.

    Returns:
        None where nothing need be left out, since there are test runs, or nothing can be: a
        network, or a lag bank of a single run.
    """
    if dataset.test or takes_epochs(compensator):
        return None
    alone = hold_out(compensator.physics, dataset)
    physics = tuple(alone.predictions[run.name] for run in dataset.train)
    parts = tuple(frozenset({group}) for group in dict.fromkeys(r.group for r in dataset.train))
    covered = _find_all_covered(dataset.train, parts)
    if compensator.bank is None:
        return LeftOut(alone.method, physics, None, covered)
    if len(parts) < 2:
        return None
    refits = []
    for groups in parts:
        others = tuple(run for run in dataset.train if run.group not in groups)
        refits.append(Refit(groups, _fit_without(config, dataset, others, compensator)))
    floating = _ask(refits, dataset.train)
    return LeftOut(alone.method, floating, physics, covered)


def leave_out_together(
    originals: Sequence[Original], handling: Handling
) -> list[LeftOut | InputError]:
    """Return what `leave_out` does for each compensator; networks are trained again, in step.

    Test runs play no part.

    Args:
        originals: compensators and what they were trained from.
        handling: device, folder of the checkpoint, progress.

    Returns:
        Why nothing can be left out in the place of one of which that is so.
    """
    plain = [replace(o, dataset=replace(o.dataset, test=())) for o in originals]
    trained = [o for o in plain if takes_epochs(o.compensator)]
    answers = iter(train_refits(trained, handling))
    found: list[LeftOut | InputError] = []
    for original in plain:
        if takes_epochs(original.compensator):
            refits = next(answers)
            if isinstance(refits, InputError):
                found.append(refits)
            else:
                found.append(_tell(original, refits))
            continue
        left = leave_out(original.config, original.dataset, original.compensator)
        found.append(left if left is not None else InputError(ONE_RUN))
    return found


def takes_epochs(compensator: Compensator) -> bool:
    """Return whether a network, or what is solved before one, stands beside the physical model."""
    beside = compensator.front_end is not None or compensator.network is not None
    return compensator.bank is None and beside


def _tell(original: Original, refits: Sequence[Refit]) -> LeftOut:
    """Return what networks say of the runs that they did not learn from."""
    runs = original.dataset.train
    parts = tuple(one.groups for one in refits)
    alone = hold_out(original.compensator.physics, original.dataset)
    return LeftOut(
        alone.method if all(len(groups) == 1 for groups in parts) else PARTS.format(len(parts)),
        _ask(refits, runs),
        tuple(alone.predictions[run.name] for run in runs),
        _find_all_covered(runs, parts),
        by_epochs=True,
    )


def _ask(refits: Sequence[Refit], runs: Sequence[Run]) -> tuple[Array, ...]:
    """Return the drift [n, K] of each run as the refit says that did not learn from it."""
    floating: dict[str, Array] = {}
    for one in refits:
        own = [run for run in runs if run.group in one.groups]
        answers = one.compensator.predict_all(own)
        floating |= {run.name: answer for run, answer in zip(own, answers, strict=True)}
    return tuple(floating[run.name] for run in runs)


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


def _find_all_covered(runs: Sequence[Run], parts: Sequence[frozenset[str]]) -> tuple[Mask, ...]:
    """Return [n] per run: rows within what the runs reach that are not left out with it."""
    if len(parts) < 2:
        return tuple(np.ones(len(run), dtype=np.bool_) for run in runs)
    own = {group: groups for groups in parts for group in groups}
    return tuple(
        _find_covered(run, [other for other in runs if other.group not in own[run.group]])
        for run in runs
    )


def _find_covered(run: Run, others: Sequence[Run]) -> Mask:
    """Return [n] rows of a run within what other runs reach, as a chip's flags do."""
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
