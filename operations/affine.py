"""Gain and offset by constants: changes of unit and of origin, such as T - T0."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def affine(x: Array, gain: float, offset: float) -> Array:
    """Return gain * x + offset."""
    return np.asarray(gain * x + offset)
