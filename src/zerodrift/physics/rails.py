"""Samples at which a converter stood at its rail, where the measured extreme repeats exactly."""

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.resolution import LEAST_SHARE, count_codes, measure_code

FEWEST_SAMPLES = 5
"""Samples at the extreme within a run before it counts as a rail."""
RESOLVED = 0.2
"""Where more than this share of the samples are little peaks or dips, noise is resolved."""
PILED = 3.0
"""There the extreme must be met this many times more often than any value next to it."""
NEIGHBOURS = 4
"""Values next to the extreme, and codes, with which it is compared there."""
RARITY = 5.0
"""The extreme must last, or be met, this many times longer than any other value."""
FEWEST_VISITS = 20
"""Short stands at the extreme that make a rail together."""


def find_rails(measured: Array, reference: Array) -> Array:
    """Return 1.0 where the measured value stands at a rail, else 0.0.

    Args:
        measured: [n] one output of one run.
        reference: [n] its true load.

    Limits: with noise, a value that is not clipped hardly ever repeats its exact extreme. In a log
        of few distinct values every value lasts, and the extreme must last much longer to count.
        Where no load moves, the drift may stay at the end of its range; there the extreme must
        occur much more often than the neighbouring values, over which noise would spread it. Rows
        between two samples of a coarse converter are mixtures of two codes: there the codes count.
    """
    measured, reference = np.ascontiguousarray(measured), np.ascontiguousarray(reference)
    flags = np.zeros(measured.size)
    spread = float(np.ptp(measured))
    if spread == 0.0:
        return flags
    same = 1e-7 * spread
    ends = [measured >= float(measured.max()) - same, measured <= float(measured.min()) + same]
    if max(np.count_nonzero(standing) for standing in ends) < FEWEST_SAMPLES:
        return flags
    between = ~(ends[0] | ends[1])
    resolved = _is_resolved(measured, between, same)
    still = float(np.ptp(reference)) <= measure_code(measured)
    if still and not resolved:
        return flags
    many = np.count_nonzero(~between) >= LEAST_SHARE * measured.size
    if still and many and min(map(np.count_nonzero, ends)) >= FEWEST_SAMPLES:
        return flags  # two codes of a coarse converter: no drift goes from rail to rail
    lasts = None if still else _measure_stands(np.abs(np.diff(measured)) <= same)
    elsewhere = 1.0 if lasts is None else float(lasts[between].max(initial=1.0))
    for sign, standing in zip((1.0, -1.0), ends, strict=True):
        height = sign * measured
        count = int(standing.sum())
        if count < FEWEST_SAMPLES:
            continue
        if resolved and count >= PILED * _count_next(height, between):
            flags[standing] = 1.0
            continue
        if still:
            continue
        longest = _longest(standing)
        if longest >= max(FEWEST_SAMPLES, RARITY * elsewhere):
            flags[standing] = 1.0
            continue
        # Short peaks that are cut, as in walking: one value is met again and again.
        near = np.round(height[(height >= float(height.max()) - 0.1 * spread) & between] / same)
        most = int(np.unique(near, return_counts=True)[1].max(initial=0))
        if count >= max(FEWEST_VISITS, RARITY * most) and float(np.ptp(reference[standing])) > 0.0:
            flags[standing] = 1.0
    return flags


def bridge(x: Array, flags: Array) -> Array:
    """Return x with straight lines across the flagged samples, so that these have no weight.

    Args:
        x: [n].
        flags: [n] 1.0 where x is to be bridged.
    """
    kept = np.flatnonzero(flags == 0.0)
    if kept.size in (0, x.size):
        return x
    return np.interp(np.arange(x.size), kept, x[kept])


def _is_resolved(measured: Array, between: Mask, same: float) -> bool:
    """Return whether noise, and not a trend alone, moves samples from one value to another."""
    step = np.where(np.abs(np.diff(measured)) > same, np.diff(measured), 0.0)
    turns = (step[1:] * step[:-1] < 0.0)[between[2:] & between[1:-1] & between[:-2]]
    return turns.size > 0 and float(turns.mean()) > RESOLVED


def _count_next(height: Array, between: Mask) -> int:
    """Return how often the most frequent value or code next to the extreme is met."""
    if not between.any():
        return 1
    _, counts, recurring = count_codes(height[between])
    return int(max(counts[-NEIGHBOURS:].max(), counts[recurring][-NEIGHBOURS:].max(initial=1)))


def _measure_stands(unchanged: Mask) -> Array:
    """Return for each sample how many samples its unbroken stand lasts, [n] from [n - 1] steps."""
    starts = np.concatenate([[0], np.flatnonzero(~unchanged) + 1])
    lengths = np.diff(np.concatenate([starts, [unchanged.size + 1]]))
    return np.repeat(lengths, lengths).astype(np.float64)


def _longest(standing: Mask) -> int:
    """Return the length of the longest unbroken stand."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], standing.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))
