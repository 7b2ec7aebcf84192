"""Powers: x**2, x**3 of polynomials, t**p of ageing."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def power(x: Array, exponent: float) -> Array:
    """Return x**exponent.

    Args:
        x: any shape; less than 0 counts as 0 unless the exponent is a whole number.
        exponent: dimensionless, > 0.
    """
    whole = round(exponent)
    if abs(exponent - whole) < 1e-12:
        return np.asarray(x**whole)
    return np.asarray(np.maximum(x, 0.0) ** exponent)
