"""Polynomials in fixed point on one octave, and the bounds on their error."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Range,
    enclose_exp2,
    enclose_log,
    enclose_power,
)
from zerodrift.operations.node import Writer

# Bounds on the error of a polynomial in fixed point against the function it approximates.

CELLS = 512
ORDER = 4
"""Of the last derivative, which is bounded over the whole octave."""
Derivative = Callable[[Fraction, int], Range]
"""(f, order) -> bounds of the function's derivative at f."""


@cache
def bound_exp2_octave(coefficients: tuple[int, ...], bits: int) -> Fraction:
    """Return how far Horner's rule in integers is from 2**(bits + f), 0 <= f < 1, in its counts."""
    log = enclose_log(Fraction(2))

    def differentiate(f: Fraction, order: int) -> Range:
        value = enclose_exp2(f + bits)
        return Range(value.low * log.low**order, value.high * log.high**order)

    return _bound_octave(coefficients, differentiate, differentiate(Fraction(1), ORDER).high)


@cache
def bound_power_octave(coefficients: tuple[int, ...], exponent: Fraction, bits: int) -> Fraction:
    """Return how far Horner's rule in integers is from 2**bits (1 + f)**p, in its counts."""

    def differentiate(f: Fraction, order: int) -> Range:
        value = enclose_power(1 + f, exponent)
        factor = Fraction(1 << bits) / (1 + f) ** order
        for k in range(order):
            factor *= exponent - k
        ends = sorted((value.low * factor, value.high * factor))
        return Range(*ends)

    ends = [differentiate(f, ORDER) for f in (Fraction(0), Fraction(1))]  # it is monotone
    return _bound_octave(coefficients, differentiate, max(abs(e) for end in ends for e in end))


def _bound_octave(
    coefficients: Sequence[int], differentiate: Derivative, steepest: Fraction
) -> Fraction:
    """Return how far Horner's rule in integers is from a function.

    Around the middle m of each of `CELLS` cells of half-width h both are their Taylor polynomials
    up to one order before `ORDER` and a rest; they differ by |D(m)| + |D'(m)| h + ... at most. Each
    rounding of Horner's rule adds 1/2, times a power of f <= 1.

    Args:
        coefficients: c_0, c_1, ... of the polynomial.
        differentiate: the function and its derivatives.
        steepest: the largest size of its derivative of order `ORDER`.
    """
    half = Fraction(1, 2 * CELLS)
    derivatives = [[Fraction(c) for c in coefficients]]
    for _ in range(ORDER):
        derivatives.append([k * c for k, c in enumerate(derivatives[-1])][1:])
    worst = Fraction(0)
    for cell in range(CELLS):
        middle, total, weight = (2 * cell + 1) * half, Fraction(0), Fraction(1)
        for order in range(ORDER):
            own = _evaluate(derivatives[order], middle)
            total += max(abs(own - end) for end in differentiate(middle, order)) * weight
            weight *= half / (order + 1)
        worst = max(worst, total)
    rest = (sum(map(abs, derivatives[ORDER]), steepest)) * weight
    return worst + rest + Fraction(len(coefficients) - 1, 2)


def _evaluate(coefficients: Sequence[Fraction], f: Fraction) -> Fraction:
    total = Fraction(0)
    for c in reversed(coefficients):
        total = total * f + c
    return total


# Polynomials in fixed point: the smooth part of exp2 and of powers, on one octave.

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
