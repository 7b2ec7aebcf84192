"""Time between steps with a variable step: in whole microseconds, limited below 2**61."""

import numpy as np

from zerodrift.base.arrays import IntArray, Mask
from zerodrift.operations.arithmetic import INT32_MAX

LONGEST_US = 2**61
"""73,000 years: a longer time counts as this one, so that sums of a few fit 64 bits."""
US_PER_S = 1e6
"""Microseconds in a second."""
MOST_HELD_US = 2**32 - 1
"""Over a longer time no rate is told."""
_POWERS = np.int64(1) << np.arange(63, dtype=np.int64)


def count_us(period_s: float) -> int:
    """Return a period in whole microseconds, 1 at least."""
    return max(round(period_s * US_PER_S), 1)


def hold_time(time_us: IntArray) -> IntArray:
    """Return times that were handed over as 64 bits without a sign, none above `LONGEST_US`."""
    return np.where(time_us < 0, LONGEST_US, np.minimum(time_us, LONGEST_US))


def count_bits(x: IntArray) -> IntArray:
    """Return the bits of whole numbers from 0 on: 0 of 0, n of 2**(n - 1) .. 2**n - 1."""
    return np.asarray(np.searchsorted(_POWERS, x, side="right"), dtype=np.int64)


def exceeds_rate(change: IntArray, rate_max: int, span_us: IntArray, period_us: int) -> Mask:
    """Return where a change is larger than `rate_max` in each period of a span.

    A span shorter than a period counts as one, since codes are whole numbers; for spans of 2**32 us
    and more the result is always false.

    Args:
        change: [B] of the code; 2**31 - 1 and more count as that.
        rate_max: codes in a period, 0 .. 2**31 - 1.
        span_us: [B] 0 .. 2**61.
        period_us: 1 .. 2**32 - 1.
    """
    held = np.clip(span_us, period_us, MOST_HELD_US)
    moved = np.minimum(np.abs(change), INT32_MAX)
    return np.asarray((moved * period_us > rate_max * held) & (span_us <= MOST_HELD_US))
