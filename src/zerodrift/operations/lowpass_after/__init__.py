"""First-order low-pass whose step is given its duration: for sensors that sleep."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from zerodrift.base.arrays import IntArray, Mask
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import INT32_MAX, round_shift
from zerodrift.operations.c_text import StateField
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.formats import LOWPASS_FRACTION
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import ELAPSED, IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real
from zerodrift.operations.times import US_PER_S, count_bits

LEAST_EXPONENT = -19
"""A step of dt/tau below 2**-20 is collected: it moves nothing, and is added to the next."""
MOST_EXPONENT = 24
"""A step of dt/tau from 2**24 on is taken for one of 2**24."""
STRAIGHT_Q32 = tuple(round(2**32 / math.factorial(n + 2)) for n in range(11))
"""(1 - (1 - exp(-r)) / r) / r = 1/2 - r/6 + r**2/24 - ..., its coefficients without their signs;
what is left out is below 2**-32 for r <= 1."""
MARGIN = 1 << 22
"""How far y can be beyond the range of x, in 2**-24: 2**21 + 1 / a (see `IntegerLowpassAfter`)."""


class Shares(NamedTuple):
    """The coefficients of a step y' = y + a (x - y) + c (x' - x)."""

    moves: Mask
    """[B] False where the step is collected."""
    a_q31: IntArray
    """[B] a = a_q31 2**-(31 + k) = 1 - exp(-r)."""
    k: IntArray
    """[B] 0 .. 19."""
    c_q31: IntArray
    """[B] c = c_q31 2**-31 = 1 - (1 - exp(-r)) / r; never above a."""


def find_shares(time_us: IntArray, rate_q31: int, shift: int) -> Shares:
    """Return the shares of a step of r = time_us rate_q31 2**-(31 + shift).

    r = m 2**(e - 31) with 2**30 <= m < 2**31. For e <= 0 a polynomial in r gives c, and a is
    r (1 - c). For larger ones both are found for m 2**-31 and doubled e times, from

        a(2 r) = 2 a - a**2        s(2 r) = s (1 - a / 2)        s = a / r = 1 - c

    Args:
        time_us: [B] 0 .. 2**61 + 2**31.
        rate_q31: 1 .. 2**31 - 1.
        shift: 0 .. 50.

    Limits: a within 2**-28 of itself, c within 2**-28, for r from 2**-20 on (tests).
    """
    bits = count_bits(time_us)
    place = np.where(
        bits > 32, time_us >> np.maximum(bits - 32, 0), time_us << np.clip(32 - bits, 0, 31)
    )
    product = place * rate_q31
    wide = count_bits(product)
    m = product >> np.maximum(wide - 31, 0)
    e = wide + bits - 63 - shift
    moves = (time_us > 0) & (e >= LEAST_EXPONENT)
    far = e > MOST_EXPONENT
    m = np.where(far, INT32_MAX, m)
    e = np.where(far, MOST_EXPONENT, np.where(moves, e, LEAST_EXPONENT))
    k = np.maximum(-e, 0)
    f = m >> k
    straight = np.full_like(f, STRAIGHT_Q32[-1])
    for coefficient in reversed(STRAIGHT_Q32[:-1]):
        straight = coefficient - ((f * straight) >> 31)
    c = (f * straight) >> 32
    a, s = m - ((m * c) >> 31), (1 << 31) - c
    for doubling in range(max(int(e.max(initial=0)), 0)):
        more = e > doubling
        s = np.where(more, s - ((s * a) >> 32), s)
        a = np.where(more, 2 * a - ((a * a + INT32_MAX) >> 31), a)
    return Shares(moves, a, k, np.minimum((1 << 31) - s, a >> k))


def round_rate(tau_us: float) -> tuple[int, int]:
    """Return rate_q31 and shift with 1 / tau_us = rate_q31 2**-(31 + shift).

    Args:
        tau_us: time constant in microseconds, above 1.
    """
    shift = math.frexp(tau_us)[1] - 1
    return min(round(2.0 ** (31 + shift) / tau_us), INT32_MAX), shift


@dataclass(frozen=True)
class IntegerLowpassAfter(IntegerNode):
    """First-order low-pass, exact for an input that is a straight line between two samples.

        y' = y + a (x - y) + c (x' - x)      a = 1 - exp(-dt/tau), c = 1 - a tau/dt

    y has 24 fractional bits more than x. A step too short for the arithmetic, dt/tau < 2**-20, is
    collected: y and x stay, and the line to the next sample begins where they are.
    """

    kind: ClassVar[str] = "lowpass_after"
    rate_q31: int
    shift: int
    """1 / tau = rate_q31 2**-(31 + shift) per microsecond."""

    @property
    def needs_variable_step(self) -> bool:
        """Whether the step takes the time since the last one."""
        return True

    def rest(self, values: Values) -> State:
        """Return y = x, with no time collected."""
        x = values[self.inputs[0]]
        return {"y": x << LOWPASS_FRACTION, "before": x, "waiting": np.zeros_like(x)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the state at the present sample and y rounded to x's format."""
        x, before, y = values[self.inputs[0]], state["before"], state["y"]
        time_us = state["waiting"] + values[ELAPSED]
        moves, a, k, c = find_shares(time_us, self.rate_q31, self.shift)
        gap = round_shift((before << LOWPASS_FRACTION) - y, 22)
        moved = (gap * a + (np.int64(1) << (8 + k))) >> (9 + k)
        after = np.where(moves, y + moved + round_shift((x - before) * c, 7), y)
        return {
            "y": after,
            "before": np.where(moves, x, before),
            "waiting": np.where(moves, 0, time_us),
        }, np.asarray(round_shift(after, LOWPASS_FRACTION))

    @property
    def most_waiting(self) -> int:
        """The longest time that is collected, in microseconds."""
        return ((1 << (self.shift + 31 + LEAST_EXPONENT - 1)) - 1) // self.rate_q31

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound y by induction for any times between steps, and any input within its range X.

        Invariant: y is in X within a margin M; it holds at rest. Since 0 <= c <= a <= 1,
        y' = (1 - a) y + (a - c) x + c x' + e stays in X within (1 - a) M + |e|. Rounding the gap
        and both products gives |e| <= 2**21 a + 1, so M = 2**21 + 1/a is enough, and 1/a < 2**21.
        """
        if not (0 < self.rate_q31 <= INT32_MAX and 0 <= self.shift <= 50):
            raise CheckError(
                f"{self.name}: a rate of {self.rate_q31} * 2**-(31 + {self.shift}) per microsecond"
                " is no time constant. The model is refused."
            )
        x, one = inputs[0][0], 1 << LOWPASS_FRACTION
        y = x.scale(one) + Interval(-MARGIN, MARGIN)
        gap = (x.scale(one) - y).round_shift(22)
        scaled = gap * Interval(0, INT32_MAX) + Interval(0, 1 << 27)
        rise = (x - x) * Interval(0, INT32_MAX) + Interval(0, 1 << 6)
        out = y.round_shift(LOWPASS_FRACTION)
        return [out], [
            Bound(f"{self.name}.y", y, 64).check(),
            Bound(f"{self.name}.before", x, 32).check(),
            Bound(f"{self.name}.waiting", Interval(0, self.most_waiting), 32).check(),
            Bound(f"{self.name}.gap", gap, 32).check(),
            Bound(f"{self.name}.scaled", scaled, 64).check(),
            Bound(f"{self.name}.rise", rise, 64).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise NoRuleError: the error depends on the times between steps."""
        raise NoRuleError("a low-pass of a variable step has no error rule yet")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write y' = y + a (x - y) + c (x' - x), or the collected time."""
        x, before, y = values[self.inputs[0]], state["before"], state["y"]
        time_us = w.add(state["waiting"], values[ELAPSED])
        moves, a, k, c = _write_shares(w, time_us, self.rate_q31, self.shift)
        gap = w.round_shift(w.sub(w.shift_left(before, LOWPASS_FRACTION), y), 22)
        divisor = _gather_power(w, w.add(k, w.constant(9)))
        half = _gather_power(w, w.add(k, w.constant(8)))
        total = w.add(w.mul(gap, a), half)
        moved = w.op("Div", w.sub(total, w.op("Mod", total, divisor)), divisor)
        risen = w.round_shift(w.mul(w.sub(x, before), c), 7)
        after = w.op("Where", moves, w.add(w.add(y, moved), risen), y)
        return {
            "y": after,
            "before": w.op("Where", moves, x, before),
            "waiting": w.op("Where", moves, w.constant(0), time_us),
        }, w.round_shift(after, LOWPASS_FRACTION)

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write y = x."""
        x = values[self.inputs[0]]
        return {
            "y": w.shift_left(x, LOWPASS_FRACTION),
            "before": x,
            "waiting": w.mul(x, w.constant(0)),
        }

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return (
            StateField(32, f"{self.name}_before", comment="input of the last step that moved y"),
            StateField(32, f"{self.name}_waiting", comment="microseconds since then"),
            StateField(64, f"{self.name}_y"),
        )

    def express(self) -> str:
        """Return y in C, the state moved on."""
        fields = ", ".join(f"&s->{self.name}_{field}" for field in ("before", "waiting", "y"))
        numbers = f"{self.inputs[0]}, span_us, {self.rate_q31}, {self.shift}u"
        return f"zd_lowpass_after({fields}, {numbers})"


def _gather_power(w: Writer, exponent: str) -> str:
    """Write 2**exponent for exponents 0 .. 62."""
    return w.op("Gather", w.constant([1 << n for n in range(63)]), exponent)


def _write_bits(w: Writer, x: str) -> str:
    """Write `count_bits` of [B] numbers."""
    reached = w.op(
        "GreaterOrEqual",
        w.op("Unsqueeze", x, w.constant([1])),
        w.constant([[1 << n for n in range(63)]]),
    )
    return w.op("ReduceSum", w.flag(reached), w.constant([1]), keepdims=0)


def _write_shares(w: Writer, time_us: str, rate_q31: int, shift: int) -> tuple[str, str, str, str]:
    """Write `find_shares`: moves, a_q31, k and c_q31."""
    zero, one_q31 = w.constant(0), w.constant(1 << 31)
    bits = _write_bits(w, time_us)
    down = w.maximum(w.sub(bits, w.constant(32)), zero)
    up = w.saturate(w.sub(w.constant(32), bits), 0, 31)
    place = w.mul(w.op("Div", time_us, _gather_power(w, down)), _gather_power(w, up))
    product = w.mul(place, w.constant(rate_q31))
    wide = _write_bits(w, product)
    over = w.maximum(w.sub(wide, w.constant(31)), zero)
    m = w.op("Div", product, _gather_power(w, over))
    e = w.add(w.add(wide, bits), w.constant(-63 - shift))
    moves = w.op(
        "And",
        w.op("Greater", time_us, zero),
        w.op("GreaterOrEqual", e, w.constant(LEAST_EXPONENT)),
    )
    far = w.op("Greater", e, w.constant(MOST_EXPONENT))
    m = w.op("Where", far, w.constant(INT32_MAX), m)
    e = w.minimum(w.op("Where", moves, e, w.constant(LEAST_EXPONENT)), w.constant(MOST_EXPONENT))
    k = w.maximum(w.sub(zero, e), zero)
    f = w.op("Div", m, _gather_power(w, k))
    straight = w.constant(STRAIGHT_Q32[-1])
    for coefficient in reversed(STRAIGHT_Q32[:-1]):
        product = w.op("Div", w.mul(f, straight), one_q31)
        straight = w.sub(w.constant(coefficient), product)
    c = w.op("Div", w.mul(f, straight), w.constant(1 << 32))
    a = w.sub(m, w.op("Div", w.mul(m, c), one_q31))
    s = w.sub(one_q31, c)
    for doubling in range(MOST_EXPONENT):
        more = w.op("Greater", e, w.constant(doubling))
        halved = w.sub(s, w.op("Div", w.mul(s, a), w.constant(1 << 32)))
        square = w.op("Div", w.add(w.mul(a, a), w.constant(INT32_MAX)), one_q31)
        s = w.op("Where", more, halved, s)
        a = w.op("Where", more, w.sub(w.add(a, a), square), a)
    c = w.minimum(w.sub(one_q31, s), w.op("Div", a, _gather_power(w, k)))
    return moves, a, k, c


def make_lowpass_after(name: str, inputs: Sequence[str], tau_s: float) -> IntegerLowpassAfter:
    """Return the node of a time constant.

    Raises:
        CheckError: the time constant is shorter than a microsecond or longer than 34 years.
    """
    rate, shift = round_rate(max(tau_s * US_PER_S, 1.0))
    if not 1e-6 <= tau_s <= 2.0**50 * 1e-6:
        raise CheckError(
            f"a time constant of {tau_s:g} s is outside of 1e-6 to {2.0**50 * 1e-6:.3g} s, which a"
            " variable step holds; hold it at another value or state sample_period_s as a number"
        )
    return IntegerLowpassAfter(name, tuple(inputs), rate, shift)


NODES = (IntegerLowpassAfter,)
