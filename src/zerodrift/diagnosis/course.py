"""Diagnosis repeated: add what is missing until nothing is, or until it has no name."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import Advance, open_case
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.diagnose import diagnose, list_idle
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT, leave_out
from zerodrift.diagnosis.run_errors import collect_errors, pool_steady_rmse
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.fit import fit

# One run that is unlike the others: where most of what no effect explains lies in it.

MOST = 0.6
"""Share of the squared error beyond the floor that makes a run stand out, ..."""
TIMES = 3.0
"""... and how many times its share of the samples that must be."""
FEWEST_RUNS = 3


def describe_bad_run(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> str | None:
    """Return which run holds most of what the model leaves, each predicted from the others.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs; the training runs are looked at.
        catalogue: the known effects.

    Returns:
        A sentence, or None where no single run stands out.
    """
    method, errors = leave_out(effects, dataset, catalogue)
    if method != LEAVE_ONE_RUN_OUT:
        return None
    if len(errors) < FEWEST_RUNS:
        return None
    floor = measure_floor(dataset).rms
    live = floor > 0.0
    beyond = {}
    for group, e in errors.items():
        squares = np.sum((e.steady[:, live] / floor[live]) ** 2, axis=0)
        beyond[group] = float(np.maximum(squares - e.usable[:, live].sum(axis=0), 0.0).sum())
    whole = sum(beyond.values())
    worst = max(beyond, key=lambda group: beyond[group])
    samples = sum(e.error.shape[0] for e in errors.values())
    share = beyond[worst] / whole if whole > 0.0 else 0.0
    if share < max(MOST, TIMES * errors[worst].error.shape[0] / samples):
        return None
    return (
        f"{100.0 * share:.0f} % of the squared error beyond the noise lies in run {worst}, which "
        "is unlike the others: look at that run first; it may be another sensor, or something "
        "happened in it"
    )


# Compares the test logs with a diagnosis, which uses the training runs alone.

FAR = 1.3
"""Test logs whose RMSE is this many times the noise floor hold something more, if the error of
the training runs is not as large."""


def describe_unseen(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> str | None:
    """Return what a diagnosis of the training runs does not know of the test logs.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs.
        catalogue: the known effects.

    Returns:
        A sentence where the model leaves more of the test logs than of those it learnt from, in
        shares of the noise floor; else None.
    """
    if not dataset.test:
        return None
    model = fit(
        effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )
    runs = (*dataset.train, *dataset.test)
    predictions = {run.name: model.predict(run) for run in runs}
    errors = collect_errors(runs, predictions, model.tared, model.find_usable)
    seen, unseen = (
        {run.group: errors[run.group] for run in part} for part in (dataset.train, dataset.test)
    )
    floor = measure_floor(dataset).rms
    live = floor > 0.0

    def measure(groups: Sequence[str]) -> float:
        rmse = pool_steady_rmse([errors[group] for group in groups])
        return float(np.sqrt(np.mean((rmse[live] / floor[live]) ** 2))) if live.any() else 0.0

    inside, outside = measure(list(seen)), measure(list(unseen))
    if outside <= FAR * max(inside, 1.0):
        return None
    worst = max(unseen, key=lambda group: measure([group]))
    return (
        f"the model leaves {outside:.1f} times the noise floor of the test logs (most of "
        f"{worst}: {measure([worst]):.1f} times), but {inside:.1f} times of the train logs, which "
        "alone are diagnosed: the test logs hold something that the train logs do not show. Add "
        "some like them to [logs] train, and diagnose again"
    )


# Diagnosis repeated: add what is missing until nothing is, or until it has no name.

MOST_ADDED = 6
"""Effects that repeated diagnosis adds at most."""


@dataclass(frozen=True)
class RepeatedDiagnosis:
    """What repeated diagnosis came to: its steps, the model in the end, and what to drop."""

    steps: tuple[Diagnosis, ...]
    """The last one is not `missing`, unless the limit of steps was reached."""
    effects: tuple[EffectConfig, ...]
    """The `[[effect]]` tables in the end."""
    drop: tuple[str, ...]
    """Effects that no longer earn their place."""


def diagnose_until_done(
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue | None = None,
    advance: Advance = lambda kind: None,
) -> RepeatedDiagnosis:
    """Return the course of adding what is missing until nothing is, or it cannot be named.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs.
        catalogue: the known effects; by default the built-ins.
        advance: called with each effect's name when it has been tried.
    """
    catalogue = catalogue or load_catalogue()
    steps: list[Diagnosis] = []
    while len(steps) <= MOST_ADDED:
        steps.append(diagnose(effects, dataset, catalogue, advance))
        if steps[-1].effect is None:
            break
        effects = extend_model(effects, catalogue, steps[-1].effect, steps[-1].parameters)
    drop = list_idle(open_case(dataset, catalogue, effects, advance))
    return RepeatedDiagnosis(tuple(steps), tuple(effects), drop)
