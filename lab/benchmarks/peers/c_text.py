"""Numbers as C."""

import numpy as np
from numpy.typing import NDArray


def write_array(kind: str, name: str, values: NDArray[np.generic]) -> str:
    """Return the definition of a constant array."""
    flat = ", ".join(str(v) for v in values.ravel().tolist())
    return f"static const {kind} {name}[{values.size}] = {{{flat}}};\n"


def split_scale(scale: float) -> tuple[int, int]:
    """Return m and s with scale = m * 2**(s - 31), 2**30 <= m < 2**31."""
    fraction, shift = np.frexp(scale)
    multiplier = round(float(fraction) * 2**31)
    return (multiplier // 2, int(shift) + 1) if multiplier == 2**31 else (multiplier, int(shift))
