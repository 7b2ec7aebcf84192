"""A diagnosis' errors as `compare` and `add` tell them: of the models that are fitted and shipped.

The diagnosis judges by fits that weigh each octave of time by its noise. What it tells in an
output's unit is the error of the model that zerodrift.toml means, fitted by plain least squares,
so that one model has one left-out error, whichever command tells it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.held_out import leave_out
from zerodrift.diagnosis.run_errors import pool_rmse, pool_steady_rmse
from zerodrift.physics.catalogue import Catalogue


def tell_plain_errors(
    diagnosis: Diagnosis,
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue,
) -> Diagnosis:
    """Return the diagnosis with the left-out errors of the plain fits, as it is and as named.

    Args:
        diagnosis: what was found of the effects.
        effects: the `[[effect]]` tables that were diagnosed.
        dataset: its runs.
        catalogue: the known effects.

    Returns:
        `outputs` in their units, of all samples; `floor_ratio_before` and `floor_ratio_after`
        pooled over the outputs, outliers by their weights. Candidates and probabilities stay.
    """
    before, steady_before = measure_left_out(effects, dataset, catalogue)
    after, steady_after = None, steady_before
    if diagnosis.effect is not None:
        extended = extend_model(effects, catalogue, diagnosis.effect, diagnosis.parameters)
        after, steady_after = measure_left_out(extended, dataset, catalogue)
    places = {name: dataset.outputs.index(name) for name in diagnosis.outputs}
    outputs = {
        name: replace(
            told,
            rmse_left_out=float(before[places[name]]),
            rmse_left_out_after=None if after is None else float(after[places[name]]),
        )
        for name, told in diagnosis.outputs.items()
    }
    floor = np.array([told.noise_floor for told in outputs.values()])
    columns = list(places.values())
    return replace(
        diagnosis,
        outputs=outputs,
        floor_ratio_before=pool_ratio(steady_before[columns], floor),
        floor_ratio_after=pool_ratio(steady_after[columns], floor),
    )


def measure_left_out(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> tuple[Array, Array]:
    """Return the RMSE [K] on runs left out: over all samples, and with outliers by weights."""
    errors = list(leave_out(effects, dataset, catalogue)[1].values())
    return pool_rmse(errors), pool_steady_rmse(errors)


def pool_ratio(rmse: Array, floor: Array) -> float:
    """Return errors [K] over the noise floor [K], pooled over the outputs."""
    return float(np.sqrt(np.mean((rmse / floor) ** 2)))
