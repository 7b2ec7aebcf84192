"""Difference of two signals: what a sensor's own memory is made of."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def difference(a: Array, b: Array) -> Array:
    """Return a - b, both in the same unit."""
    return np.asarray(a - b)
