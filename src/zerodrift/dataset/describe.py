"""A dataset in a few lines of text: runs, duration, temperatures, rates, units."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run

RATE_WINDOW_S = 60.0
"""Temperature rates are over this time, so that the chip's noise does not pass for a rate."""


def describe(dataset: Dataset) -> str:
    """Return a summary of a dataset: one line per use, one per output, then the notes."""
    uses = {"train": dataset.train, "test": dataset.test, "dwell": dataset.dwell}
    lines = [_describe_use(use, runs) for use, runs in uses.items() if runs]
    if not dataset.test:
        lines.append("test   none: runs are left out of the fit one at a time")
    for index, name in enumerate(dataset.outputs):
        drift = np.concatenate([run.drift[:, index] for run in dataset.train])
        unit = dataset.units[index]
        lines.append(
            f"{name}: drift {drift.min():.4g} to {drift.max():.4g} {unit} in the train logs, "
            f"full scale {dataset.full_scale[index]:g} {unit}"
        )
    return "\n".join(lines + [f"note: {note}" for note in dataset.notes])


def measure_rate(run: Run) -> Array:
    """Return the rates of the temperature over windows of a minute; over a shorter run as a whole.

    Returns:
        [m] in K/s, one per window start; at least one.
    """
    window = max(1, min(round(RATE_WINDOW_S / run.sample_period_s), len(run) - 1))
    rise_K = run.temperature_degC[window:] - run.temperature_degC[:-window]
    rate: Array = rise_K / (window * run.sample_period_s)
    return rate


def _describe_use(use: str, runs: Sequence[Run]) -> str:
    groups = len({run.group for run in runs})
    parts = f" in {len(runs)} parts" if len(runs) > groups else ""
    duration_s = sum(len(run) * run.sample_period_s for run in runs)
    steps = sum(len(run) for run in runs)
    low = min(float(run.temperature_degC.min()) for run in runs)
    high = max(float(run.temperature_degC.max()) for run in runs)
    rates = [60 * measure_rate(run) for run in runs if len(run) > 1]
    slowest, fastest = min(rate.min() for rate in rates), max(rate.max() for rate in rates)
    return (
        f"{use:<6} {groups} run{'s' * (groups != 1)}{parts}, {_write_duration(duration_s)} "
        f"({steps} steps of {runs[0].sample_period_s:g} s), {low:.4g} to {high:.4g} degC, "
        f"{slowest:+.3g} to {fastest:+.3g} K/min"
    )


def _write_duration(duration_s: float) -> str:
    if duration_s < 120:
        return f"{duration_s:.3g} s"
    if duration_s < 7200:
        return f"{duration_s / 60:.3g} min"
    return f"{duration_s / 3600:.3g} h"
