"""How sure an error is: what runs that were held out say of it one by one."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.diagnosis.summary import ComparisonSummary


@dataclass(frozen=True)
class RmseSpread:
    """One output's RMSE with its standard error, in its unit."""

    rmse: float
    """As `compare` tells it: held out where there are such runs."""
    std_error: float | None
    """From how the runs differ; None with fewer than two."""
    runs: int
    """Runs that it is told of."""
    held_out: bool


def measure_spread(compared: ComparisonSummary) -> Mapping[str, RmseSpread]:
    """Return each output's RMSE with its standard error.

    A mean square is the mean of the runs'; its standard error is their scatter over the root of
    their number, and that of its root half of that over the root. Runs count alike.
    """
    told = {}
    for name, output in compared.outputs.items():
        use = "test" if output.rmse_test is not None else "train"
        is_held_out = output.rmse_heldout is not None
        rmse = output.rmse if output.rmse_heldout is None else output.rmse_heldout
        squares = [
            run[name].rmse ** 2
            for run in compared.errors.values()
            if name in run and run[name].held_out == is_held_out and run[name].use == use
        ]
        error = None
        if len(squares) > 1 and rmse > 0.0:
            mean = sum(squares) / len(squares)
            scatter = sum((s - mean) ** 2 for s in squares) / (len(squares) - 1)
            error = 0.5 * math.sqrt(scatter / len(squares)) / rmse
        told[name] = RmseSpread(rmse, error, len(squares), is_held_out)
    return told
