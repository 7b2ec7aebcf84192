"""Difference of two signals: what a sensor's own memory is made of."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.errors import Error, Known, bound_sum, list_terms
from zerodrift.operations.formats import EXACT_BITS, FormattedNodes
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import add


def difference(a: Array, b: Array) -> Array:
    """Return a - b, both in the same unit."""
    return np.asarray(a - b)


@dataclass(frozen=True)
class IntegerDifference(IntegerNode):
    """a - b, both at the same exponent."""

    kind: ClassVar[str] = "difference"
    reads: ClassVar[int | None] = 2

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return a - b."""
        return {}, values[self.inputs[0]] - values[self.inputs[1]]

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the difference, as if a and b were independent."""
        out = inputs[0][0] - inputs[1][0]
        return [out], [Bound(self.name, out, 32).check()]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the errors of both; nothing is rounded."""
        a, b = self.inputs
        chip = {(a, 0): out.scale, (b, 0): -out.scale}
        return bound_sum(list_terms(real, inputs), chip, out.offset, "coefficients")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a - b."""
        return {}, w.sub(values[self.inputs[0]], values[self.inputs[1]])

    def express(self) -> str:
        """Return a - b in C."""
        return f"{self.inputs[0]} - {self.inputs[1]}"


def combine(nodes: FormattedNodes, node: Node, a: Signal, b: Signal, sign: float) -> Signal:
    """Return a + sign * b, which needs a node only where both move."""
    offset = a.offset + sign * b.offset
    return _combine(nodes, node, a, b, sign, offset).standing_for("linear", (a, b), 1.0, sign)


def _combine(
    nodes: FormattedNodes, node: Node, a: Signal, b: Signal, sign: float, offset: float
) -> Signal:
    if not b.node:
        return replace(a, offset=offset)
    if not a.node:
        return Signal(b.node, sign * b.scale, offset)
    scale = a.scale + sign * b.scale
    if a.node == b.node:
        return Signal(a.node, scale, offset) if scale else Signal("", 0.0, offset)
    if a.scale == -sign * b.scale:
        out = nodes.intervals[a.node][0] - nodes.intervals[b.node][0]
        if out.magnitude < 2**EXACT_BITS:
            difference = IntegerDifference(nodes.new_name("difference"), (a.node, b.node))
            return Signal(nodes.append(difference), a.scale, offset)
    low, high = nodes.find_limits(node, offset)
    return add(nodes, [a, replace(b, scale=sign * b.scale)], low, high, offset)


def lower(nodes: FormattedNodes, node: Node, a: Signal, b: Signal) -> Signal:
    """Return a - b."""
    return combine(nodes, node, a, b, -1.0)


OPERATION = Operation("difference", difference, lower, ("a", "b"))
NODES = (IntegerDifference,)
