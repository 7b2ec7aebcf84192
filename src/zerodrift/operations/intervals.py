"""Intervals of integers, in exact arithmetic: what the range face of every operation returns."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import NamedTuple

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError

# Rational lower and upper bounds of exponentials, logarithms and powers, for proofs.
#
# Everything is integers of 2**-BITS, rounded down on the one side and up on the other; the
# remainder of a series is bounded by a geometric one. No floating point is used.

BITS = 160
ONE = 1 << BITS
TERMS = 24
"""Of e**x for |x| <= 2**-8: what is left out is below 2**-191 / 24! < 2**-BITS."""
LOG_TERMS = 40
"""Of the series of atanh(z), |z| <= 1/3: what is left out is below 2 * 3**-81 < 2**-126."""
LOG_REST = Fraction(2, 3**81)


class Range(NamedTuple):
    """A real number lies between these two, both included."""

    low: Fraction
    high: Fraction


def shorten(x: Fraction, bits: int = 64) -> Fraction:
    """Return x >= 0 or a little more, with a numerator of at most `bits` bits and a power of two.

    Sums of many fractions would otherwise grow without end.
    """
    if x.numerator == 0:
        return x
    surplus = x.numerator.bit_length() - x.denominator.bit_length() - bits
    if surplus >= 0:
        return Fraction(-(-x.numerator // (x.denominator << surplus)) << surplus)
    return Fraction(-((-x.numerator << -surplus) // x.denominator), 1 << -surplus)


def _exp_small(y: int) -> tuple[int, int]:
    """Return bounds of exp(y / ONE) in units of 1 / ONE, for |y| <= ONE >> 8."""
    total, term = ONE, ONE
    for k in range(1, TERMS):
        term = term * y // (ONE * k)  # less than 2 off, the error of the term before included
        total += term
    slack = 2 * TERMS + 1
    return total - slack, total + slack


@cache
def enclose_exp(x: Fraction) -> Range:
    """Return bounds of e**x, |x| <= 2**16."""
    halvings = max((abs(x.numerator) // x.denominator).bit_length(), 0) + 8
    y = (x.numerator << BITS) // (x.denominator << halvings)
    low, high = _exp_small(y)[0], _exp_small(y + 1)[1]
    for _ in range(halvings):
        low, high = low * low >> BITS, -(-high * high >> BITS)
    return Range(Fraction(max(low, 0), ONE), Fraction(high, ONE))


def _enclose_atanh(z: Fraction) -> Range:
    """Return bounds of atanh z, 0 <= z <= 1/3."""
    low, high = Fraction(0), Fraction(0)
    down, up = (z.numerator << BITS) // z.denominator, -((-z.numerator << BITS) // z.denominator)
    square_down, square_up = down * down >> BITS, -(-up * up >> BITS)
    total_down = total_up = 0
    for k in range(LOG_TERMS):
        total_down += down // (2 * k + 1)
        total_up += -(-up // (2 * k + 1))
        down, up = down * square_down >> BITS, -(-up * square_up >> BITS)
    low, high = Fraction(total_down, ONE), Fraction(total_up, ONE) + LOG_REST
    return Range(low, high)


@cache
def enclose_log(x: Fraction) -> Range:
    """Return bounds of the natural logarithm of x > 0."""
    octave = x.numerator.bit_length() - x.denominator.bit_length()
    m = x / Fraction(2) ** octave  # 1/2 < m < 2
    if m < 1:
        m, octave = 2 * m, octave - 1
    of_m = _enclose_atanh((m - 1) / (m + 1))
    of_two = _enclose_atanh(Fraction(1, 3))
    ends = sorted((octave * of_two.low, octave * of_two.high))
    return Range(2 * (of_m.low + ends[0]), 2 * (of_m.high + ends[1]))


@cache
def enclose_power(x: Fraction, exponent: Fraction) -> Range:
    """Return bounds of x**exponent, x >= 0; 0 to any power is 0, to the power of 0 it is 1."""
    if exponent == 0 or x == 1:
        return Range(Fraction(1), Fraction(1))
    if x == 0:
        return Range(Fraction(0), Fraction(0))
    if exponent.denominator == 1 and 0 <= exponent <= 64:
        return Range(x**exponent.numerator, x**exponent.numerator)
    log = enclose_log(x)
    ends = sorted((log.low * exponent, log.high * exponent))
    return Range(enclose_exp(ends[0]).low, enclose_exp(ends[1]).high)


def enclose_exp2(x: Fraction) -> Range:
    """Return bounds of 2**x, |x| <= 2**16."""
    if x.denominator == 1:
        exact = Fraction(2) ** x.numerator
        return Range(exact, exact)
    whole = x.numerator // x.denominator
    log = enclose_log(Fraction(2))
    part, octave = x - whole, Fraction(2) ** whole
    return Range(
        enclose_exp(part * log.low).low * octave, enclose_exp(part * log.high).high * octave
    )


def furthest(x: Fraction, within: Range) -> Fraction:
    """Return how far x can be from a number within some range."""
    return max(abs(x - within.low), abs(x - within.high))


# Intervals of integers, in exact arithmetic: what the range face of every operation returns.


@dataclass(frozen=True)
class Interval:
    """All integers from low to high, both included."""

    low: int
    high: int

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError(f"empty interval {self.low} .. {self.high}")

    @property
    def magnitude(self) -> int:
        """The largest absolute value in the interval."""
        return max(abs(self.low), abs(self.high))

    def __add__(self, other: "Interval") -> "Interval":
        return Interval(self.low + other.low, self.high + other.high)

    def __sub__(self, other: "Interval") -> "Interval":
        return Interval(self.low - other.high, self.high - other.low)

    def __mul__(self, other: "Interval") -> "Interval":
        corners = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(min(corners), max(corners))

    def scale(self, factor: int) -> "Interval":
        """Return the interval of factor * x."""
        return self * Interval(factor, factor)

    def round_shift(self, shift: int) -> "Interval":
        """Return the interval of round_shift(x, shift)."""
        if shift == 0:
            return self
        half = 1 << (shift - 1)
        return Interval((self.low + half) >> shift, (self.high + half) >> shift)

    def saturate(self, low: int, high: int) -> "Interval":
        """Return the interval of saturate(x, low, high)."""
        return Interval(min(max(self.low, low), high), min(max(self.high, low), high))


@dataclass(frozen=True)
class Bound:
    """One line of the certificate: a place in the arithmetic, its interval, and its width."""

    where: str
    interval: Interval
    bits: int
    """Signed width that must hold the interval."""

    def check(self) -> "Bound":
        """Return self.

        Raises:
            CheckError: the interval does not fit; names the place, the bound and the remedy.
        """
        limit = 1 << (self.bits - 1)
        if self.interval.low < -limit or self.interval.high > limit - 1:
            raise CheckError(
                f"{self.where}: can reach {self.interval.low} .. {self.interval.high}, which does"
                f" not fit {self.bits} bits. The model is refused; narrow the input range, or scale"
                " the weights of that row down."
            )
        return self


@dataclass(frozen=True)
class Shift:
    """A right shift: where, by how many bits, and the largest number of bits allowed."""

    where: str
    amount: int
    most: int


def check_shift(where: str, shift: int, most: int) -> None:
    """Refuse a shift that C leaves undefined.

    Args:
        where: names it in the message.
        shift: bits.
        most: 31 for a 32-bit value, 62 where a 64-bit one is rounded, 63 where it is not.

    Raises:
        CheckError: shift is not within 0 .. most.
    """
    if not 0 <= shift <= most:
        raise CheckError(
            f"{where}: a shift by {shift} bits; 0 .. {most} are possible. The model is refused."
        )


def check_limits(where: str, low: int, high: int) -> Interval:
    """Return the interval low .. high.

    Raises:
        CheckError: the limits are the wrong way round.
    """
    if low > high:
        raise CheckError(
            f"{where}: limits {low} .. {high} are the wrong way round. The model is refused."
        )
    return Interval(low, high)


def bound_row(
    where: str, row: IntArray, bias: int, inputs: list[Interval], bits: int
) -> tuple[Interval, Bound]:
    """Return the interval of bias + row . inputs and a bound that covers every partial sum.

    Raises:
        CheckError: some order of summation could overflow.
    """
    total = Interval(bias, bias)
    partial = abs(bias)
    for weight, interval in zip(row.tolist(), inputs, strict=True):
        total = total + interval.scale(weight)
        partial += abs(weight) * interval.magnitude
    return total, Bound(where, Interval(-partial, partial), bits).check()
