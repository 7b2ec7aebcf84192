"""Delay by a fixed time, also by a fraction of a sample."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def delay_taps(sample_period_s: float, delay_s: float) -> tuple[int, float]:
    """Return the delay as whole samples and a share 0 <= share < 1 of one more."""
    steps = max(delay_s, 0.0) / sample_period_s
    whole = math.floor(steps + 1e-9)
    return whole, max(steps - whole, 0.0)


def delay(x: Array, sample_period_s: float, delay_s: float) -> Array:
    """Return x as it was `delay_s` ago, on straight lines between samples; before x[0] it was x[0].

    Args:
        x: [..., n], uninterrupted stretches along the last axis.
        sample_period_s: seconds between samples.
        delay_s: seconds; 0 or less returns x.
    """
    whole, share = delay_taps(sample_period_s, delay_s)
    late = _shift(x, whole)
    if share == 0.0:
        return late
    return np.asarray((1.0 - share) * late + share * _shift(x, whole + 1))


def _shift(x: Array, steps: int) -> Array:
    """Return x `steps` samples later, filled with the first value in front."""
    if steps <= 0 or x.size == 0:
        return x.copy()
    late = np.empty_like(x)
    late[..., :steps] = x[..., :1]
    late[..., steps:] = x[..., : max(x.shape[-1] - steps, 0)]
    return late
