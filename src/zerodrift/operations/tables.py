"""The one activation table, and how far it is from tanh and the sigmoid."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import Wholes, saturate
from zerodrift.operations.c_text import RuntimePart
from zerodrift.operations.errors import Known
from zerodrift.operations.intervals import Range, enclose_exp
from zerodrift.operations.node import Writer

# The one activation table: tanh by 513 nodes with lines between them; sigmoid from the same.
#
# Input of tanh is `t_q16`, a 20-bit signed number in Q3.16, so that the table spans -8 .. 8;
# sigmoid reads the same table at half its argument and so spans -16 .. 16. The interpolated value
# keeps all of its bits: nodes in Q0.19 and 11 bits between them give tanh in Q0.30 and sigmoid in
# Q0.31.

Int32Array = NDArray[np.int32]

TANH = RuntimePart("zd_network.h", "zd_tanh_is_sound")
CURVES = RuntimePart("zd_network.h", "zd_gates_are_sound")
"""Of recurrent layers: tanh, and the sigmoid beside it."""

NODES = 513
NODE_BITS = 19
TABLE_BITS = 16
"""Fractional bits of the table's argument."""
STEP_BITS = 11  # 2**11 inputs between two nodes
T_MAX = 2**19 - 1
T_MIN = -(2**19)
NODE_MAX = 2**NODE_BITS - 2 ** (NODE_BITS - 15)
"""1 - 2**-15: a state that follows the table still fits 16 bits when it is copied in Q0.15."""


@cache
def tanh_nodes() -> Int32Array:
    """Return the 513 nodes in Q0.19, odd-symmetric and monotone.

    A chord of tanh lies on one side of the curve, by up to f'' h**2 / 8 for nodes h apart; nodes
    moved by half of that to the other side halve the worst error. 19 bits, where 15 would do for
    tanh, are for the tail of the sigmoid: a unit with a memory of an hour moves by u = 1/3600, and
    a coarse u is a wrong time constant.

    Limits: worst error of the interpolated tanh 1.57 LSB of Q0.15, of the sigmoid 0.79.
    """
    position = np.arange(-(NODES // 2), NODES // 2 + 1) / 32.0
    curve = np.tanh(position)
    bend = -2.0 * curve * (1.0 - curve**2)  # second derivative of tanh
    nodes = np.round((curve - bend / 32.0**2 / 16.0) * 2.0**NODE_BITS)
    return np.clip(nodes, -NODE_MAX, NODE_MAX).astype(np.int32)


@cache
def _starts_and_slopes() -> tuple[Int32Array, Int32Array]:
    """Return the left node of each of the 512 intervals in Q0.30, and its rise in Q0.19."""
    nodes = tanh_nodes()
    return nodes[:-1] << STEP_BITS, np.diff(nodes)


_watchers: list[Callable[[IntArray], object]] = []


@contextmanager
def watching_lines(tell: Callable[[IntArray], object]) -> Iterator[None]:
    """Tell a function the line, 0 .. 511, of every number that is looked up meanwhile."""
    _watchers.append(tell)
    try:
        yield
    finally:
        _watchers.remove(tell)


def is_watched() -> bool:
    """Tell whether someone is told the lines that are looked up."""
    return bool(_watchers)


def tanh_q30(t_q16: Wholes) -> Int32Array:
    """Return tanh(t) in Q0.30 for t in Q3.16, saturating outside -8 .. 8.

    No rounding takes place, hence tanh_q30(-t) = -tanh_q30(t) exactly.

    Limits: between -(2**30 - 2**15) and 2**30 - 2**15.
    """
    starts, slopes = _starts_and_slopes()
    position = saturate(t_q16, T_MIN, T_MAX).astype(np.int32, copy=False) - T_MIN
    index = position >> STEP_BITS
    for tell in _watchers:
        tell(index)
    fraction = position & (2**STEP_BITS - 1)
    # 0 <= index < 512 by the saturation above; mode "clip" only leaves out numpy's own check
    return np.asarray(starts.take(index, mode="clip") + slopes.take(index, mode="clip") * fraction)


def sigmoid_q31(half_t_q16: Wholes) -> Int32Array:
    """Return sigmoid(2 t) = (1 + tanh(t)) / 2 in Q0.31 for t in Q3.16.

    Limits: between 2**15 and 2**31 - 2**15; sigmoid_q31(-t) = 2**31 - sigmoid_q31(t) exactly.
    """
    return np.asarray((1 << 30) + tanh_q30(half_t_q16))


def write_tanh(w: Writer, t_q16: str) -> str:
    """Write tanh in Q0.30 of t in Q3.16, from the one table."""
    nodes = tanh_nodes().astype(np.int64)
    position = w.sub(w.saturate(t_q16, T_MIN, T_MAX), w.constant(T_MIN))
    width = w.constant(1 << STEP_BITS)
    index = w.op("Div", position, width)  # position >= 0
    fraction = w.op("Mod", position, width)
    start = w.op("Gather", w.constant(nodes[:-1] << STEP_BITS), index)
    slope = w.op("Gather", w.constant(np.diff(nodes)), index)
    return w.add(start, w.mul(slope, fraction))


def write_sigmoid(w: Writer, half_t_q16: str) -> str:
    """Write the sigmoid in Q0.31 of twice t in Q3.16."""
    return w.add(write_tanh(w, half_t_q16), w.constant(1 << 30))


# How far the table of tanh is from tanh and from the sigmoid, by going through every argument.

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
def _list_powers() -> Array:
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
def _list_sigmoid_errors() -> tuple[Array, Array]:
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
