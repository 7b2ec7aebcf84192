"""Exponentials, logarithms and tables for the check of the error bound, on the standard library.

`decimal` rounds exp and ln correctly; each result is widened by the rounding of its last digit.
Shares no code with what the bound was derived by.
"""

from collections.abc import Callable, Sequence
from decimal import Context, Decimal
from fractions import Fraction
from functools import cache

DIGITS = 60
OPEN = Fraction(1, 10 ** (DIGITS - 6))
"""What a result may be off by, as a share: its own rounding, and that of what it is of."""
CELLS = 1024
Ends = tuple[Fraction, Fraction]
Value = Callable[[Fraction, int], Ends]

_context = Context(prec=DIGITS, Emax=10**9, Emin=-(10**9))


def _decimal(x: Fraction) -> Decimal:
    return _context.divide(Decimal(x.numerator), Decimal(x.denominator))


def _open(x: Decimal) -> Ends:
    value = Fraction(x)
    slack = abs(value) * OPEN
    return value - slack, value + slack


def exp(x: Fraction) -> Ends:
    """Return numbers below and above e**x; |x| < 10**4, whose rounding then moves it by 10**-55."""
    return _open(_context.exp(_decimal(x)))


@cache
def ln(x: Fraction) -> Ends:
    """Return numbers below and above ln x for x > 0, not within 10**-6 of 1 but 1 itself."""
    if x == 1:
        return Fraction(0), Fraction(0)
    return _open(_context.ln(_decimal(x)))


@cache
def power(x: Fraction, exponent: Fraction) -> Ends:
    """Return numbers below and above x**exponent for x >= 0."""
    if x in {0, 1} or exponent == 0:
        value = Fraction(0 if x == 0 and exponent else 1)
        return value, value
    low, high = sorted(end * exponent for end in ln(x))
    return exp(low)[0], exp(high)[1]


def exp2(x: Fraction) -> Ends:
    """Return numbers below and above 2**x."""
    return power(Fraction(2), x)


def tanh_error(lines: Sequence[tuple[int, int]]) -> Fraction:
    """Return the largest distance of the table, read at t 2**-16, from 2**30 tanh, in counts.

    Args:
        lines: what its 512 lines give at their first and last of 2048 arguments; the table is odd.

    e**(2 t) is carried from argument to argument in integers of 2**-160, by bounds.
    """
    bits, half = 160, lines[256:]
    step = exp(Fraction(2, 1 << 16))
    factor = (int(step[0] * (1 << bits)), int(step[1] * (1 << bits)) + 1)
    low = high = 1 << bits
    one, unit = 1 << bits, 1 << 30
    worst = 0
    for first, last in half:
        slope, rest = divmod(last - first, 2047)
        if rest:
            raise ValueError("a line of tanh is not straight")
        table = first
        for _ in range(2048):
            # tanh = 1 - 2 / (e + 1), rising with e; in counts times 2**64
            below = ((low - one) << 94) // (low + one)
            above = ((high - one) << 94) // (high + one) + 1
            worst = max(worst, abs((table << 64) - below), abs((table << 64) - above))
            low, high = low * factor[0] >> bits, (high * factor[1] >> bits) + 1
            table += slope
    return max(Fraction(worst, 1 << 64), Fraction(unit - abs(half[-1][1])))


@cache
def cached_tanh_error(lines: tuple[tuple[int, int], ...]) -> Fraction:
    """Return `tanh_error`, found once for a table."""
    return tanh_error(lines)


@cache
def _sigmoid_errors(lines: tuple[tuple[int, int], ...]) -> tuple[list[int], list[int]]:
    """Return what the table of the sigmoid is off by at -t 2**-15, t = 0 .. 2**19 - 1, in 2**-64.

    First the largest up to t as a share of table (1 - table), then the largest from t on.
    """
    bits, one = 160, 1 << 160
    step = exp(Fraction(2, 1 << 16))
    factor = (int(step[0] * one), int(step[1] * one) + 1)
    low = high = one
    shares, offs, worst = list[int](), list[int](), 0
    for first, last in lines[256:]:
        slope, rest = divmod(last - first, 2047)
        if rest:
            raise ValueError("a line of tanh is not straight")
        tanh = first
        for _ in range(2048):
            # sigmoid(-a) = 1 / (e**a + 1); the table's in counts of 2**-31
            table = (1 << 30) - tanh
            below, above = (one << 95) // (high + one), (one << 95) // (low + one) + 1
            off = max(abs((table << 64) - below), abs((table << 64) - above)) + 1  # of 2**-95
            offs.append((off >> 31) + 1)
            worst = max(worst, (off << 31) // (table * ((1 << 31) - table)) + 1)
            shares.append(worst)
            low, high = low * factor[0] >> bits, (high * factor[1] >> bits) + 1
            tanh += slope
    worst = ((1 << 30) - tanh + slope) << 33  # beyond the end: the table's last, the sigmoid's none
    for t in range(len(offs) - 1, -1, -1):
        offs[t] = worst = max(worst, offs[t])
    return shares, offs


def sigmoid_error(
    lines: tuple[tuple[int, int], ...], low: int, high: int
) -> tuple[Fraction, Fraction]:
    """Return k, r: the table is off by at most table (k (1 - table) + r) at low .. high 2**-15.

    The share k is that of arguments up to some end, at which one line begins; r is twice what the
    table, then above 1/2, is off by beyond it.
    """
    first = max(-low, 0)
    shares, offs = _sigmoid_errors(lines)
    if first >= len(shares):
        return Fraction(1), Fraction(1)
    ends = [first, *range((first // 2048 + 1) * 2048, len(shares), 2048)]
    found = [(shares[end], 2 * offs[end] if high > end else 0) for end in ends]
    share, rest = min(found, key=lambda pair: pair[0] + 2 * pair[1])
    return Fraction(share, 1 << 64), Fraction(rest, 1 << 64)


def octave_error(coefficients: tuple[int, ...], value: Value, steepest: Fraction) -> Fraction:
    """Return the largest distance of Horner's rule in integers from a function on 0 .. 1.

    Args:
        coefficients: c_0, c_1, ...
        value: (f, order) -> numbers below and above the derivative of that order.
        steepest: the largest fourth derivative.

    By Taylor's formula of degree 3 around the middle of each cell.
    """
    half = Fraction(1, 2 * CELLS)
    worst = Fraction(0)
    for cell in range(CELLS):
        f, total = (2 * cell + 1) * half, Fraction(0)
        for order, weight in enumerate((Fraction(1), half, half**2 / 2, half**3 / 6)):
            polynomial = _differentiate(coefficients, f, order)
            total += weight * max(abs(polynomial - end) for end in value(f, order))
        worst = max(worst, total)
    alone = [(*(0,) * k, c) for k, c in enumerate(coefficients)]
    fourth = sum(abs(_differentiate(term, Fraction(1), 4)) for term in alone)
    return worst + (fourth + steepest) * half**4 / 24 + Fraction(len(coefficients) - 1, 2)


def _differentiate(coefficients: Sequence[int], f: Fraction, order: int) -> Fraction:
    total = Fraction(0)
    for k in range(len(coefficients) - 1, order - 1, -1):
        factor = 1
        for i in range(order):
            factor *= k - i
        total = total * f + factor * coefficients[k]
    return total


@cache
def exp2_octave(coefficients: tuple[int, ...]) -> Fraction:
    """Return the largest distance of a polynomial from 2**(29 + f), in counts."""
    log = ln(Fraction(2))

    def value(f: Fraction, order: int) -> Ends:
        low, high = exp2(29 + f)
        return low * log[0] ** order, high * log[1] ** order

    return octave_error(coefficients, value, value(Fraction(1), 4)[1])


@cache
def power_octave(coefficients: tuple[int, ...], exponent: Fraction, top: int) -> Fraction:
    """Return the largest distance of a polynomial from top (1 + f)**exponent, in counts."""

    def value(f: Fraction, order: int) -> Ends:
        factor = Fraction(top) / (1 + f) ** order
        for k in range(order):
            factor *= exponent - k
        low, high = sorted(end * factor for end in power(1 + f, exponent))
        return low, high

    ends = [*value(Fraction(0), 4), *value(Fraction(1), 4)]
    return octave_error(coefficients, value, max(map(abs, ends)))
