"""The operations that an effect is written with, either computed at once or recorded as nodes.

`NumpyOperations` returns arrays; `GraphOperations` returns nodes that the exporter turns into
integers and C. An effect's definition is the same for both.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Generic, SupportsFloat, TypeVar, cast

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.operation import Node, Operation, list_nodes
from zerodrift.operations.registry import OPERATIONS

S = TypeVar("S")


class Operations(ABC, Generic[S]):
    """The operations a compensator is made of, on signals of type S (arrays or graph nodes).

    Each operation of the registry is a method: `ops.lowpass(x, tau_s)`.

    Args:
        sample_period_s: seconds between samples.
    """

    def __init__(self, sample_period_s: float) -> None:
        self.sample_period_s = sample_period_s

    @abstractmethod
    def constant(self, value: float) -> S:
        """Return a signal that is always `value`."""

    @abstractmethod
    def apply(self, operation: Operation, arguments: tuple[object, ...]) -> S:
        """Return the result of an operation on signals and, after them, constants."""

    def __getattr__(self, name: str) -> Callable[..., S]:
        if name not in OPERATIONS:
            raise AttributeError(f"there is no operation {name!r}; there are {sorted(OPERATIONS)}")
        # Not kept in the instance: whoever holds itself, and all that is computed, waits for the
        # garbage collector.
        return partial(self._call, OPERATIONS[name])

    def _call(self, operation: Operation, /, *given: object, **named: object) -> S:
        if named or len(given) != operation.arity:
            given = operation.order_arguments(given, named)
        return self.apply(operation, given)


class NumpyOperations(Operations[Array]):
    """The operations computed at once, on float64 arrays with time along the last axis.

    Args:
        sample_period_s: seconds between samples.
        shape: shape of the signals, (n,) for one uninterrupted stretch.
    """

    def __init__(self, sample_period_s: float, shape: tuple[int, ...]) -> None:
        super().__init__(sample_period_s)
        self._shape = shape

    def constant(self, value: float) -> Array:
        """Return an array of `value`."""
        return np.full(self._shape, value)

    def apply(self, operation: Operation, arguments: tuple[object, ...]) -> Array:
        """Return the operation's float meaning."""
        if not operation.timed:
            return operation.compute(*arguments)
        names = (*operation.signals, *operation.constants)
        named = dict(zip(names, arguments, strict=True))
        return operation.compute(**named, sample_period_s=self.sample_period_s)

    def compute(self, node: Node, signals: Sequence[Array]) -> Array:
        """Return the value of a node that is no input, from those of its inputs."""
        if node.op == "constant":
            return self.constant(node.constants[0])
        return self.apply(OPERATIONS[node.op], (*signals, *node.constants))


_Key = tuple[str, tuple[int, ...], tuple[float, ...], str]


class GraphOperations(Operations[Node]):
    """The operations recorded as nodes; asking twice for the same node gives the same object."""

    def __init__(self, sample_period_s: float) -> None:
        super().__init__(sample_period_s)
        self._nodes: dict[_Key, Node] = {}

    def input(self, source: str) -> Node:
        """Return the node of the signal named `source`."""
        return self._node("input", source=source)

    def constant(self, value: float) -> Node:
        """Return a signal that is always `value`."""
        return self._node("constant", constants=(float(value),))

    def apply(self, operation: Operation, arguments: tuple[object, ...]) -> Node:
        """Return the operation's node."""
        count = len(operation.signals)
        constants = (float(cast(SupportsFloat, number)) for number in arguments[count:])
        signals = cast(tuple[Node, ...], arguments[:count])
        return self._node(operation.name, signals, tuple(constants))

    def _node(
        self,
        op: str,
        inputs: tuple[Node, ...] = (),
        constants: tuple[float, ...] = (),
        source: str = "",
    ) -> Node:
        key = (op, tuple(id(node) for node in inputs), constants, source)
        if key not in self._nodes:
            self._nodes[key] = Node(op, inputs, constants, source)
        return self._nodes[key]


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
    ops = NumpyOperations(sample_period_s, next(iter(inputs.values())).shape)
    values: dict[int, Array] = {}
    for node in list_nodes(roots):
        if node.op == "input":
            values[id(node)] = inputs[node.source]
        else:
            arguments = [values[id(child)] for child in node.inputs]
            values[id(node)] = ops.compute(node, arguments)
    return [values[id(root)] for root in roots]
