"""First-order low-pass: the response of a thermal mass, a creeping polymer or a drying body."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT32_MAX, round_shift
from zerodrift.operations.c_text import StateField
from zerodrift.operations.errors import HALF, Error, Known
from zerodrift.operations.formats import LOWPASS_FRACTION, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Range,
    Shift,
    check_shift,
    enclose_exp,
    furthest,
    shorten,
)
from zerodrift.operations.lowpass_after import make_lowpass_after
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.recursion import filter_recursively
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import fit


def lowpass_coefficients(sample_period_s: float, tau_s: float) -> tuple[float, float, float]:
    """Return (a, b0, b1) of the exact low-pass for inputs that are straight lines between samples.

        y[n] = a y[n-1] + b0 x[n] + b1 x[n-1],   a = exp(-dt/tau),
        b0 = 1 - (tau/dt)(1 - a),                b1 = (tau/dt)(1 - a) - a

    Args:
        sample_period_s: dt > 0, seconds.
        tau_s: time constant, seconds; 0 or less passes the input through.
    """
    if tau_s <= 0.0:
        return 0.0, 1.0, 0.0
    ratio = sample_period_s / tau_s
    share = -math.expm1(-ratio) / ratio
    return math.exp(-ratio), 1.0 - share, share - math.exp(-ratio)


def lowpass(x: Array, sample_period_s: float, tau_s: float) -> Array:
    """Return x filtered by tau dy/dt + y = x, exactly for piecewise linear x, at rest at x[0].

    Args:
        x: [..., n], uninterrupted stretches along the last axis.
        sample_period_s: seconds between samples.
        tau_s: time constant, seconds; 0 or less returns x.
    """
    if tau_s <= 0.0 or x.size == 0:
        return x.copy()
    a, b0, b1 = lowpass_coefficients(sample_period_s, tau_s)
    y = np.empty_like(x)
    y[..., 0] = x[..., 0]
    if x.shape[-1] > 1:
        # With y = x at the first sample the state of the direct form II transposed is this.
        state = (b1 + a) * x[..., :1]
        y[..., 1:] = filter_recursively([b0, b1], [1.0, -a], x[..., 1:], state)
    return y


def lowpass_slope(x: Array, y: Array, sample_period_s: float, tau_s: float) -> Array:
    """Return dy/dtau of `y = lowpass(x, sample_period_s, tau_s)`, per second.

    Differentiating tau dy/dt + y = x gives tau dz/dt + z = -dy/dt with z = dy/dtau; since
    dy/dt = (x - y) / tau, z is the low-pass of (y - x) / tau. The filter is exact only for
    straight lines, so this is correct to the order of (dt/tau)^2.

    Args:
        x: [..., n] input.
        y: [..., n] output for it.
        sample_period_s: seconds between samples.
        tau_s: time constant > 0, seconds.
    """
    return lowpass((y - x) / tau_s, sample_period_s, tau_s)


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

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return True

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

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of x, of both coefficients, and of every step's rounding over all time.

        In counts of x, with A and C the real coefficients, a = m_q31 2**-(shift + 22), c = c_q24
        2**-24, and x = middle + s, |s| <= S for the real x (half its span, and its error):

            v' = v + a (x - y) + rounding     |rounding| <= a / 8 + 2**-25, from the gap's and v's
            V' = V + A (X - Y)                Y = V + C X, a mean of past X

        d = v - V - (C - c) middle obeys, with V = (1 - C) (middle + w), |w| <= S,

            d' = (1 - a) d + a (1 - c) (x - X) + (a - A) (1 - C) (s - w) + a (C - c) s + rounding

        so |d| <= (1 - c) error + 2 |1 - A / a| (1 - C) S + |C - c| S + 1/8 + 2**-25 / a, as it is
        at rest too. y - Y = d + c (x - X) + (c - C) s, and y is rounded once. x - X passes with a
        gain of 1 - c and of c: of 1.
        """
        (x,) = inputs
        tau_s, period_s = map(Fraction, real.numbers)
        a = Fraction(self.m_q31, 1 << (self.shift + 22))
        c = Fraction(self.c_q24, 1 << LOWPASS_FRACTION)
        kept = enclose_exp(-period_s / tau_s)
        steps = tau_s / period_s
        ratio = max(abs(1 - (1 - end) / a) for end in kept)
        straight = Range(1 - steps * (1 - kept.low), 1 - steps * (1 - kept.high))
        share = furthest(c, straight)
        span = Fraction(x.high - x.low, 2) + x.error.total / abs(x.scale)
        memory = 2 * ratio * (1 - straight.low) * span + 2 * share * span
        counts = memory + Fraction(1, 8) + Fraction(1, 1 << 25) / a + HALF
        return x.error + Error(lowpass=shorten(counts * abs(out.scale)))

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write y = v + c x and v' = v + a (x - y)."""
        x = values[self.inputs[0]]
        y = w.add(state["v"], w.mul(x, w.constant(self.c_q24)))
        gap = w.round_shift(w.sub(w.shift_left(x, LOWPASS_FRACTION), y), 22)
        v = w.add(state["v"], w.round_shift(w.mul(gap, w.constant(self.m_q31)), self.shift))
        return {"v": v}, w.round_shift(y, LOWPASS_FRACTION)

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the v at which y equals x."""
        share = (1 << LOWPASS_FRACTION) - self.c_q24
        return {"v": w.mul(values[self.inputs[0]], w.constant(share))}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return (StateField(64, f"{self.name}_v"),)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}.shift", self.shift, 62)]

    def express(self) -> str:
        """Return y in C, and v moved on."""
        place, x = f"&s->{self.name}_v", self.inputs[0]
        return f"zd_lowpass({place}, {x}, {self.c_q24}, {self.m_q31}, {self.shift}u)"


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return x after the low-pass, in its own format."""
    tau_s = node.constants[0]
    if tau_s <= 0.0 or not x.node:
        return x
    if nodes.variable_step:
        x = fit(nodes, x, SIGNAL_BITS)
        told = make_lowpass_after(nodes.new_name("lowpass"), (x.node,), tau_s)
        out = Signal(nodes.append(told), x.scale, x.offset)
        return out.standing_for("lowpass", (x,), tau_s, nodes.sample_period_s)
    _, b0, _ = lowpass_coefficients(nodes.sample_period_s, tau_s)
    share = -math.expm1(-nodes.sample_period_s / tau_s)
    exponent = -math.frexp(share)[1]
    if exponent > 31:
        raise CheckError(
            f"a time constant of {tau_s:g} s is over 2^31 steps of {nodes.sample_period_s:g} s;"
            " hold it at a smaller value or use a longer sample period"
        )
    x = fit(nodes, x, SIGNAL_BITS)
    late = IntegerLowpass(
        name=nodes.new_name("lowpass"),
        inputs=(x.node,),
        c_q24=round(b0 * 2**LOWPASS_FRACTION),
        m_q31=min(round(share * 2.0 ** (31 + exponent)), 2**31 - 1),
        shift=31 + exponent - 22,
    )
    out = Signal(nodes.append(late), x.scale, x.offset)
    return out.standing_for("lowpass", (x,), tau_s, nodes.sample_period_s)


OPERATION = Operation("lowpass", lowpass, lower, ("x",), ("tau_s",), timed=True)
NODES = (IntegerLowpass,)
