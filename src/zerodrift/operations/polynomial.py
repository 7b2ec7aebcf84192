"""Polynomials in fixed point: the smooth part of exp2 and of powers, on one octave."""

from collections.abc import Callable, Sequence

import numpy as np

from zerodrift.operations.arithmetic import IntArray, round_shift
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import Writer

FRACTION_BITS = 31
"""The argument f is Q0.31, 0 <= f < 1."""


def evaluate_polynomial(f_q31: IntArray, coefficients: Sequence[int]) -> IntArray:
    """Return sum_i c_i f**i by Horner's rule, rounded once per degree.

    Args:
        f_q31: int64 array in Q0.31, 0 <= f < 1.
        coefficients: c_0, c_1, ... in the result's format.
    """
    total = np.full_like(f_q31, coefficients[-1])
    for c in reversed(coefficients[:-1]):
        total = c + round_shift(total * f_q31, FRACTION_BITS)
    return total


def bound_polynomial(where: str, coefficients: Sequence[int]) -> list[Bound]:
    """Return the bounds of Horner's rule for every f, the last of them that of the result.

    Raises:
        CheckError: a partial result does not fit 32 bits.
    """
    f = Interval(0, (1 << FRACTION_BITS) - 1)
    total = Interval(coefficients[-1], coefficients[-1])
    bounds = [Bound(f"{where}.degree_{len(coefficients) - 1}", total, 32).check()]
    for degree in range(len(coefficients) - 2, -1, -1):
        c = coefficients[degree]
        total = (total * f).round_shift(FRACTION_BITS) + Interval(c, c)
        bounds.append(Bound(f"{where}.degree_{degree}", total, 32).check())
    return bounds


def fit_octave(function: Callable[[float], float], degree: int, bits: int) -> tuple[int, ...]:
    """Return coefficients, with `bits` fractional bits, of function(1 + f) on 0 <= f < 1.

    The polynomial through the Chebyshev points of the octave, within a few percent of the best one
    of its degree for functions as smooth as these.
    """
    nodes = [0.5 - 0.5 * np.cos(np.pi * (2 * k + 1) / (2 * degree + 2)) for k in range(degree + 1)]
    # Newton's divided differences, then expanded into powers of f.
    table = [function(1.0 + f) for f in nodes]
    for level in range(1, degree + 1):
        for k in range(degree, level - 1, -1):
            table[k] = (table[k] - table[k - 1]) / (nodes[k] - nodes[k - level])
    powers = [table[degree]]
    for k in range(degree - 1, -1, -1):
        shifted = [0.0, *powers]
        scaled = [-nodes[k] * c for c in powers] + [0.0]
        powers = [a + b for a, b in zip(shifted, scaled, strict=True)]
        powers[0] += table[k]
    return tuple(round(c * 2.0**bits) for c in powers)


def write_polynomial(w: Writer, f_q31: str, coefficients: Sequence[int]) -> str:
    """Write sum c_i f**i by Horner's rule, rounded once per degree."""
    total = w.constant(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        total = w.add(w.constant(c), w.round_shift(w.mul(total, f_q31), FRACTION_BITS))
    return total
