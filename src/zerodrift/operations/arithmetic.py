"""The project's only integer arithmetic: one rounding rule, explicit saturation, exact products.

Everything works on int64 arrays holding values that the C keeps in the widths named by the
specification (`docs/reference/integer-arithmetic.md`); nothing may wrap, which the range rules
prove for every model.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray

CodeArray = NDArray[np.signedinteger]
"""Raw input codes: int16, or int32 where a channel needs it."""
Whole = TypeVar("Whole", int, IntArray, NDArray[np.int32])
"""A whole number, or an array of them."""
Wholes = TypeVar("Wholes", IntArray, NDArray[np.int32])
"""An array of whole numbers."""

INT16_MIN, INT16_MAX = -(2**15), 2**15 - 1
INT32_MIN, INT32_MAX = -(2**31), 2**31 - 1


def round_shift(x: Whole, shift: int) -> Whole:
    """Return x / 2**shift rounded to the nearest integer, halves upwards.

    Args:
        x: int64 array or int; |x| < 2**63 - 2**(shift - 1).
        shift: 0 .. 62 bits.

    Example:
        >>> [round_shift(v, 1) for v in (-3, -2, -1, 0, 1, 2, 3)]
        [-1, -1, 0, 0, 1, 1, 2]
    """
    if shift == 0:
        return x
    return (x + (1 << (shift - 1))) >> shift


def saturate(x: Whole, low: Whole | int, high: Whole | int) -> Whole:
    """Return x limited to low .. high, both included."""
    if isinstance(x, int):
        return min(max(x, low), high)
    return np.minimum(np.maximum(x, low), high)


def matmul_exact(vector: CodeArray, matrix_t: Array) -> IntArray:
    """Return the integer product vector @ matrix_t, computed by float64 BLAS without any rounding.

    Args:
        vector: [B, n] integers.
        matrix_t: [n, m] integers stored as float64.

    Limits: exact as long as every partial sum stays below 2**53. A 32-bit accumulator, which the
    range rule of `dense` and `gru` has proven, is far below that.
    """
    return np.asarray(vector.astype(np.float64) @ matrix_t).astype(np.int64)


def choose_exponent(largest: float, limit: int) -> int:
    """Return the largest f <= 62 with largest * 2**f <= limit; it may be negative."""
    if largest <= limit * 2.0**-62:
        return 62
    exponent = int(np.floor(np.log2(limit / largest)))
    while largest * 2.0**exponent > limit:
        exponent -= 1
    while exponent < 62 and largest * 2.0 ** (exponent + 1) <= limit:
        exponent += 1
    return exponent
