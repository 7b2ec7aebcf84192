"""Computes nodes of a float ONNX graph whose inputs are all constants, within limits of size."""

import math
from collections.abc import Sequence

import numpy as np
import onnx
from numpy.typing import NDArray

from zerodrift.export.onnx_values import Unsupported

LARGEST = 2**24
"""Elements of a result; beyond it no network of a microcontroller is meant."""
ELEMENTWISE = frozenset(
    {"Add", "Sub", "Mul", "Div", "Pow", "Max", "Min", "Where", "Equal", "Less", "Greater"}
)
UNARY = frozenset(
    {
        "Neg",
        "Sqrt",
        "Reciprocal",
        "Exp",
        "Log",
        "Abs",
        "Cast",
        "Identity",
        "Transpose",
        "Reshape",
        "Squeeze",
        "Unsqueeze",
        "Flatten",
        "Slice",
        "Split",
        "Shape",
        "Concat",
        "ReduceMean",
        "ReduceSum",
        "Not",
    }
)
"""Their result is no larger than what they are given."""
PRODUCTS = frozenset({"Gather", "MatMul"})


def fold_constants(
    node: onnx.NodeProto, inputs: Sequence[NDArray[np.generic] | None]
) -> list[NDArray[np.generic]] | None:
    """Return a node's outputs, or None for an operator that is not computed here.

    Raises:
        Unsupported: the result would be too large, or the operator rejects its inputs.
    """
    if node.op_type not in ELEMENTWISE | UNARY | PRODUCTS or not inputs:
        return None
    given = [x for x in inputs if x is not None]
    if node.op_type in ELEMENTWISE:
        size = math.prod(np.broadcast_shapes(*(x.shape for x in given)))
    elif node.op_type == "Gather":
        size = given[0].size * max(given[1].size, 1)
    elif node.op_type == "MatMul":
        a, b = (x.shape if x.ndim > 1 else (1, *x.shape) for x in given)
        size = math.prod(np.broadcast_shapes(a[:-2], b[:-2])) * a[-2] * b[-1]
    else:
        size = sum(x.size for x in given)
    if size > LARGEST:
        raise Unsupported(f"its result would have up to {size} elements")
    from onnx.reference import ReferenceEvaluator

    names = {n: x for n, x in zip(node.input, inputs, strict=True) if n}
    try:
        return [np.asarray(y) for y in ReferenceEvaluator(node).run(None, names)]
    except Exception as error:
        raise Unsupported(f"it cannot be computed from its constants ({error})") from error
