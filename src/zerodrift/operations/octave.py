"""Bounds on the error of a polynomial in fixed point against the function it approximates."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache

from zerodrift.operations.enclosure import Range, enclose_exp2, enclose_log, enclose_power

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
