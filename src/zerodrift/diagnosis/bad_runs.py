"""One run that is unlike the others: where most of what no effect explains lies in it."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT
from zerodrift.diagnosis.left_out import leave_out
from zerodrift.physics.catalogue import Catalogue

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
