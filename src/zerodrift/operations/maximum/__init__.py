"""The larger of two signals: a rectified rate, the hotter of two bodies."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.clip import limit
from zerodrift.operations.errors import Error, Known, larger
from zerodrift.operations.formats import FormattedNodes
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import align


def maximum(a: Array, b: Array) -> Array:
    """Return the larger of a and b, both in the same unit."""
    return np.maximum(a, b)


@dataclass(frozen=True)
class IntegerMaximum(IntegerNode):
    """The larger of a and b, both in one format."""

    kind: ClassVar[str] = "maximum"
    reads: ClassVar[int | None] = 2

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the larger one."""
        return {}, np.maximum(*(values[name] for name in self.inputs))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the result: each of its ends is the larger of two ends."""
        a, b = inputs[0][0], inputs[1][0]
        out = Interval(max(a.low, b.low), max(a.high, b.high))
        return [out], [Bound(self.name, out, 32).check()]

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write the larger one."""
        return {}, w.maximum(*(values[name] for name in self.inputs))

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the larger error: no two numbers' maximum moves by more than one of them."""
        return larger([x.error for x in inputs])

    def express(self) -> str:
        """Return the larger one in C."""
        a, b = self.inputs
        return f"({a} > {b}) ? {a} : {b}"


def lower(nodes: FormattedNodes, node: Node, a: Signal, b: Signal) -> Signal:
    """Return the larger of a and b; one that is constant is a limit of the other."""
    a, b = align(nodes, node, (a, b))
    return _lower(nodes, a, b).standing_for("maximum", (a, b))


def _lower(nodes: FormattedNodes, a: Signal, b: Signal) -> Signal:
    if a == b:
        return a
    if not (a.node and b.node):
        moving, constant = (a, b) if a.node else (b, a)
        return limit(nodes, moving, constant.offset, math.inf)
    node = IntegerMaximum(nodes.new_name("maximum"), (a.node, b.node))
    return replace(a, node=nodes.append(node))


OPERATION = Operation("maximum", maximum, lower, ("a", "b"))
NODES = (IntegerMaximum,)
