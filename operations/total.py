"""Sum of two signals."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def total(a: Array, b: Array) -> Array:
    """Return a + b, both in the same unit."""
    return np.asarray(a + b)
