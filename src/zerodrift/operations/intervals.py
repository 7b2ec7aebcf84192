"""Intervals of integers, in exact arithmetic: what the range face of every operation returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError


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
    where: str, row: NDArray[np.int64], bias: int, inputs: list[Interval], bits: int
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
