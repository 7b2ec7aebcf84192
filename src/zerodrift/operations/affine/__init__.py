"""Gain and offset by constants: changes of unit and of origin, such as T - T0."""

from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.formats import FormattedNodes
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Signal, constant


def affine(x: Array, gain: float, offset: float) -> Array:
    """Return gain * x + offset."""
    return np.asarray(gain * x + offset)


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return the same integers with another meaning: nothing is to be computed."""
    gain, offset = node.constants
    if gain == 0.0:
        return constant(offset)
    out = replace(x, scale=x.scale * gain, offset=x.offset * gain + offset)
    return out.standing_for("linear", (x, constant(offset)), gain, 1.0)


OPERATION = Operation("affine", affine, lower, ("x",), ("gain", "offset"))
