"""An effect's definition as a graph of nodes, and an operation as effects call it."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from zerodrift.base.arrays import Array
from zerodrift.operations.signals import Signal

# An effect's definition as a graph of nodes: what the exporter walks to integers and C.


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


# An operation as effects call it: its float meaning, and how it becomes integer nodes.


@dataclass(frozen=True)
class Operation:
    """An operation of the float graph: `ops.NAME(signals..., constants...)` in an effect."""

    name: str
    compute: Callable[..., Array]
    """The float meaning: signals are arrays with time along the last axis; constants by name."""
    lower: Callable[..., Signal]
    """(nodes, node, *signals): the integer meaning of a float `Node` among `FormattedNodes`."""
    signals: tuple[str, ...]
    constants: tuple[str, ...] = ()
    timed: bool = False
    """Whether `compute` is given `sample_period_s`, too."""

    @property
    def arity(self) -> int:
        """Number of arguments."""
        return len(self.signals) + len(self.constants)

    def order_arguments(
        self, given: tuple[object, ...], named: Mapping[str, object]
    ) -> tuple[object, ...]:
        """Return the arguments of a call in their order.

        Raises:
            TypeError: one is missing, or there are too many.
        """
        names = (*self.signals, *self.constants)
        rest = names[len(given) :]
        if len(given) > len(names) or set(rest) != set(named):
            raise TypeError(
                f"{self.name}({', '.join(names)}) was given {len(given)} arguments"
                + "".join(f" and {name}" for name in named)
            )
        return (*given, *(named[name] for name in rest))
