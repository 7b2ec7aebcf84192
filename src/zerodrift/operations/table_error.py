"""How far the table of tanh is from tanh and from the sigmoid, by going through every argument."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.enclosure import Range, enclose_exp
from zerodrift.operations.errors import Known
from zerodrift.operations.tables import (
    STEP_BITS,
    T_MAX,
    T_MIN,
    TABLE_BITS,
    sigmoid_q31,
    tanh_q30,
)

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
    tanh = 1.0 - 2.0 / (_list_powers() + 1.0)
    table = tanh_q30(np.arange(T_MAX + 1))  # below 2**53: exact as a float
    worst = float(np.abs(table - tanh * 2.0**30).max())  # one more rounding, of what is below 2**10
    slack = Fraction(ROUNDINGS << 30, 1 << 53) + Fraction(worst) / (1 << 52)
    at_ends = [abs(int(tanh_q30(np.array(t)))) for t in (T_MIN, T_MAX)]
    beyond = (1 << 30) - min(at_ends)
    return max(Fraction(worst) + slack, Fraction(beyond))


@cache
def _list_powers() -> NDArray[np.float64]:
    """Return e**(2 t 2**-16) of t = 0 .. 2**19 - 1, each within 2**-51 of its size."""
    coarse = [_round_exp(Fraction(2 * i << FINE_BITS, 1 << TABLE_BITS)) for i in range(512)]
    fine = [_round_exp(Fraction(2 * j, 1 << TABLE_BITS)) for j in range(1 << FINE_BITS)]
    return np.asarray(np.multiply.outer(np.array(coarse), np.array(fine)).ravel())


@dataclass(frozen=True)
class SigmoidError:
    """|table - sigmoid| <= table (share (1 - table) + rest)."""

    share: Fraction
    rest: Fraction


@cache
def _list_sigmoid_errors() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return running maxima over t = 0 .. 2**19 - 1, of what the table is off by at -t.

    The first from 0 on, as a share of table (1 - table); the second from the end, beyond which the
    table stands still at 2**-16 above a sigmoid that goes to 0.
    """
    sigmoid = 1.0 / (_list_powers() + 1.0)
    table = sigmoid_q31(-np.arange(T_MAX + 1)) / 2.0**31  # exact: below 2**31
    off = np.abs(table - sigmoid)
    left = np.maximum.accumulate(np.append(off, 2.0**-16)[::-1])[::-1]
    return np.maximum.accumulate(off / (table * (1.0 - table))), left


def bound_sigmoid_table(low: int, high: int) -> SigmoidError:
    """Return how far the table is from the sigmoid at arguments of low 2**-15 to high 2**-15.

    At t and -t it is off by as much, and table (1 - table) is the same: one share holds for
    |t| <= end, -low or any more. Above that the table is over 1/2, and the rest is at most twice
    what it is off by. Of the ends of lines that one is taken with which the bound is smallest.
    """
    first = max(-low, 0)
    if first > T_MAX:
        return SigmoidError(Fraction(1 << 16, (1 << 16) - 1), Fraction(0))
    shares, left = _list_sigmoid_errors()
    ends = np.array([first, *range((first >> STEP_BITS) + 1 << STEP_BITS, T_MAX, 1 << STEP_BITS)])
    rests = np.where(high > ends, 2.0 * left[ends], 0.0)
    best = int(np.argmin(shares[ends] + 2.0 * rests))
    slack = Fraction(2 * ROUNDINGS, 1 << 53)
    rest = Fraction(float(rests[best])) + 2 * slack if high > ends[best] else Fraction(0)
    # the shares' own rounding is relative to 1 / (1 - table) <= 2, their sigmoid's to the table
    return SigmoidError(Fraction(float(shares[ends[best]])) + 4 * slack, rest)


def _round_exp(x: Fraction) -> float:
    """Return the float that is e**x, within 2**-52 of its size."""
    low, high = enclose_exp(x)
    return float((low + high) / 2)


def bound_tanh_slope(z: Known) -> Fraction:
    """Return the largest slope of tanh between any z and any real z within its error."""
    return bound_slope(z.ends[0] - z.error.total, z.ends[1] + z.error.total)


def bound_slope(low: Fraction, high: Fraction) -> Fraction:
    """Return the largest slope of tanh from low to high.

    1 - tanh(z)**2 = 4 E / (1 + E)**2 with E = e**(2 |z|), which falls with |z|.
    """
    least = max(low, -high, Fraction(0))
    if least == 0:
        return Fraction(1)
    e = enclose_exp(2 * min(least, Fraction(32))).low
    return 4 * e / (1 + e) ** 2


def bound_sigmoid(x: Fraction) -> Range:
    """Return numbers below and above sigmoid(x); 0 and 1 beyond -40 and 40."""
    if abs(x) > 40:
        near = enclose_exp(Fraction(-40)).high
        return Range(1 - near, Fraction(1)) if x > 0 else Range(Fraction(0), near)
    e = enclose_exp(-x)
    return Range(1 / (1 + e.high), 1 / (1 + e.low))
