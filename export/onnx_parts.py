"""Parts of a foreign graph: found, evaluated in float64, and put back as one recurrent node."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from zerodrift.base.arrays import Array
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru.onnx import to_onnx_gates as gru_to_onnx
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.lstm.onnx import to_onnx_gates as lstm_to_onnx

EXACT = 1e-9
"""Relative: what is left where the equations hold, in float64."""
MOST_WIDTH = 1024
_WIDEN = {TensorProto.FLOAT: TensorProto.DOUBLE, TensorProto.FLOAT16: TensorProto.DOUBLE}


@dataclass(frozen=True)
class CellPart:
    """The nodes between what a cell reads and the state that it gives."""

    nodes: tuple[onnx.NodeProto, ...]
    given: tuple[str, ...]
    """What they read that does not depend on the states."""
    states: tuple[str, ...]
    """h, or h and c, before the step."""
    out: str
    """h after it."""


@dataclass(frozen=True)
class FoundCell:
    """What a part of a graph computes."""

    cell: FloatGru | FloatLstm
    after: str
    """Name of c after the step; "" for a GRU."""
    ranks: Mapping[str, int]
    """Axes of what it reads, and of what it gives."""
    scale: float = 1.0
    offset: float = 0.0
    """The graph's state is scale h + offset of the cell's."""


def is_state(value: onnx.ValueInfoProto) -> bool:
    """Tell whether an input is one row of numbers: [H], [B, H] or [1, 1, H]."""
    dims = value.type.tensor_type.shape.dim
    if len(dims) == 3 and any(d.dim_value != 1 for d in dims[:2]):
        return False
    return len(dims) in (1, 2, 3) and 0 < dims[-1].dim_value <= MOST_WIDTH


def list_above(makers: Mapping[str, onnx.NodeProto], *outs: str) -> set[str]:
    """Return the names of all values that some values depend on, these included."""
    found, stack = {*outs}, [*outs]
    while stack:
        node = makers.get(stack.pop())
        for name in node.input if node is not None else ():
            if name and name not in found:
                found.add(name)
                stack.append(name)
    return found


def is_constant(
    name: str,
    makers: Mapping[str, onnx.NodeProto],
    inputs: Mapping[str, onnx.ValueInfoProto],
    fixed: set[str],
) -> bool:
    """Tell whether a value follows from the file alone."""
    above = list_above(makers, name)
    return name in fixed or not above & set(inputs)


def agree(a: Array, b: Array) -> bool:
    """Tell whether two arrays are equal as far as float64 is."""
    return bool(np.abs(a - b).max(initial=0.0) <= EXACT * max(1.0, np.abs(b).max(initial=0.0)))


def sigmoid(a: Array) -> Array:
    """Return 1 / (1 + exp(-a))."""
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * a))


class Asking:
    """A part of a graph in float64, evaluated for random inputs."""

    def __init__(
        self, graph: onnx.GraphProto, part: CellPart, wanted: Sequence[str], opset: int
    ) -> None:
        from onnx.reference import ReferenceEvaluator

        whole = _widen(graph)
        self._wanted = list(dict.fromkeys(wanted))
        self._names = [*part.given, *part.states]
        _check_rows(whole, part.states)
        inputs = {
            i.name: tuple(max(d.dim_value, 1) for d in i.type.tensor_type.shape.dim)
            for i in whole.input
        }
        rng = np.random.default_rng(1)
        feed = {name: rng.normal(size=shape) for name, shape in inputs.items()}
        first = ReferenceEvaluator(_model(whole, list(inputs), self._names, opset)).run(None, feed)
        self._shapes = {n: np.shape(v) for n, v in zip(self._names, first, strict=True)}
        if any(not s or s[:-1] not in ((), (1,), (1, 1)) for s in self._shapes.values()):
            raise ValueError("what the cell reads is no row of numbers")
        self.ranks = {name: len(shape) for name, shape in self._shapes.items()}
        self.widths = {name: int(shape[-1]) for name, shape in self._shapes.items()}
        if sum(self.widths.values()) > 4 * MOST_WIDTH:
            raise ValueError("the cell is too wide")
        self._evaluator = ReferenceEvaluator(_model(whole, self._names, self._wanted, opset))

    def draw(self, count: int) -> dict[str, Array]:
        """Return [count, width] of what was given and of what was asked for."""
        rng = np.random.default_rng(2)
        given = {name: rng.normal(size=(count, width)) for name, width in self.widths.items()}
        answers: list[list[Array]] = []
        for row in range(count):
            feed = {n: v[row].reshape(self._shapes[n]) for n, v in given.items()}
            found = self._evaluator.run(None, feed)
            self.ranks |= {n: np.ndim(a) for n, a in zip(self._wanted, found, strict=True)}
            answers.append([np.ravel(a) for a in found])
        columns = zip(*answers, strict=True)
        return given | {
            name: np.stack(rows) for name, rows in zip(self._wanted, columns, strict=True)
        }


def _check_rows(graph: onnx.GraphProto, states: Sequence[str]) -> None:
    """Raise ValueError where an input may have rows that the states have not: a sequence."""
    fixed = {tensor.name for tensor in graph.initializer}
    leading = {
        i.name: [d.dim_value for d in i.type.tensor_type.shape.dim][:-1]
        for i in graph.input
        if i.name not in fixed
    }
    one = all(n == 1 for state in states for n in leading[state])
    if one and any(n != 1 for dims in leading.values() for n in dims):
        raise ValueError("the input is a sequence, the states are of one step")


def _model(
    graph: onnx.GraphProto, inputs: Sequence[str], outputs: Sequence[str], opset: int
) -> onnx.ModelProto:
    """Return what lies between other inputs and outputs of a graph as a model of float64.

    Nothing else is in it: an evaluator runs every node, also those that it cannot run and that
    nothing asks for.
    """

    def info(name: str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.DOUBLE, None)

    makers = {n: node for node in graph.node for n in node.output if n not in inputs}
    needed = list_above(makers, *outputs) - set(inputs)
    own = helper.make_graph(
        [node for node in graph.node if needed & set(node.output)],
        "part",
        [info(n) for n in inputs],
        [info(n) for n in outputs],
        list(graph.initializer),
    )
    return helper.make_model(own, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)


def _widen(graph: onnx.GraphProto) -> onnx.GraphProto:
    """Return a graph whose numbers are float64."""
    wide = onnx.GraphProto()
    wide.CopyFrom(graph)
    tensors = [*wide.initializer]
    tensors += [a.t for n in wide.node for a in n.attribute if a.HasField("t")]
    for tensor in tensors:
        if tensor.data_type in _WIDEN:
            array = numpy_helper.to_array(tensor).astype(np.float64)
            tensor.CopyFrom(numpy_helper.from_array(array, tensor.name))
    for node in wide.node:
        for attribute in node.attribute:
            if node.op_type == "Cast" and attribute.name == "to":
                attribute.i = _WIDEN.get(attribute.i, attribute.i)
    return wide


def put_back(graph: onnx.GraphProto, part: CellPart, found: FoundCell, opset: int) -> None:
    """Let one node give the state, in the place of the node that gave it."""
    where = next(k for k, n in enumerate(graph.node) if part.out in n.output)
    mark = part.out
    cell, after = found.cell, found.after
    nodes: list[onnx.NodeProto] = []
    constants: list[onnx.TensorProto] = []

    def constant(what: str, value: Array | NDArray[np.int64]) -> str:
        constants.append(numpy_helper.from_array(value, f"{mark}/{what}"))
        return f"{mark}/{what}"

    def reshape(op: str, value: str, result: str, rank: int) -> str:
        axes = [0] if rank == 2 else [0, 1]
        if rank == 3:  # [time, batch, H] already
            nodes.append(helper.make_node("Identity", [value], [result], name=result))
        elif opset < 13:
            nodes.append(helper.make_node(op, [value], [result], name=result, axes=axes))
        else:
            at = constant(f"{result}/axes", np.array(axes))
            nodes.append(helper.make_node(op, [value, at], [result], name=result))
        return result

    x = part.given[0]
    if len(part.given) > 1:
        x = f"{mark}/given"
        nodes.append(helper.make_node("Concat", list(part.given), [x], name=x, axis=-1))
    wide = [
        reshape("Unsqueeze", name, f"{mark}/{index}", found.ranks[own])
        for index, (name, own) in enumerate(
            [(x, part.given[0]), *((state, state) for state in part.states)]
        )
    ]
    gru = isinstance(cell, FloatGru)
    w, r, b = gru_to_onnx(cell) if isinstance(cell, FloatGru) else lstm_to_onnx(cell)
    weights = [constant(n, v[None]) for n, v in (("W", w), ("R", r), ("B", b))]
    reset = (
        {"linear_before_reset": int(cell.reset == "after")} if isinstance(cell, FloatGru) else {}
    )
    results = ["", f"{mark}/h"] if gru else ["", f"{mark}/h", f"{mark}/c"]
    nodes.append(
        helper.make_node(
            "GRU" if gru else "LSTM",
            [wide[0], *weights, "", *wide[1:]],
            results,
            name=f"cell of '{mark}'",
            hidden_size=cell.w_h.shape[1],
        )
    )
    nodes[-1].attribute.extend(helper.make_attribute(k, v) for k, v in reset.items())
    moved = (found.scale, found.offset) != (1.0, 0.0)
    reshape("Squeeze", f"{mark}/h", f"{mark}/own" if moved else part.out, found.ranks[part.out])
    if moved:
        factor, offset = (
            constant("scale", np.array(found.scale)),
            constant("offset", np.array(found.offset)),
        )
        nodes.append(helper.make_node("Mul", [f"{mark}/own", factor], [f"{mark}/scaled"]))
        nodes.append(helper.make_node("Add", [f"{mark}/scaled", offset], [part.out]))
    if after:
        reshape("Squeeze", f"{mark}/c", after, found.ranks[after])
    for name in (part.out, *([after] if after else [])):
        for node in graph.node:
            for k, output in enumerate(node.output):
                if output == name:
                    node.output[k] = f"{name}/taken apart"
    rest = [*graph.node]
    every = [*rest[:where], *nodes, *rest[where:]]
    makers = {name: node for node in every for name in node.output}
    needed = list_above(makers, *(o.name for o in graph.output))
    del graph.node[:]
    graph.node.extend(node for node in every if needed & set(node.output))
    graph.initializer.extend(constants)
