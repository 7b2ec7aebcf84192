"""Compares the test logs with a diagnosis, which uses the training runs alone."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.run_errors import collect_errors, pool_steady_rmse
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit

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
