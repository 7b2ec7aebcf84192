"""Product of two signals: span shift is temperature times load."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def product(a: Array, b: Array) -> Array:
    """Return a * b."""
    return np.asarray(a * b)
