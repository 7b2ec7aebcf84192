"""How far the table of tanh is from tanh, by going through every argument that it has."""

from fractions import Fraction
from functools import cache

import numpy as np

from zerodrift.operations.enclosure import enclose_exp
from zerodrift.operations.errors import Known
from zerodrift.operations.tables import T_MAX, T_MIN, TABLE_BITS, tanh_q30

FINE_BITS = 10
"""Arguments t = (i 2**10 + j) 2**-16: e**(2 t) is a product of two of 512 + 1024 numbers."""
ROUNDINGS = 8
"""Of e**(2 t) (two numbers and their product), + 1, 2 / x, 1 - x: six, each by 2**-53 of at most 1
or of a relative size that is passed on at most once, and two to spare for their products."""


@cache
def bound_tanh() -> Fraction:
    """Return the largest |tanh_q30(t) - 2**30 tanh(t 2**-16)| over all integers t, in counts.

    The table is odd, so t >= 0 are enough. All 2**19 within it are computed by IEEE arithmetic from
    exponentials that were enclosed by fractions, with a bound on what that rounds; beyond it tanh
    lies between its value at 8 and 1, and the table stands still.
    """
    coarse = [_round_exp(Fraction(2 * i << FINE_BITS, 1 << TABLE_BITS)) for i in range(512)]
    fine = [_round_exp(Fraction(2 * j, 1 << TABLE_BITS)) for j in range(1 << FINE_BITS)]
    power = np.multiply.outer(np.array(coarse), np.array(fine)).ravel()
    tanh = 1.0 - 2.0 / (power + 1.0)
    table = tanh_q30(np.arange(T_MAX + 1))  # below 2**53: exact as a float
    worst = float(np.abs(table - tanh * 2.0**30).max())  # one more rounding, of what is below 2**10
    slack = Fraction(ROUNDINGS << 30, 1 << 53) + Fraction(worst) / (1 << 52)
    at_ends = [abs(int(tanh_q30(np.array(t)))) for t in (T_MIN, T_MAX)]
    beyond = (1 << 30) - min(at_ends)
    return max(Fraction(worst) + slack, Fraction(beyond))


def _round_exp(x: Fraction) -> float:
    """Return the float that is e**x, within 2**-52 of its size."""
    low, high = enclose_exp(x)
    return float((low + high) / 2)


def bound_tanh_slope(z: Known) -> Fraction:
    """Return the largest slope of tanh between any z and any real z within its error.

    1 - tanh(z)**2 = 4 E / (1 + E)**2 with E = e**(2 |z|), which falls with |z|.
    """
    low, high = z.ends[0] - z.error.total, z.ends[1] + z.error.total
    least = max(low, -high, Fraction(0))
    if least == 0:
        return Fraction(1)
    e = enclose_exp(2 * min(least, Fraction(32))).low
    return 4 * e / (1 + e) ** 2
