"""A column whose noise and whose whole course are many times those of the other runs.

Noise is the one thing that a run has in common with runs of another kind, at other temperatures and
under other loads: where the noise and the range of one column alone are 1,000 times what they are
elsewhere, its unit or gain is another, whatever the run was for.
"""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.agreement import FEWEST_ROWS, FEWEST_RUNS
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.misfits import tell_gain

LOUDER = 5.0
"""A column's noise is another's if it differs by this factor from all of the others', ..."""
ALIKE = 3.0
"""... which agree with each other to this factor, and more than any other output of that run
differs from theirs, ..."""
OF_RANGE = 0.5
"""... and the column's range differs by at least this power of the same factor."""


def find_noise_gains(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs whose noise and range are in one run many times those elsewhere."""
    whole = [run for run in runs if run.part == 0 and len(run) >= FEWEST_ROWS]
    if len(whole) < FEWEST_RUNS:
        return []
    noise = np.stack([_measure_noise(run) for run in whole])
    reach = np.stack([np.ptp(run.measured, axis=0) for run in whole])
    if not outputs or not (noise > 0.0).all():
        return []
    usual = np.median(noise, axis=0)
    notes = []
    for i, run in enumerate(whole):
        others = np.delete(np.arange(len(whole)), i)
        ratios = noise[i] / usual
        for k, name in enumerate(outputs):
            elsewhere = noise[others, k]
            agree = float(elsewhere.max()) < ALIKE * float(elsewhere.min())
            beside = np.append(np.delete(ratios, k), 1.0)
            factor = float(noise[i, k] / np.median(elsewhere))
            stands_out = factor > LOUDER * beside.max() or factor < beside.min() / LOUDER
            if not (agree and stands_out):
                continue
            wider = float(reach[i, k] / np.median(reach[others, k]))
            same_way = wider > factor**OF_RANGE if factor > 1.0 else wider < factor**OF_RANGE
            if same_way:
                rows = (0, len(run) - 1)
                notes.append(DataNote(run.group, name, rows, *tell_gain(factor, "the column")))
    return notes


def _measure_noise(run: Run) -> Array:
    """Return the usual size [K] of the second differences of what is measured."""
    return np.asarray(np.median(np.abs(np.diff(run.measured, n=2, axis=0)), axis=0))
