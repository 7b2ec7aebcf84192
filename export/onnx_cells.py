"""Single steps of a GRU or an LSTM that an exporter has taken apart become one node again.

PyTorch writes `GRUCell` and `LSTMCell` as products, sums, sigmoids and tanhs, each version in
another order. Such a part of a graph is identified by evaluating it: the arguments of its sigmoids
and tanhs are linear in its inputs, so a few hundred random numbers give its weights, in float64,
and further ones confirm them. A part that does not follow the equations is left as it is.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru.onnx import to_onnx_gates as gru_to_onnx
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.lstm.onnx import to_onnx_gates as lstm_to_onnx

Array = NDArray[np.float64]

EXACT = 1e-9
"""Relative: what is left where the equations hold, in float64."""
MOST_WIDTH = 1024
SPARE = 24
"""Samples beyond the unknowns."""
_WIDEN = {TensorProto.FLOAT: TensorProto.DOUBLE, TensorProto.FLOAT16: TensorProto.DOUBLE}


@dataclass(frozen=True)
class _Part:
    """The nodes between what a cell reads and the state that it gives."""

    nodes: tuple[onnx.NodeProto, ...]
    given: tuple[str, ...]
    """What they read that does not depend on the states."""
    states: tuple[str, ...]
    """h, or h and c, before the step."""
    out: str
    """h after it."""


def restore_cells(graph: onnx.GraphProto, opset: int) -> None:
    """Put a GRU or LSTM node in the place of every step that is taken apart; changes the graph."""
    kinds = [node.op_type for node in graph.node]
    if kinds.count("Sigmoid") < 2 or "Tanh" not in kinds or len(graph.input) < 2:
        return
    for out in [o.name for o in graph.output]:
        for part in _list_parts(graph, out):
            try:
                found = _identify(graph, part, opset)
            except (ValueError, IndexError, KeyError, TypeError, RuntimeError):
                found = None  # the reader refuses the node that it does not know, by name
            if found is not None:
                _replace(graph, part, found, opset)
                break


def _list_parts(graph: onnx.GraphProto, out: str) -> list[_Part]:
    """Return nodes that make an output from states handed in, where they look like a cell."""
    makers = {name: node for node in graph.node for name in node.output}
    fixed = {tensor.name for tensor in graph.initializer}
    inputs = {i.name: i for i in graph.input if i.name not in fixed}
    above = _list_above(makers, out)
    wide = {name for name in inputs if name in above and _is_state(inputs[name])}
    choices = [*((state,) for state in sorted(wide)), *itertools.permutations(sorted(wide), 2)]
    parts = (
        _describe(_list_below(graph, above, states), inputs, fixed, makers, states, out)
        for states in choices
    )
    return [part for part in parts if part is not None]


def _is_state(value: onnx.ValueInfoProto) -> bool:
    dims = value.type.tensor_type.shape.dim
    return len(dims) in (1, 2) and 0 < dims[-1].dim_value <= MOST_WIDTH


def _list_above(makers: Mapping[str, onnx.NodeProto], out: str) -> set[str]:
    """Return the names of all values that a value depends on, itself included."""
    found, stack = {out}, [out]
    while stack:
        node = makers.get(stack.pop())
        for name in node.input if node is not None else ():
            if name and name not in found:
                found.add(name)
                stack.append(name)
    return found


def _list_below(
    graph: onnx.GraphProto, above: set[str], states: Sequence[str]
) -> list[onnx.NodeProto]:
    """Return the nodes among `above` that depend on the states, in order."""
    known, nodes = set(states), []
    for node in graph.node:
        if known & set(node.input) and above & set(node.output):
            known |= set(node.output)
            nodes.append(node)
    return nodes


def _describe(
    nodes: Sequence[onnx.NodeProto],
    inputs: Mapping[str, onnx.ValueInfoProto],
    fixed: set[str],
    makers: Mapping[str, onnx.NodeProto],
    states: Sequence[str],
    out: str,
) -> _Part | None:
    """Return what looks like a cell: two sigmoids and a tanh, or three and two."""
    kinds = [node.op_type for node in nodes]
    counts = kinds.count("Sigmoid"), kinds.count("Tanh")
    if counts != ((2, 1) if len(states) == 1 else (3, 2)) or {"GRU", "LSTM"} & set(kinds):
        return None
    made = {name for node in nodes for name in node.output}
    read = dict.fromkeys(name for node in nodes for name in node.input if name)
    given = [
        name
        for name in read
        if name not in made | fixed | set(states) and not _is_constant(name, makers, inputs, fixed)
    ]
    if any(name in inputs and not _is_state(inputs[name]) for name in given):
        return None
    return _Part(tuple(nodes), tuple(given), tuple(states), out)


def _is_constant(
    name: str,
    makers: Mapping[str, onnx.NodeProto],
    inputs: Mapping[str, onnx.ValueInfoProto],
    fixed: set[str],
) -> bool:
    """Tell whether a value follows from the file alone."""
    above = _list_above(makers, name)
    return name in fixed or not above & set(inputs)


@dataclass(frozen=True)
class _Found:
    """What a part of a graph computes."""

    cell: FloatGru | FloatLstm
    after: str
    """Name of c after the step; "" for a GRU."""
    ranks: Mapping[str, int]
    """Axes of what it reads, and of what it gives."""


def _identify(graph: onnx.GraphProto, part: _Part, opset: int) -> _Found | None:
    """Return the cell that a part of a graph computes; None if it is none."""
    sigmoids = [n.input[0] for n in part.nodes if n.op_type == "Sigmoid"]
    tanhs = [n.input[0] for n in part.nodes if n.op_type == "Tanh"]
    ask = _Asking(graph, part, [*sigmoids, *tanhs, part.out], opset)
    hidden = ask.widths[part.states[0]]
    if any(ask.widths[s] != hidden for s in part.states):
        return None
    values = ask.draw(sum(ask.widths.values()) + SPARE)
    x = np.concatenate([values[name] for name in part.given], axis=1)
    h = values[part.states[0]]
    arguments = {name: values[name] for name in (*sigmoids, *tanhs)}
    if any(a.shape != h.shape for a in (*arguments.values(), values[part.out])):
        return None
    if len(part.states) == 1:
        gates = [arguments[name] for name in sigmoids]
        gru = _fit_gru(x, h, gates, arguments[tanhs[0]], values[part.out])
        return None if gru is None else _Found(gru, "", ask.ranks)
    lstm = _fit_lstm(x, h, values[part.states[1]], part, arguments, values[part.out])
    return None if lstm is None else _Found(*lstm, ask.ranks)


def _solve(columns: Array, wanted: Array) -> Array | None:
    """Return wanted = columns @ solution, or None where that does not hold."""
    solution = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    if not _agree(columns @ solution, wanted):
        return None
    size = float(np.abs(solution).max(initial=0.0))
    return np.where(np.abs(solution) > 1e-12 * size, solution, 0.0)


def _agree(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max(initial=0.0) <= EXACT * max(1.0, np.abs(b).max(initial=0.0)))


def _sigmoid(a: Array) -> Array:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * a))


def _fit_gru(
    x: Array, h: Array, gates: Sequence[Array], bend: Array, out: Array
) -> FloatGru | None:
    """Return the GRU of a sample of its values, each [n, width]."""
    one, (n_x, hidden) = np.ones((len(x), 1)), (x.shape[1], h.shape[1])
    linear = [_solve(np.hstack([x, h, one]), a) for a in gates]
    n = np.tanh(bend)
    for r_at, u_at in ((0, 1), (1, 0)):
        r, u = _sigmoid(gates[r_at]), _sigmoid(gates[u_at])
        sign = 1.0
        if not _agree(h + u * (n - h), out):
            u, sign = 1.0 - u, -1.0
        rows_r, rows_u = linear[r_at], linear[u_at]
        if rows_r is None or rows_u is None or not _agree(h + u * (n - h), out):
            continue
        rows_u = sign * rows_u
        before = _solve(np.hstack([x, r * h, one]), bend)
        inside = np.zeros(hidden)
        if before is not None:
            rows_n = before
        else:
            each = [
                _solve(
                    np.hstack([x, r[:, j : j + 1] * h, one, r[:, j : j + 1]]), bend[:, j : j + 1]
                )
                for j in range(hidden)
            ]
            solved = [e for e in each if e is not None]
            if len(solved) < hidden:
                continue
            both = np.hstack(solved)
            rows_n, inside = both[:-1], both[-1]
        three = np.stack([rows_r.T, rows_u.T, rows_n.T])
        bias = np.concatenate([three[:, :, -1], inside[None]])
        reset = "before" if before is not None else "after"
        return FloatGru(three[:, :, :n_x], three[:, :, n_x:-1], bias, reset)
    return None


def _fit_lstm(
    x: Array, h: Array, c: Array, part: _Part, arguments: Mapping[str, Array], out: Array
) -> tuple[FloatLstm, str] | None:
    """Return the LSTM of a sample of its values, each [n, width], and the name of c after it."""
    one, n_x = np.ones((len(x), 1)), x.shape[1]
    linear = {name: _solve(np.hstack([x, h, one]), a) for name, a in arguments.items()}
    tanhs = [n.input[0] for n in part.nodes if n.op_type == "Tanh"]
    sigmoids = [n.input[0] for n in part.nodes if n.op_type == "Sigmoid"]
    for g, after in itertools.permutations(tanhs):
        for i, f, o in itertools.permutations(sigmoids):
            gates = [linear[name] for name in (i, f, g, o)]
            rows = [gate.T for gate in gates if gate is not None]
            moved = _sigmoid(arguments[f]) * c + _sigmoid(arguments[i]) * np.tanh(arguments[g])
            shown = _sigmoid(arguments[o]) * np.tanh(arguments[after])
            if len(rows) == 4 and _agree(moved, arguments[after]) and _agree(shown, out):
                four = np.stack(rows)
                return FloatLstm(four[:, :, :n_x], four[:, :, n_x:-1], four[:, :, -1]), after
    return None


class _Asking:
    """A part of a graph in float64, evaluated for random inputs."""

    def __init__(
        self, graph: onnx.GraphProto, part: _Part, wanted: Sequence[str], opset: int
    ) -> None:
        from onnx.reference import ReferenceEvaluator

        whole = _widen(graph)
        self._wanted = list(dict.fromkeys(wanted))
        self._names = [*part.given, *part.states]
        inputs = {
            i.name: tuple(max(d.dim_value, 1) for d in i.type.tensor_type.shape.dim)
            for i in whole.input
        }
        rng = np.random.default_rng(1)
        feed = {name: rng.normal(size=shape) for name, shape in inputs.items()}
        first = ReferenceEvaluator(_model(whole, list(inputs), self._names, opset)).run(None, feed)
        self._shapes = {n: np.shape(v) for n, v in zip(self._names, first, strict=True)}
        if any(len(s) not in (1, 2) or s[:-1] not in ((), (1,)) for s in self._shapes.values()):
            raise ValueError("what the cell reads is no row of numbers")
        self.ranks = {name: len(shape) for name, shape in self._shapes.items()}
        self.widths = {name: int(shape[-1]) for name, shape in self._shapes.items()}
        if sum(self.widths.values()) > 4 * MOST_WIDTH:
            raise ValueError("the cell is too wide")
        inner = onnx.GraphProto()
        inner.CopyFrom(whole)
        names = {name for node in part.nodes for name in node.output}
        keep = [node for node in whole.node if names & set(node.output)]
        makers = {name: node for node in whole.node for name in node.output}
        fixed = {t.name for t in whole.initializer}
        needed = {n for node in keep for n in node.input} - names - set(self._names) - fixed
        above = set[str]().union(*(_list_above(makers, n) for n in needed)) if needed else set()
        constant = [node for node in whole.node if above & set(node.output)]
        del inner.node[:]
        inner.node.extend(n for n in whole.node if n in keep or n in constant)
        self._evaluator = ReferenceEvaluator(_model(inner, self._names, self._wanted, opset))

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


def _model(
    graph: onnx.GraphProto, inputs: Sequence[str], outputs: Sequence[str], opset: int
) -> onnx.ModelProto:
    """Return a graph as a model with other inputs and outputs, of float64."""

    def info(name: str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.DOUBLE, None)

    own = helper.make_graph(
        list(graph.node),
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


def _replace(graph: onnx.GraphProto, part: _Part, found: _Found, opset: int) -> None:
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
        if opset < 13:
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
    reshape("Squeeze", f"{mark}/h", part.out, found.ranks[part.out])
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
    needed = set[str]().union(*(_list_above(makers, o.name) for o in graph.output))
    del graph.node[:]
    graph.node.extend(node for node in every if needed & set(node.output))
    graph.initializer.extend(constants)
