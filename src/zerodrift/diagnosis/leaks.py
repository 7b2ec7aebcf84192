"""Test runs that are training runs again: shifted by part of a row, or with noise on top.

Two recordings have no noise in common. What fast noise a test run shares with a training run is
found at any shift by the correlation of what their outputs hold beyond their own signals, of all
outputs together, and held against the largest that chance gives over all shifts and pairs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote

Array = NDArray[np.float64]

CHANCE = 1e-9
"""Probability that any pair of independent runs is told, over all comparisons made."""
INFLATION = 70.0 / 36.0
"""Variance of a correlation of second differences of white noise, times n (Bartlett 1946: the sum
of the squares of their autocorrelation, 1, -2/3, 1/6)."""
CLIPPED = 3.0
"""Spreads at which a value is cut: what steps of one programme have in common counts little."""
FEWEST_ROWS = 200
BESIDE = 5
"""Shifts on each side of the best one that belong to it: a copy resampled has a wide peak."""
OVERLAP = 0.5
"""Share of the shorter run's rows in which the two must overlap."""


def find_leaks(train: Sequence[Run], test: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on test runs whose noise is that of a training run."""
    known = [(run, _list_noise(run)) for run in train if len(run) >= FEWEST_ROWS]
    asked = [(run, _list_noise(run)) for run in test if len(run) >= FEWEST_ROWS]
    tests = max(1, len(known) * len(asked))
    notes = []
    for run, ours in asked:
        for other, theirs in known:
            pairs = {
                name: (one, two)
                for name, one, two in zip(outputs, ours, theirs, strict=True)
                if one is not None and two is not None
            }
            found = _correlate(list(pairs.values()), tests) if pairs else None
            if found is None:
                continue
            shared, shift = found
            notes.append(
                DataNote(
                    run.group,
                    next(iter(pairs)),
                    (0, len(run) - 1),
                    "leak",
                    f"its noise is that of training run {other.group} ({100.0 * shared:.0f} % "
                    f"correlated, {abs(shift)} rows {'later' if shift >= 0 else 'earlier'}): "
                    "the same recording, resampled or with noise added. Test with another run",
                )
            )
            break
    return notes


def _list_noise(run: Run) -> list[Array | None]:
    """Return the noise of each output, [n - 2] each; None where one has none.

    A thermometer's says nothing: sensors in one oven, recorded at once, share it.
    """
    signals = [*run.reference.T, *(x for name, x in run.inputs.items() if name != "clock")]
    signals.append(run.temperature_degC)
    moving = [np.diff(x, 2) for x in signals if float(np.ptp(x)) > 0.0]
    table = np.stack(moving, axis=1) if moving else np.zeros((len(run) - 2, 0))
    found: list[Array | None] = []
    for column in np.diff(run.steady_drift, 2, axis=0).T:
        left = _take_off(column, table) if table.shape[1] else column
        spread = 1.4826 * float(np.median(np.abs(left - np.median(left))))
        if spread <= 1e-9 * max(float(np.abs(column).max()), 1e-300):
            found.append(None)
            continue
        cut = np.clip(left, -CLIPPED * spread, CLIPPED * spread)
        found.append(cut - cut.mean())
    return found


def _take_off(x: Array, table: Array) -> Array:
    factors = np.linalg.lstsq(table, x, rcond=None)[0]
    return np.asarray(x - table @ factors)


def _correlate(pairs: Sequence[tuple[Array, Array]], tests: int) -> tuple[float, int] | None:
    """Return the mean correlation at the best shift, and the shift; None where chance explains it.

    Args:
        pairs: an output's noise in both runs, [n] and [m], of each output.
        tests: how many pairs of runs are asked.
    """
    n, m = pairs[0][0].size, pairs[0][1].size
    size = 1 << int(np.ceil(np.log2(n + m)))

    def total(x: Array, y: Array) -> Array:
        """Return the sums of the products over the overlap, at every shift."""
        return np.asarray(np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size))

    ours, theirs = np.ones(n), np.ones(m)
    counts = total(ours, theirs)
    usable = counts > OVERLAP * min(n, m)
    likeness = np.zeros(size)
    for one, two in pairs:
        powers = total(one**2, theirs) * total(ours, two**2)
        likeness += np.where(usable, total(one, two) / np.sqrt(np.maximum(powers, 1e-300)), 0.0)
    likeness /= len(pairs)
    shifts = max(int(usable.sum()), 1)
    heights = likeness * np.sqrt(len(pairs) * np.maximum(counts, 0.0) / INFLATION)
    place = int(heights.argmax())
    # What comes again at other shifts, days or a meter's cycle, is no copy: their highest shows
    # how large chance is here, at least that of white noise.
    elsewhere = np.roll(heights, -place)[BESIDE:-BESIDE]
    chance = max(1.0, float(elsewhere.max(initial=0.0)) / float(norm.isf(1.0 / (shifts + 1))))
    if heights[place] <= norm.isf(CHANCE / tests / shifts) * chance:
        return None
    return float(likeness[place]), place if place < size // 2 else place - size
