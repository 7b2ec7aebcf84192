"""Test runs that are training runs again: shifted by part of a row, or with noise on top.

Two recordings have no noise in common. What fast noise a test run shares with a training run is
found at any shift by the correlation of what their channels hold beyond their own signals, of all
channels together, and held against the largest that chance gives over all shifts and pairs. Noise
that the outputs share is a recording's own. Sensors in one oven, recorded at once, share that of
their thermometer, loads and supply, and runs of one programme may share the steps of a coarse
thermometer: of two such runs the outputs must also take the same course, and differ by no more
noise than the test run has itself. Of two independent runs it is the noise of both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from zerodrift.base.arrays import Array
from zerodrift.dataset.outliers import NORMAL_OF_MAD
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote

CHANCE = 1e-6
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
COURSE = 1e-6
"""Probability that the courses of a run and of its copy with white noise added are told apart."""
LEAST = 0.01
"""Least share of two runs' noise that their overlap must hold, as the product of both shares."""
STRETCHES = 24
"""Stretches into which the rows that two runs share are cut, to compare the courses of outputs."""
REACH = 2
"""Rows before and after one from which resampling takes it."""


@dataclass(frozen=True)
class RunNoise:
    """What is fast in a run's channels; None of a channel that has no noise of its own."""

    outputs: tuple[Array | None, ...]
    """[n - 2] of each output, without what goes with the other channels."""
    beside: tuple[Array | None, ...]
    """[n - 2] of thermometer, references and other inputs; of a coarse thermometer its steps."""


def find_leaks(train: Sequence[Run], test: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on test runs whose noise is that of a training run."""
    known = [(run, _list_noise(run)) for run in train if len(run) >= FEWEST_ROWS]
    asked = [(run, _list_noise(run)) for run in test if len(run) >= FEWEST_ROWS]
    tests = max(1, 2 * len(known) * len(asked))
    notes = []
    for run, ours in asked:
        for other, theirs in known:
            told = _compare(run, other, ours, theirs, tests)
            if told is None:
                continue
            text, shift, k = told
            when = f"{abs(shift)} rows {'later' if shift >= 0 else 'earlier'}"
            text = (
                f"{text.format(other=other.group, when=when)}: "
                "the same recording, resampled or with noise added. Test with another run"
            )
            notes.append(DataNote(run.group, outputs[k], (0, len(run) - 1), "leak", text))
            break
    return notes


def _compare(
    run: Run, other: Run, ours: RunNoise, theirs: RunNoise, tests: int
) -> tuple[str, int, int] | None:
    """Return what is told of two runs, their shift in rows, and the output; None: independent."""
    pairs = _pair(ours.outputs, theirs.outputs)
    found = _correlate(list(pairs.values()), tests) if pairs else None
    if found is not None:
        shared = f"{100.0 * found[0]:.0f} % correlated"
        text = f"its noise is that of training run {{other}} ({shared}, {{when}})"
        return text, found[1], next(iter(pairs))
    beside = _pair(ours.beside, theirs.beside)
    found = _correlate(list(beside.values()), tests) if beside else None
    if found is None or not _take_one_course(run, other, found[1]):
        return None
    text = (
        "the noise of its thermometers, loads and inputs is that of training run {other} ({when}), "
        "from which its outputs differ by noise alone"
    )
    return text, found[1], 0


def _pair(
    ours: Sequence[Array | None], theirs: Sequence[Array | None]
) -> dict[int, tuple[Array, Array]]:
    both = enumerate(zip(ours, theirs, strict=True))
    return {i: (one, two) for i, (one, two) in both if one is not None and two is not None}


def _take_one_course(run: Run, other: Run, shift: int) -> bool:
    """Return whether all outputs of two runs differ by fast noise alone, and one of them moves.

    The other run is resampled as suits best: rows near by may stand in. What it leaves of an output
    is noise if its means over stretches are as small as its fast part says, and tells something if
    the output's own means are not.

    Args:
        shift: rows by which `run` is later within `other`'s.
    """
    first, last = max(shift, 0), min(len(other) + shift, len(run))
    rows = np.arange(first + REACH, last - REACH)
    moves = False
    for ours, theirs in zip(run.measured.T, other.measured.T, strict=True):
        y, x = ours[rows], theirs[rows - shift]
        near = [theirs[rows - shift + k] - x for k in range(-REACH, REACH + 1) if k]
        left = _take_off(y - x, np.stack(near, axis=1))
        limit = _bound_means(left)
        error = np.sqrt(INFLATION / rows.size)
        if _measure_course(left) > limit or _spread(left) > (1.0 + 3.0 * error) * _spread(y):
            return False
        moves |= _measure_course(y - np.median(y)) > limit
    return bool(moves)


def _measure_course(x: Array) -> float:
    """Return how large a signal's means over stretches are: the median of their sizes."""
    means = [float(part.mean()) for part in np.array_split(x, STRETCHES)]
    return float(np.median(np.abs(means)))


def _bound_means(noise: Array) -> float:
    """Return what `_measure_course` of white noise is below, from its second differences."""
    size = _spread(noise) / np.sqrt(noise.size / STRETCHES)
    # The median of so many sizes |N(0, 1)| has this mean and standard error.
    middle = float(norm.ppf(0.75))
    error = 0.5 / (2.0 * float(norm.pdf(middle)) * np.sqrt(STRETCHES))
    return float(size * (middle + float(norm.isf(COURSE)) * error))


def _spread(x: Array) -> float:
    """Return the standard deviation of the white noise in a signal."""
    return float(NORMAL_OF_MAD * np.median(np.abs(np.diff(x, 2))) / np.sqrt(6.0))


def _list_noise(run: Run) -> RunNoise:
    """Return the noise of each channel of a run."""
    inputs = [x for name, x in run.inputs.items() if name != "clock"]
    signals = [run.temperature_degC, *run.reference.T, *inputs]
    moving = [np.diff(x, 2) for x in signals if float(np.ptp(x)) > 0.0]
    table = np.stack(moving, axis=1) if moving else np.zeros((len(run) - 2, 0))
    outputs = []
    for column in np.diff(run.steady_drift, 2, axis=0).T:
        left = _take_off(column, table) if table.shape[1] else column
        outputs.append(_cut(left, float(np.abs(column).max())))
    changes = [np.diff(x, 2) for x in signals]
    beside = [_cut(x, float(np.abs(x).max())) for x in changes]
    if beside[0] is None and np.any(changes[0]):
        # The rows at which a coarse thermometer steps are its noise: no oven repeats them.
        beside[0] = np.sign(changes[0])
    return RunNoise(tuple(outputs), tuple(beside))


def _cut(noise: Array, largest: float) -> Array | None:
    """Return noise without its tails and its mean; None where it is no more than rounding."""
    spread = NORMAL_OF_MAD * float(np.median(np.abs(noise - np.median(noise))))
    if spread <= 1e-9 * max(largest, 1e-300):
        return None
    cut = np.clip(noise, -CLIPPED * spread, CLIPPED * spread)
    return np.asarray(cut - cut.mean())


def _take_off(x: Array, table: Array) -> Array:
    factors = np.linalg.lstsq(table, x, rcond=None)[0]
    return np.asarray(x - table @ factors)


def _correlate(pairs: Sequence[tuple[Array, Array]], tests: int) -> tuple[float, int] | None:
    """Return the mean correlation at the best shift, and the shift; None where chance explains it.

    Args:
        pairs: a channel's noise in both runs, [n] and [m], of each channel.
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
    shifts = max(int(usable.sum()), 1)
    expected = float(norm.isf(1.0 / (shifts + 1)))

    def measure_chance(heights: Array) -> float:
        """Return how large chance is here, at least 1, that of white noise.

        What comes again at other shifts, days or a meter's cycle, is no copy: their highest shows.
        """
        elsewhere = np.roll(heights, -int(heights.argmax()))[BESIDE:-BESIDE]
        return max(1.0, float(elsewhere.max(initial=0.0)) / expected)

    likeness, heights, weights = np.zeros(size), np.zeros(size), 0.0
    for one, two in pairs:
        powers = total(one**2, theirs) * total(ours, two**2)
        enough = usable & (powers > LEAST * np.sum(one**2) * np.sum(two**2))
        like = np.where(enough, total(one, two) / np.sqrt(np.where(enough, powers, 1.0)), 0.0)
        # Rows at which a channel stands still say nothing.
        moving = float(np.sqrt(np.mean(one != 0.0) * np.mean(two != 0.0)))
        own = like * np.sqrt(moving * np.maximum(counts, 0.0) / INFLATION)
        # Of a copy each channel would show so much; the best sum weighs them by that.
        chance = measure_chance(own)
        weight = np.sqrt(moving) / chance
        likeness += like / len(pairs)
        heights += weight * own / chance
        weights += weight**2
    heights /= np.sqrt(max(weights, 1e-300))
    heights /= measure_chance(heights)
    place = int(heights.argmax())
    if heights[place] <= norm.isf(CHANCE / tests / shifts):
        return None
    return float(likeness[place]), place if place < size // 2 else place - size
