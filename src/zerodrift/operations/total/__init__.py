"""Sum of two signals."""

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.difference import combine
from zerodrift.operations.formats import FormattedNodes
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Signal


def total(a: Array, b: Array) -> Array:
    """Return a + b, both in the same unit."""
    return np.asarray(a + b)


def lower(nodes: FormattedNodes, node: Node, a: Signal, b: Signal) -> Signal:
    """Return a + b."""
    return combine(nodes, node, a, b, 1.0)


OPERATION = Operation("total", total, lower, ("a", "b"))
