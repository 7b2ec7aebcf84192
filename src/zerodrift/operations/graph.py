"""An effect's definition as a graph of nodes: what the exporter walks to integers and C."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Node:
    """One operation with its inputs and constants, never repeated within one `GraphOperations`.

    `op` is an operation's name, "constant", or "input" with the signal's name in `source`.
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
