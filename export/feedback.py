"""The float model's prediction on the chip, where the load is the compensated output."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import CheckError
from zerodrift.dataset.runs import Run

MOST_ROUNDS = 200
SETTLED = 1e-9
"""The rounds end when no drift moves by more than this share of the largest."""


def predict_fed_back(predict: Callable[[Run], Array], run: Run) -> Array:
    """Return the drift [n, K] with the load of each step taken from the step before.

    The chip does not know the true load. It takes load[n] = measured[n] - drift[n-1], the present
    raw output less the drift found one step before, and so does this: from the true loads on, the
    whole run is predicted again with the loads that the last round's drift leaves, until nothing
    moves. Since a drift depends on earlier ones only, that is the one solution of the loop.

    Args:
        predict: run -> drift [n, K], which takes the loads from `run.reference`.
        run: the run; at its start the loop is at rest.

    Raises:
        CheckError: the loop does not converge: the effects of the load are too strong.
    """
    drift = predict(run)
    for _ in range(MOST_ROUNDS):
        before = np.concatenate([drift[:1], drift[:-1]])
        again = predict(replace(run, reference=run.measured - before))
        moved = float(np.abs(again - drift).max(initial=0.0))
        largest = float(np.abs(again).max(initial=0.0))
        drift = again
        if moved <= SETTLED * largest:
            return drift
    raise CheckError(
        f"run '{run.name}': effects of the load feed on themselves: after {MOST_ROUNDS} rounds the"
        f" drift still moves by {moved:.3g}. On the chip the load is what the compensator leaves of"
        " the raw output, so an effect may take only a part of it. Remove the last load effect, or"
        " hold its parameters."
    )
