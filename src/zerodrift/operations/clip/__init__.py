"""Limits: a converter's rails, a calibrated range."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.c_text import format_int32
from zerodrift.operations.errors import Error, Known, bound_limit
from zerodrift.operations.formats import FormattedNodes
from zerodrift.operations.intervals import Bound, Interval, check_limits
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal


def clip(x: Array, low: float, high: float) -> Array:
    """Return x limited to low .. high, limits in x's unit."""
    return np.clip(x, low, high)


@dataclass(frozen=True)
class IntegerClip(IntegerNode):
    """saturate(x, low, high)."""

    kind: ClassVar[str] = "clip"
    low: int
    high: int

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return saturate(x, low, high)."""
        return {}, np.asarray(saturate(values[self.inputs[0]], self.low, self.high))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the limits and the result."""
        limits = check_limits(self.name, self.low, self.high)
        out = inputs[0][0].saturate(self.low, self.high)
        return [out], [
            Bound(f"{self.name}.limits", limits, 32).check(),
            Bound(self.name, out, 32).check(),
        ]

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate(x, low, high)."""
        return {}, w.saturate(values[self.inputs[0]], self.low, self.high)

    def express(self) -> str:
        """Return the limited x in C."""
        low, high = format_int32(self.low), self.high
        return f"zd_clamp32({self.inputs[0]}, {low}, {high})"

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of x and that of a rounded limit (`bound_held`)."""
        return bound_limit(real, out, inputs)

    @property
    def ends(self) -> tuple[int, int]:
        """The values at which the result stands at a limit."""
        return self.low, self.high


def limit(nodes: FormattedNodes, x: Signal, low: float, high: float) -> Signal:
    """Return x limited to low .. high in its unit."""
    if not x.node:
        return Signal("", 0.0, min(max(x.offset, low), high)).standing_for("clip", (x,), low, high)
    interval = nodes.intervals[x.node][0]
    ends = sorted((end - x.offset) / x.scale for end in (low, high))
    if ends[0] <= interval.low and interval.high <= ends[1]:
        return x.standing_for("clip", (x,), low, high)
    if ends[1] <= interval.low or interval.high <= ends[0]:  # always at the same limit
        value = ends[1] if ends[1] <= interval.low else ends[0]
        always = Signal("", 0.0, value * x.scale + x.offset)
        return always.standing_for("clip", (x,), low, high)
    bottom = round(min(max(ends[0], interval.low), interval.high))
    top = round(min(max(ends[1], interval.low), interval.high))
    node = IntegerClip(nodes.new_name("clip"), (x.node,), bottom, top)
    out = Signal(nodes.append(node), x.scale, x.offset)
    return out.standing_for("clip", (x,), low, high)


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return x within its constant limits."""
    return limit(nodes, x, *node.constants)


OPERATION = Operation("clip", clip, lower, ("x",), ("low", "high"))
NODES = (IntegerClip,)
