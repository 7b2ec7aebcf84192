"""Scalar signals in fixed point: input, offset, difference, product, low-pass, delay."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import (
    INT32_MAX,
    INT32_MIN,
    IntArray,
    round_shift,
    saturate,
)
from zerodrift.operations.intervals import Bound, Interval, check_limits, check_shift
from zerodrift.operations.node import CODES, IntegerNode, State, Values

LOWPASS_FRACTION = 24
"""Extra fractional bits of the low-pass state, against stalling (see `IntegerLowpass`)."""


@dataclass(frozen=True)
class IntegerInput(IntegerNode):
    """A raw code, limited to its declared range, counted from `origin`, given fractional bits.

    The code is int16 or int32, as the model's channel says; `origin` is for the wide ones, such as
    seconds since 1970.
    """

    kind: ClassVar[str] = "input"
    channel: int
    low: int
    high: int
    shift: int
    origin: int = 0

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return (saturate(code, low, high) - origin) << shift."""
        code = saturate(values[CODES][:, self.channel], self.low, self.high)
        return {}, np.asarray((code - self.origin) << self.shift)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the shifted code; holds for every code because of the limits."""
        check_shift(self.name, self.shift, 30)
        code = check_limits(self.name, self.low, self.high) - Interval(self.origin, self.origin)
        out = Interval(code.low << self.shift, code.high << self.shift)
        return [out], [
            Bound(f"{self.name}.code", code, 32).check(),
            Bound(self.name, out, 32).check(),
        ]


@dataclass(frozen=True)
class IntegerOffset(IntegerNode):
    """x - offset."""

    kind: ClassVar[str] = "offset"
    offset: int

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return x - offset."""
        return {}, values[self.inputs[0]] - self.offset

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the difference."""
        out = inputs[0][0] - Interval(self.offset, self.offset)
        return [out], [Bound(self.name, out, 32).check()]


@dataclass(frozen=True)
class IntegerDifference(IntegerNode):
    """a - b, both at the same exponent."""

    kind: ClassVar[str] = "difference"

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return a - b."""
        return {}, values[self.inputs[0]] - values[self.inputs[1]]

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the difference, as if a and b were independent."""
        out = inputs[0][0] - inputs[1][0]
        return [out], [Bound(self.name, out, 32).check()]


@dataclass(frozen=True)
class IntegerProduct(IntegerNode):
    """saturate(round_shift(a * b, shift), low, high), the product in 64 bits."""

    kind: ClassVar[str] = "product"
    shift: int
    low: int = INT32_MIN
    high: int = INT32_MAX

    @property
    def limited(self) -> bool:
        """Whether the result is limited to less than its 32 bits."""
        return (self.low, self.high) != (INT32_MIN, INT32_MAX)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the product."""
        product = round_shift(values[self.inputs[0]] * values[self.inputs[1]], self.shift)
        limited = saturate(product, self.low, self.high) if self.limited else product
        return {}, np.asarray(limited)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 64-bit product with its rounding half, and the 32-bit result."""
        check_shift(self.name, self.shift, 62)
        check_limits(self.name, self.low, self.high)
        product = inputs[0][0] * inputs[1][0]
        half = Interval(0, 1 << self.shift >> 1)
        out = product.round_shift(self.shift).saturate(self.low, self.high)
        return [out], [
            Bound(f"{self.name}.product", product + half, 64).check(),
            Bound(self.name, out, 32).check(),
        ]


@dataclass(frozen=True)
class IntegerLowpass(IntegerNode):
    """First-order low-pass, exact for inputs that are straight lines between samples.

    With a = 1 - exp(-dt/tau) and c = 1 - a tau/dt the exact answer to a ramp is
    y' = y + a (x - y) + c (x' - x); keeping v = y - c x instead of y saves the previous input:

        y = v + c x        v' = v + a (x - y)

    v has 24 fractional bits more than x. a = m * 2**-(31 + k) is given as mantissa and exponent, so
    that a time constant of ten hours at 10 ms still moves the state for a difference of a few
    millionths of a kelvin.
    """

    kind: ClassVar[str] = "lowpass"
    c_q24: int
    m_q31: int
    shift: int
    """31 + k - 22 for a = m_q31 * 2**-(31 + k)."""

    def rest(self, values: Values) -> State:
        """Return v at which y equals x exactly."""
        x = values[self.inputs[0]]
        return {"v": x * ((1 << LOWPASS_FRACTION) - self.c_q24)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next v and y rounded to x's format."""
        x = values[self.inputs[0]]
        y = state["v"] + x * self.c_q24
        gap = round_shift((x << LOWPASS_FRACTION) - y, 22)
        v = state["v"] + round_shift(gap * self.m_q31, self.shift)
        return {"v": np.asarray(v)}, np.asarray(round_shift(y, LOWPASS_FRACTION))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound v by induction, and with it y, for any input within its range X.

        Invariant: v is in (1 - c) X within a margin M; it holds at rest. Then y = v + c x is in X
        within M, and v' = (1 - a) v + a (1 - c) x + e stays in (1 - c) X within (1 - a) M + |e|.
        Rounding the gap and the product gives |e| <= 2**21 a + 1/2, so M = 2**21 + 1/a is enough.
        It needs 0 <= c <= 1 and 0 < a <= 1, and says nothing of the past: a v that another program
        overwrote is as harmless, if it is within the invariant.
        """
        check_shift(self.name, self.shift, 62)
        x, one, a_one = inputs[0][0], 1 << LOWPASS_FRACTION, 1 << (self.shift + 22)
        if not (0 <= self.c_q24 <= one and 0 < self.m_q31 <= min(a_one, INT32_MAX)):
            raise CheckError(
                f"{self.name}: c = {self.c_q24} * 2**-24 and a = {self.m_q31} / {a_one} are no"
                " low-pass, which has 0 <= c <= 1 and 0 < a <= 1. The model is refused."
            )
        a_inverse = -(-a_one // self.m_q31)
        margin = Interval(-(1 << 21) - a_inverse, (1 << 21) + a_inverse)
        v = x.scale(one - self.c_q24) + margin
        y = x.scale(one) + margin
        gap = (x.scale(one) - y).round_shift(22)
        scaled = gap.scale(self.m_q31)
        out = y.round_shift(LOWPASS_FRACTION)
        half = Interval(0, 1 << self.shift >> 1)
        return [out], [
            Bound(f"{self.name}.v", v, 64).check(),
            Bound(f"{self.name}.y", y, 64).check(),
            Bound(f"{self.name}.gap", gap, 32).check(),
            Bound(f"{self.name}.scaled", scaled + half, 64).check(),
            Bound(self.name, out, 32).check(),
        ]


@dataclass(frozen=True)
class IntegerDelay(IntegerNode):
    """x as it was `steps` samples ago, or between that and one sample later; at rest always x.

    A delay by steps - share samples mixes the two, on the straight line between them:

        result = older + round_shift((newer - older) newer_q31, 31)
    """

    kind: ClassVar[str] = "delay"
    steps: int
    newer_q31: int = 0
    """Share of the sample `steps` - 1 ago, in Q0.31; 0: none."""

    def rest(self, values: Values) -> State:
        """Return a line filled with the present input, oldest first."""
        x = values[self.inputs[0]]
        return {"line": np.repeat(x[:, None], self.steps, axis=1)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the line with the present input appended, and the delayed input."""
        x = values[self.inputs[0]]
        line = np.concatenate([state["line"], x[:, None]], axis=1)
        older, newer = line[:, 0], line[:, 1]
        out = older + round_shift((newer - older) * self.newer_q31, 31)
        return {"line": line[:, 1:]}, np.asarray(out)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the output by the input's range, and the ring's position by 16 bits.

        With 0 <= newer_q31 < 2**31 the result lies between older and newer.
        """
        if not 0 <= self.newer_q31 <= INT32_MAX:
            raise CheckError(
                f"{self.name}: a share of {self.newer_q31} 2**-31 is not within 0 .. 1."
                " The model is refused."
            )
        x = inputs[0][0]
        half = Interval(0, 1 << 30)
        return [x], [
            Bound(f"{self.name}.line", x, 32).check(),
            Bound(f"{self.name}.rise", (x - x).scale(self.newer_q31) + half, 64).check(),
            Bound(f"{self.name}.steps", Interval(1, self.steps), 16).check(),
        ]
