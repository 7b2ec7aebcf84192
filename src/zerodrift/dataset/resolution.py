"""The step in which a column's values are written: a converter's code, or its last digit."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask

DIGITS = 1e-8
"""What is smaller than this share of a value is its arithmetic's, not the sensor's."""
MOST_DIGITS = 7
"""More digits than this are as good as all of them."""
BLOCK = 256
"""Samples that are looked at together."""
BLOCKS = 16
RECURRING, LEAST_SHARE = 3, 0.2
"""A code recurs that many times, and codes that recur are this share of a coarse log."""
BY_CHANCE = 0.02
"""What recurs less often than this share of the commonest value is a mixture met by chance."""


def measure_step(values: Array) -> float:
    """Return the step of which all values are multiples, one from the next; 0 where there is none.

    Decimal digits, a converter's step and single precision all count as steps.
    """
    sorted_values = np.unique(values)
    gaps = np.unique(np.diff(sorted_values))
    if gaps.size == 0:
        return 0.0
    largest = float(np.abs(sorted_values[[0, -1]]).max())
    decimal = _measure_decimals(sorted_values, largest)
    step = float(gaps[0])
    single = sorted_values.astype(np.float32)
    for _ in range(40):
        if step < DIGITS * largest:
            break
        times = np.rint(gaps / step)
        rest = np.abs(gaps - step * times)
        # What is left of a gap, beyond what double precision makes of the step so many times.
        rest = rest[rest > np.maximum(1e-3 * step, 1e-15 * largest * (1 + times))]
        if rest.size == 0:
            return max(step, decimal)
        step = float(rest.min())
    if np.all(single == sorted_values):
        return max(float(np.spacing(np.abs(single).max())), decimal)
    return decimal


def _measure_decimals(values: Array, largest: float) -> float:
    """Return the power of ten of which all values are multiples; 0 where there is none."""
    for digits in range(10):
        scaled = values * 10.0**digits
        if 10.0**-digits < DIGITS * largest:
            break
        if np.all(np.abs(scaled - np.rint(scaled)) <= 1e-15 * largest * 10.0**digits):
            return 10.0**-digits
    return 0.0


def count_codes(values: Array) -> tuple[Array, NDArray[np.intp], Mask]:
    """Return the different values [m] in order, how often each is met, and whether it is a code.

    A code recurs. Rows between two samples are mixtures of two codes and seldom do.
    """
    ordered = np.sort(values)
    # A mixture of two equal codes is off by the last bits of its arithmetic.
    apart = np.diff(ordered) > 1e-4 * DIGITS * float(np.abs(values).max(initial=0.0))
    starts = np.flatnonzero(np.append(True, apart))
    counts = np.diff(np.append(starts, values.size))
    return ordered[starts], counts, counts >= max(RECURRING, BY_CHANCE * counts.max())


def measure_code(values: Array) -> float:
    """Return the least distance of values [n] that recur: a coarse converter's step, or 0.

    A column that rests between two codes shows no more of its step than this.
    """
    levels, counts, _ = count_codes(values)
    codes = levels[counts >= RECURRING]
    return float(np.diff(codes).min()) if codes.size > 1 else 0.0


def measure_resolution(values: Array) -> float:
    """Return the step of a coarse converter, of which the values [n] that recur are multiples.

    0 where few values recur, so that the step is small beside the noise, or where what recurs are
    multiples of nothing.
    """
    levels, counts, recurring = count_codes(values)
    if counts[recurring].sum() < LEAST_SHARE * values.size:
        return 0.0
    # A converter's rails are no two codes side by side.
    inside = recurring.copy()
    inside[[0, -1]] = False
    if inside.sum() >= 2:
        return measure_step(levels[inside])
    gaps = np.diff(levels[recurring])
    if inside.any() and gaps.size == 2 and abs(gaps[1] - gaps[0]) <= 1e-3 * gaps[0]:
        return float(gaps.min())
    return 0.0


def list_blocks(values: Array, width: int) -> list[Array]:
    """Return parts of a column, evenly over its length, of so many samples."""
    apart = max(width, values.size // BLOCKS)
    return [values[start : start + width] for start in range(0, values.size, apart)]


def find_steps(values: Array) -> Array:
    """Return [n] the step in which each value is written, where digits are counted from the first.

    Otherwise [1], the coarsest step of any part.
    """
    blocks = [block for block in list_blocks(values, BLOCK) if block.size > 1]
    found = [step for block in blocks if (step := measure_step(block)) > 0]
    digits = max(_count_digits(block) for block in blocks)
    if digits > MOST_DIGITS or not found:
        return np.array([max(found, default=0.0)])
    first = np.floor(np.log10(np.maximum(np.abs(values), 1e-300)))
    return np.maximum(10.0 ** (first + 1 - digits), min(found))


def _count_digits(values: Array) -> int:
    """Return with how many digits, counted from the first that is not 0, all values are written."""
    some = values[values != 0]
    first = np.floor(np.log10(np.abs(some)))
    for digits in range(1, MOST_DIGITS + 1):
        steps = 10.0 ** (first + 1 - digits)
        if np.all(np.abs(some / steps - np.rint(some / steps)) < 1e-9 * 10.0**digits):
            return digits
    return MOST_DIGITS + 1
