"""The errors that one model, fitted as it ships, makes on runs that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import replace

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.diagnosis.run_errors import RunError, collect_errors
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit


def leave_out(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> tuple[str, dict[str, RunError]]:
    """Return how training runs were left out, and the errors on each of them.

    Args:
        effects: the `[[effect]]` tables of the model, fitted by plain least squares.
        dataset: its runs; only the training runs are used.
        catalogue: the known effects.
    """
    model = fit(
        effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )
    held_out = hold_out(model, replace(dataset, test=()))
    errors = collect_errors(dataset.train, held_out.predictions, model.tared, model.find_usable)
    return held_out.method, errors
