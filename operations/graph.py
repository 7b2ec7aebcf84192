"""An effect's definition recorded as a graph: what the exporter walks to integers and C."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.backend import NumpyOperations

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Node:
    """One operation with its inputs and constants, never repeated within one `GraphOperations`.

    `op` is a method's name of `Operations`, or "input" with the signal's name in `source`.
    """

    op: str
    inputs: tuple["Node", ...] = ()
    constants: tuple[float, ...] = ()
    """The operation's numbers in the order of its arguments, as affine (gain, offset)."""
    source: str = ""
    """For "input": temperature_degC, load:Fz, elapsed_s, clock_s or a channel's name."""

    def __repr__(self) -> str:
        arguments = [repr(node) for node in self.inputs] + [f"{c:g}" for c in self.constants]
        return self.source or f"{self.op}({', '.join(arguments)})"


_Key = tuple[str, tuple[int, ...], tuple[float, ...], str]


@dataclass
class GraphOperations:
    """The operations recorded as nodes; asking twice for the same node gives the same object."""

    sample_period_s: float
    _nodes: dict[_Key, Node] = field(default_factory=dict)

    def input(self, source: str) -> Node:
        """Return the node of the signal named `source`."""
        return self._node("input", source=source)

    def constant(self, value: float) -> Node:
        """Return a signal that is always `value`."""
        return self._node("constant", constants=(value,))

    def affine(self, x: Node, gain: float, offset: float) -> Node:
        """Return gain * x + offset."""
        return self._node("affine", (x,), (gain, offset))

    def total(self, a: Node, b: Node) -> Node:
        """Return a + b."""
        return self._node("total", (a, b))

    def difference(self, a: Node, b: Node) -> Node:
        """Return a - b."""
        return self._node("difference", (a, b))

    def product(self, a: Node, b: Node) -> Node:
        """Return a * b."""
        return self._node("product", (a, b))

    def power(self, x: Node, exponent: float) -> Node:
        """Return x**exponent."""
        return self._node("power", (x,), (exponent,))

    def exp2(self, x: Node) -> Node:
        """Return 2**x."""
        return self._node("exp2", (x,))

    def lowpass(self, x: Node, tau_s: float) -> Node:
        """Return x after a first-order low-pass, at rest at its first sample."""
        return self._node("lowpass", (x,), (tau_s,))

    def delay(self, x: Node, delay_s: float) -> Node:
        """Return x as it was `delay_s` ago."""
        return self._node("delay", (x,), (delay_s,))

    def play(self, x: Node, half_width: float) -> Node:
        """Return the play operator (backlash) of x."""
        return self._node("play", (x,), (half_width,))

    def clip(self, x: Node, low: float, high: float) -> Node:
        """Return x limited to low .. high."""
        return self._node("clip", (x,), (low, high))

    def _node(
        self,
        op: str,
        inputs: tuple[Node, ...] = (),
        constants: tuple[float, ...] = (),
        source: str = "",
    ) -> Node:
        constants = tuple(float(c) for c in constants)
        key = (op, tuple(id(node) for node in inputs), constants, source)
        if key not in self._nodes:
            self._nodes[key] = Node(op, inputs, constants, source)
        return self._nodes[key]


def list_nodes(roots: Iterable[Node]) -> list[Node]:
    """Return every node that `roots` need, each once, inputs before what uses them."""
    order: list[Node] = []
    seen: set[int] = set()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, inputs_done = stack.pop()
        if inputs_done:
            order.append(node)
        elif id(node) not in seen:
            seen.add(id(node))
            stack.append((node, True))
            stack.extend((child, False) for child in reversed(node.inputs))
    return order


def evaluate(
    roots: Iterable[Node], inputs: Mapping[str, Array], sample_period_s: float
) -> list[Array]:
    """Return the value of every root, equal to what the NumPy backend gives.

    Args:
        roots: the wanted nodes.
        inputs: signal name -> [..., n], uninterrupted stretches along the last axis.
        sample_period_s: seconds between samples.
    """
    roots = list(roots)
    ops: Any = NumpyOperations(sample_period_s, next(iter(inputs.values())).shape)
    values: dict[int, Array] = {}
    for node in list_nodes(roots):
        if node.op == "input":
            values[id(node)] = inputs[node.source]
        else:
            arguments = [values[id(child)] for child in node.inputs]
            values[id(node)] = getattr(ops, node.op)(*arguments, *node.constants)
    return [values[id(root)] for root in roots]
