"""Outlier rows: samples far off from their neighbours, which are weighted and not deleted.

A wild sample (a spike of a logger, a burst of a radio) lies many times the noise off from the
samples before and behind it, and nothing that was logged moves with it. Least squares would give it
far too much weight; here its weight is between 0 and 1, and a fit reads in its place a mixture of
the measured value and that of its neighbours. With such pseudo-values least squares is the
M-estimate of a redescending psi, whatever transform of the samples the squares are taken in.

Source: P. J. Huber, Robust Statistics (1981), 7.8 (modified residuals); F. R. Hampel et al.,
Robust Statistics (1986), 2.6 (redescending psi).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask, find_median, find_quantile

WHOLE, NOTHING = 6.0, 10.0
"""Distances from the neighbours, in spreads of such distances, up to which a sample has its whole
weight and from which it has none; linear between them."""
COUNTED = 0.5
"""Samples below this weight are counted as outliers."""
FEWEST_SAMPLES = 24
"""A shorter stretch does not show what its noise is."""
NEIGHBOURS = 9
"""Samples whose median tells what one of them should be, itself included."""
NEARBY = 129
"""Samples over which the spread may change: a noisier stretch of time is no outlier."""
NORMAL_OF_MAD = 1.4826
"""Standard deviation of normal values over their median absolute deviation."""
LINE = 7
"""Samples on one side through which a straight line is laid."""
"""Standard deviation of normal noise over its median absolute value."""
OF_DISTANCE = 1.8
"""The same for its distance from the median of nine, which is one of the nine now and then."""
EVENT = 8.0
"""A signal jumps where it moves this many times its usual step."""
MOST_EVENTS = 3000
"""Rows with the largest jumps, from which it is read what follows the signals at once."""
LAGS = (-2, -1, 0, 1, 2)
"""Samples by which what follows a signal may be early or late."""
OFTENER = 3.0
"""Samples near jumps stand out for cause if they do so this many times more often than others."""
FEWEST_CAUSED = 4
LATTICE = 0.25
"""Distinct values per sample below which a log shows the steps of a converter."""
USUAL_AT_JUMPS = 0.95
"""Share of the samples near jumps that shows what jumps do to the output there."""
ORDINARY = 0.97
"""Share of the samples that shows a coarse converter's noise."""
ROUNDS = 8
"""Of the robust regression."""
FEW_ROWS = 50
"""A window for each of the rows costs less than one that slides, where at most one in so many
counts."""


@dataclass(frozen=True)
class Outliers:
    """The weights of a stretch's samples, and what to read in place of the light ones."""

    weights: Array
    """[n, K] from 0 to 1."""
    drift: Array
    """[n, K] measured minus reference where the weight is 1; else mixed with the neighbours'
    value."""

    @property
    def rows(self) -> Mask:
        """[n] rows with an outlier in some output."""
        return np.asarray((self.weights < COUNTED).any(axis=1))


def weigh_samples(
    drift: Array,
    temperature_degC: Array,
    reference: Array,
    inputs: Mapping[str, Array],
    resolution: Array | None = None,
) -> Outliers | None:
    """Return the weights of a stretch's samples; None where all of them are 1.

    Args:
        drift: [n, K] measured minus reference.
        temperature_degC: [n].
        reference: [n, K].
        inputs: name -> [n].
        resolution: [K] the step in which each output was measured, in its unit; None: unknown, 0.

    Limits: up to four of nine neighbouring samples may be wild; a longer burst is a disturbance,
    and stays. A pulse of up to four samples that no logged signal explains counts as wild.
    """
    rows, outputs = drift.shape
    if rows < FEWEST_SAMPLES:
        return None
    weights, mixed = np.ones_like(drift), drift
    signals, near = np.zeros((rows, 0)), np.zeros(rows, dtype=np.bool_)
    regression: _Regression | None = None
    steps = np.zeros(outputs) if resolution is None else resolution
    for k in range(outputs):
        x = np.ascontiguousarray(drift[:, k])
        weight, expected = _measure_distance(x, steps[k])
        if not (weight < 1.0).any():
            # So it is with most logs, and this costs little.
            continue
        if signals.shape[1] == 0:
            signals = _list_signals(temperature_degC, reference, inputs)
            near = _find_jumps(signals)
        if 2 * near.sum() > rows or _stands_out_at(near, weight):
            regression = regression or _prepare(signals)
            at_once = _follow(x, signals, regression)
            weight, expected = _measure_distance(x - at_once, steps[k])
            if _stands_out_at(near, weight):
                # Jumps are usual there; only samples far beyond them are wild.
                there = np.abs(x - at_once - expected)[near]
                usual = there / max(float(np.quantile(there, USUAL_AT_JUMPS)), 1e-300)
                weight[near] = np.maximum(weight[near], _weigh(usual))
            expected = expected + at_once
        light = weight < 1.0
        if light.any():
            if mixed is drift:
                mixed = drift.copy()
            weights[:, k] = weight
            mixed[light, k] = (weight * x + (1.0 - weight) * expected)[light]
    return None if mixed is drift else Outliers(weights, mixed)


def take_medians(x: Array) -> Array:
    """Return the median [n] of each sample and its neighbours: one of the measured values."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(x, NEIGHBOURS, mode="mirror"))


def _measure_distance(x: Array, step: float) -> tuple[Array, Array]:
    """Return the weight [n] of each sample by its distance from its neighbours, and their median.

    A sample is off by half a step before it is off by anything.

    A bend, a peak and the end of a trend are no outliers: one side's straight line leads there.
    """
    middle = take_medians(x)
    distance = np.abs(x - middle)
    spread = _measure_spread(x, distance)
    if spread == 0.0:
        return np.ones_like(x), middle
    least = max(spread, 0.5 * step)
    far = distance / least
    light = np.flatnonzero(far > WHOLE)
    if light.size:
        # What is near by the least spread is near by any larger one.
        usual = np.maximum(OF_DISTANCE * _take_nearby(distance, light), least)
        off = np.minimum(_measure_beyond(x, light), _measure_beyond(x[::-1], x.size - 1 - light))
        far[light] = np.minimum(distance[light], off) / usual
    return _weigh(far), middle


def _take_nearby(distance: Array, rows: IntArray) -> Array:
    """Return the medians [m] of the distances [n] around some samples."""
    from scipy.ndimage import median_filter

    length = min(NEARBY, distance.size | 1)
    if rows.size * FEW_ROWS > distance.size:
        return np.asarray(median_filter(distance, length, mode="mirror")[rows])
    half = length // 2
    padded = np.pad(distance, half, mode="reflect")
    windows = padded[rows[:, None] + np.arange(length)]
    return np.asarray(np.partition(windows, half, axis=1)[:, half])


def _measure_beyond(x: Array, rows: IntArray) -> Array:
    """Return how far [m] some samples lie from straight lines through those before them.

    The lines are Theil and Sen's, which two wild samples of seven do not move; what is too near
    the beginning for a line is infinitely far.
    """
    off = np.full(rows.size, np.inf)
    inside = rows >= LINE
    before = x[rows[inside, None] - np.arange(LINE, 0, -1)]
    early, late = np.triu_indices(LINE, 1)
    slope = np.median((before[:, late] - before[:, early]) / (late - early), axis=1)
    # Each sample carried on along the slope to where the line is asked for.
    carried = before + slope[:, None] * np.arange(LINE, 0, -1)
    off[inside] = np.abs(x[rows[inside]] - np.median(carried, axis=1))
    return off


def _weigh(far: Array) -> Array:
    """Return the weights of samples so many spreads from their neighbours."""
    return np.clip((NOTHING - far) / (NOTHING - WHOLE), 0.0, 1.0)


def _measure_spread(x: Array, distance: Array) -> float:
    """Return the usual distance of a sample from its neighbours' median; 0 where x is at rest."""
    steps = np.abs(np.diff(x))
    moves = steps > 1e-9 * float(np.ptp(x))
    if not moves.any():
        return 0.0
    spread = OF_DISTANCE * find_median(distance)
    ordered = np.sort(x)
    if 1 + np.count_nonzero(ordered[1:] != ordered[:-1]) < LATTICE * x.size:
        # A coarse converter rests on one value: half its step is the least that it can be off,
        # and medians of few values say little.
        usual = distance[distance <= find_quantile(distance, ORDINARY)]
        least = 0.5 * find_quantile(steps[moves], 0.01)
        return max(spread, least, float(np.sqrt(np.mean(usual**2))))
    # What stands still, at a rail or in a gap that was filled, shows no noise.
    moving = distance[1:-1][moves[1:] & moves[:-1]]
    return max(spread, OF_DISTANCE * find_median(moving) if moving.size else 0.0)


def _list_signals(temperature_degC: Array, reference: Array, inputs: Mapping[str, Array]) -> Array:
    """Return what may move an output at once, [n, S], in units of each one's usual step."""
    columns = [temperature_degC, *reference.T, *inputs.values()]
    centred = reference - reference.mean(axis=0)
    warm = temperature_degC - temperature_degC.mean()
    columns += [*(centred**2).T, *(centred * warm[:, None]).T]
    scaled = []
    for column in columns:
        steps = np.abs(np.diff(column))
        size = float(np.sqrt(np.mean(steps**2)))
        if size > 0.0 and np.isfinite(size):
            scaled.append((column - column.mean()) / size)
    return np.stack(scaled, axis=1) if scaled else np.zeros((temperature_degC.size, 0))


def find_jumps(temperature_degC: Array, reference: Array, inputs: Mapping[str, Array]) -> Mask:
    """Return the rows [n] next to which a logged signal jumps."""
    signals = _list_signals(temperature_degC, reference, inputs)
    if signals.shape[1] == 0:
        return np.zeros(temperature_degC.size, dtype=np.bool_)
    return _find_jumps(signals)


def _find_jumps(signals: Array) -> Mask:
    """Return the rows [n] next to which a signal jumps."""
    steps = np.abs(np.diff(signals, axis=0))
    usual = NORMAL_OF_MAD * np.median(steps, axis=0)
    jumps = (steps > np.maximum(EVENT * usual, 1e-3)).any(axis=1)
    near = np.concatenate([jumps, [False]]) | np.concatenate([[False], jumps])
    reach = 2 * max(LAGS) + 1
    return np.asarray(np.convolve(near, np.ones(reach), mode="same") > 0.5)


@dataclass(frozen=True)
class _Regression:
    """The regression of steps on the signals' steps: the same for every output of a stretch."""

    rows: IntArray
    """[R] the steps with the largest jumps."""
    design: Array
    """[R, P] the signals' steps there, at each lag."""
    gram: Array
    """[P, P] with every row at its whole weight, and a ridge."""


def _prepare(signals: Array) -> _Regression:
    """Return the regression of what follows the signals [n, S]."""
    steps = np.diff(signals, axis=0)
    size = np.abs(steps).max(axis=1, initial=0.0)
    edge = max(LAGS)
    usable = np.arange(edge, size.size - edge)
    rows = usable[np.argsort(-size[usable], kind="stable")[:MOST_EVENTS]]
    design = np.concatenate([steps[rows - lag] for lag in LAGS], axis=1)
    ridge = 1e-6 * np.eye(design.shape[1]) * np.mean(design**2) * rows.size if design.size else 0.0
    return _Regression(rows, design, design.T @ design + ridge)


def _follow(x: Array, signals: Array, regression: _Regression) -> Array:
    """Return what of x [n] follows the signals [n, S] at once, by a robust regression of steps."""
    rows, design = regression.rows, regression.design
    if signals.shape[1] == 0 or rows.size < 2 * design.shape[1]:
        return np.zeros_like(x)
    target = np.diff(x)[rows]
    right = design.T @ target
    factors = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        left = np.abs(target - design @ factors)
        usual = max(
            NORMAL_OF_MAD * float(np.median(left)), 1e-12 * float(np.abs(x).max(initial=0.0))
        )
        if usual == 0.0:
            break
        # Most rows have their whole weight: only what the others lack is taken off.
        light = np.flatnonzero(left > 1.5 * usual)
        lacking = design[light] * (1.0 - 1.5 * usual / left[light])[:, None]
        gram = regression.gram - lacking.T @ design[light]
        factors = np.asarray(np.linalg.solve(gram, right - lacking.T @ target[light]), dtype=float)
    followed = np.zeros_like(x)
    every = np.arange(x.size)
    for lag, part in zip(LAGS, np.split(factors, len(LAGS)), strict=True):
        # Before a log and behind it signals stand still.
        followed += (signals @ part)[np.clip(every - lag, 0, x.size - 1)]
    return followed


def _stands_out_at(near: Mask, weight: Array) -> bool:
    """Return whether it is at jumps of the signals that samples stand out, so not by chance."""
    light = weight < 1.0
    caused, others = int((light & near).sum()), int((light & ~near).sum())
    elsewhere = max(int((~near).sum()), 1)
    return bool(caused >= max(FEWEST_CAUSED, OFTENER * near.sum() * others / elsewhere))
