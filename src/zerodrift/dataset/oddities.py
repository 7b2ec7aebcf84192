"""What is odd in logs that can be read: a run in another unit, readings far from their neighbours.

Nothing here is refused: each may be right, but misleads a fit where it is a mistake.
"""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array, find_median, find_quantile
from zerodrift.base.config import Config
from zerodrift.dataset.runs import Run
from zerodrift.dataset.units import tell_time

UNIT_RATIOS = {
    1000.0: "one in thousandths of the other's unit",
    0.001: "one in thousandths of the other's unit",
    -1.0: "the sign of one reversed",
    9.80665: "one in newtons, the other in kilograms",
    1 / 9.80665: "one in newtons, the other in kilograms",
}
"""Slopes of a reading against its reference that speak for a wrong unit, and what they mean."""
RATIO_TOLERANCE = 0.02
FOLLOWS = 0.98
"""A reading follows its reference if this share of its variance lies on a line through it."""
KELVIN = 273.15
APART_K = 150.0
"""A run this much hotter than every other one, throughout, is looked at."""
SAMPLE = 20_000
"""Rows, evenly spaced, from which a run's usual range and steps are taken."""
BLOCK = 1 << 16
"""Rows that are searched at once, so that a long log takes no memory of its size."""
SPIKE_K = 5.0
SPIKE_RANGES = 3.0
SPIKE_STEPS = 30.0
"""A row is a spike if it stands out of both neighbours by so many kelvin or, in an output, by so
many times the range of the drift and by so many usual steps; the neighbours agree to a tenth."""


def find_oddities(config: Config, runs: Sequence[Run]) -> list[str]:
    """Return a note on each kind of oddity, with the first run that shows it."""
    notes = _find_kelvin_runs(config, runs)
    where = [
        (run, row) for run in runs for row in _find_spikes(run.temperature_degC, SPIKE_K).tolist()
    ]
    notes += _tell_spikes(where, config.temperature_column, "temperature")
    for index, output in enumerate(config.outputs):
        where = [(run, row) for run in runs for row in _find_drift_spikes(run, index)]
        notes += _tell_spikes(where, output.measured, f"output {output.name}")
        notes += _find_unit_mismatch(runs, index, output.measured, output.reference)
    return notes


def _find_kelvin_runs(config: Config, runs: Sequence[Run]) -> list[str]:
    """Return a note if some runs, and not all, look as if they were in kelvin."""
    lowest = {run.name: float(run.temperature_degC.min()) for run in runs}
    highest = {run.name: float(run.temperature_degC.max()) for run in runs}
    kelvin = [run for run in runs if lowest[run.name] > KELVIN - 100]
    others = [run for run in runs if lowest[run.name] <= KELVIN - 100]
    if not kelvin or not others:
        return []
    hottest = max(highest[run.name] for run in others)
    odd = [run.group for run in kelvin if lowest[run.name] - hottest > APART_K]
    if not odd:
        return []
    names = list(dict.fromkeys(odd))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return [
        f"run {names[0]}{more}: '{config.temperature_column}' is {APART_K:g} K and more above all "
        "other runs: if it is in kelvin, subtract 273.15"
    ]


def _find_spikes(values: Array, least: float) -> np.ndarray:
    """Return the rows that differ from both neighbours by more than `least`, which agree."""
    if values.size < 3:
        return np.zeros(0, dtype=np.intp)
    found = []
    for begin in range(0, values.size - 2, BLOCK):
        steps = np.diff(values[begin : begin + BLOCK + 2])
        if max(steps.max(), -steps.min()) > least:
            up, down = steps[:-1], -steps[1:]
            height = np.abs(up + down) / 2
            spikes = (height > least) & (np.abs(up - down) < height / 10)
            found.append(np.flatnonzero(spikes) + begin + 1)
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def _find_drift_spikes(run: Run, index: int) -> list[int]:
    """Return the rows of one output whose drift differs much from both neighbours and all
    others."""
    drift = run.measured[:, index] - run.reference[:, index]
    if drift.size < 3:
        return []
    some = np.arange(0, drift.size - 1, _spread(drift.size))
    low, high = (find_quantile(drift[some], share) for share in (0.01, 0.99))
    usual = find_median(np.abs(drift[some + 1] - drift[some]))
    least = max(SPIKE_RANGES * (high - low), SPIKE_STEPS * usual)
    return [int(row) for row in _find_spikes(drift, least)] if least > 0 else []


def _spread(rows: int) -> int:
    """Return the distance in rows at which about `SAMPLE` of them are taken."""
    return max(rows // SAMPLE, 1)


def _tell_spikes(where: Sequence[tuple[Run, int]], column: str, what: str) -> list[str]:
    if not where:
        return []
    run, row = where[0]
    values = run.temperature_degC if what == "temperature" else None
    height = "" if values is None else f" to {values[row]:.4g} degC"
    rows = "one row" if len(where) == 1 else f"{len(where)} rows, the first"
    return [
        f"'{column}' ({what}) jumps{height} and back in {rows} at "
        f"{tell_time(run.time_s[row])} of {run.source.name}: if no sensor did that, take the "
        "row out"
    ]


def _find_unit_mismatch(
    runs: Sequence[Run], index: int, measured: str, reference: float | str
) -> list[str]:
    """Return a note if a reading is its reference times a factor that units or signs explain."""
    if not isinstance(reference, str):
        return []
    odd: dict[float, list[str]] = {}
    for run in runs:
        some = slice(None, None, _spread(len(run)))
        reading, truth = run.measured[some, index], run.reference[some, index]
        reading, truth = reading - reading.mean(), truth - truth.mean()
        power = float(truth @ truth)
        if power == 0 or not (reading @ reading) > 0:
            continue
        slope = float(reading @ truth) / power
        if slope * slope * power < FOLLOWS * float(reading @ reading):
            continue
        for ratio in UNIT_RATIOS:
            if abs(slope / ratio - 1) < RATIO_TOLERANCE:
                odd.setdefault(ratio, []).append(run.group)
    notes = []
    for ratio, names in odd.items():
        who = "every run" if len(names) == len(runs) else f"run {names[0]}"
        notes.append(
            f"in {who} '{measured}' is {ratio:g} times '{reference}': {UNIT_RATIOS[ratio]}?"
        )
    return notes
