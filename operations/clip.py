"""Limits: a converter's rails, a calibrated range."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def clip(x: Array, low: float, high: float) -> Array:
    """Return x limited to low .. high, limits in x's unit."""
    return np.clip(x, low, high)
