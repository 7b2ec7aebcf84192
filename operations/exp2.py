"""Powers of two: a photo-transistor's dark current doubles every so many kelvin."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EXPONENT_LIMIT = 60.0
"""|x| beyond this is limited: 2**60 of anything is no longer a measurement."""


def exp2(x: Array) -> Array:
    """Return 2**x for x limited to -60 .. 60.

    Args:
        x: any shape, dimensionless.
    """
    return np.exp2(np.clip(x, -EXPONENT_LIMIT, EXPONENT_LIMIT))
