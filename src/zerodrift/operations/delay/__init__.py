"""Delay by a fixed time, also by a fraction of a sample."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT32_MAX, round_shift
from zerodrift.operations.c_text import StateField, list_ring
from zerodrift.operations.errors import HALF, Error, Known
from zerodrift.operations.formats import FormattedNodes
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal


def delay_taps(sample_period_s: float, delay_s: float) -> tuple[int, float]:
    """Return the delay as whole samples and a share 0 <= share < 1 of one more."""
    steps = max(delay_s, 0.0) / sample_period_s
    whole = math.floor(steps + 1e-9)
    return whole, max(steps - whole, 0.0)


def delay(x: Array, sample_period_s: float, delay_s: float) -> Array:
    """Return x as it was `delay_s` ago, on straight lines between samples; before x[0] it was x[0].

    Args:
        x: [..., n], uninterrupted stretches along the last axis.
        sample_period_s: seconds between samples.
        delay_s: seconds; 0 or less returns x.
    """
    whole, share = delay_taps(sample_period_s, delay_s)
    late = _shift(x, whole)
    if share == 0.0:
        return late
    return np.asarray((1.0 - share) * late + share * _shift(x, whole + 1))


def _shift(x: Array, steps: int) -> Array:
    """Return x `steps` samples later, filled with the first value in front."""
    if steps <= 0 or x.size == 0:
        return x.copy()
    late = np.empty_like(x)
    late[..., :steps] = x[..., :1]
    late[..., steps:] = x[..., : max(x.shape[-1] - steps, 0)]
    return late


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

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return True

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

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of x, of the age that it is read at, and of one rounding.

        The result is a weighted mean of two samples. One that is read at another age, by some
        share of a step, is off by that share of the signal's span at most.
        """
        (x,) = inputs
        delay_s, period_s = map(Fraction, real.numbers)
        age = self.steps - Fraction(self.newer_q31, 1 << 31)
        wrong = abs(age - delay_s / period_s) * (x.high - x.low)
        rounded = HALF if self.newer_q31 else Fraction(0)
        unit = abs(out.scale)
        return x.error + Error(coefficients=wrong * unit, rounding=rounded * unit)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write older + (newer - older) newer_q31, and the line moved on by one."""
        x = w.op("Unsqueeze", values[self.inputs[0]], w.constant([1]))
        line = w.op("Concat", state["line"], x, axis=1)
        older, newer = w.column(line, 0), w.column(line, 1)
        rise = w.round_shift(w.mul(w.sub(newer, older), w.constant(self.newer_q31)), 31)
        moved = w.split(line, (1, self.steps))[1]
        return {"line": moved}, w.add(older, rise) if self.newer_q31 else older

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write a line filled with the present input."""
        x = w.op("Unsqueeze", values[self.inputs[0]], w.constant([1]))
        return {"line": w.op("Tile", x, w.constant([1, self.steps]))}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return list_ring(self.name, "line", 32, (self.steps,))

    @property
    def idle(self) -> frozenset[str]:
        """The mix of two samples, where the delay is by whole ones."""
        return frozenset() if self.newer_q31 else frozenset({f"{self.name}.rise"})


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return x as it was some time ago: whole steps, and a share of one more."""
    delay_s = node.constants[0]
    if nodes.variable_step and delay_s > 0.0 and x.node:
        raise CheckError(
            f"a delay of {delay_s:g} s: it is a line of samples at equal times, and a variable step"
            " has none. Remove what delays, or state sample_period_s as a number."
        )
    whole, share = delay_taps(nodes.sample_period_s, delay_s)
    newer_q31 = round((1.0 - share) * 2.0**31) if share > 1e-6 else 0
    steps = whole if newer_q31 == 0 else whole + 1
    if newer_q31 >= 2**31:  # a share below the resolution
        steps, newer_q31 = whole, 0
    if steps == 0 or not x.node:
        return x.standing_for("delay", (x,), delay_s, nodes.sample_period_s)
    if steps > 32767:
        raise CheckError(
            f"a delay of {delay_s:g} s is {steps} steps of {nodes.sample_period_s:g} s; the"
            " firmware's ring holds 32767. Use a shorter delay or a longer sample period."
        )
    late = IntegerDelay(nodes.new_name("delay"), (x.node,), steps, newer_q31)
    out = Signal(nodes.append(late), x.scale, x.offset)
    return out.standing_for("delay", (x,), delay_s, nodes.sample_period_s)


OPERATION = Operation("delay", delay, lower, ("x",), ("delay_s",), timed=True)
NODES = (IntegerDelay,)
