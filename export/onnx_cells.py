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
from onnx import TensorProto, helper, numpy_helper

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru.onnx import to_onnx_gates as gru_to_onnx
from zerodrift.operations.lstm.cell import GATES, FloatLstm
from zerodrift.operations.lstm.onnx import to_onnx_gates as lstm_to_onnx

# Parts of a foreign graph: found, evaluated in float64, and put back as one recurrent node.

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

    def constant(what: str, value: Array | IntArray) -> str:
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


# Single steps of a minGRU become a GRU without recurrent weights.
#
# A minGRU is h' = h + z * (c - h), where the gate z = sigmoid(a) and the candidate c follow from
# the step's input alone (Feng et al., "Were RNNs All We Needed?", 2024). With c = tanh(b) this is a
# GRU whose recurrent weights are zero; with c = sigmoid(b) = (1 + tanh(b / 2)) / 2 it is one whose
# state g is h = (1 + g) / 2. A candidate that is not bounded is neither.

SAMPLES = 24
MOST_NODES = 64


def identify_min_gru(
    graph: onnx.GraphProto, out: str, opset: int
) -> tuple[CellPart, FoundCell] | None:
    """Return the step of a minGRU that an output is, and the GRU that it equals; or None."""
    fixed = {tensor.name for tensor in graph.initializer}
    inputs = {i.name: i for i in graph.input if i.name not in fixed}
    above = list_above({name: node for node in graph.node for name in node.output}, out)
    for state in sorted(name for name in inputs if name in above and is_state(inputs[name])):
        part = _describe_min_gru(graph, inputs, fixed, state, out)
        try:
            found = None if part is None else _fit(graph, part, opset)
        except (ValueError, IndexError, KeyError, TypeError, RuntimeError):
            found = None  # the reader refuses the node that it does not know, by name
        if part is not None and found is not None:
            return found
    return None


def _describe_min_gru(
    graph: onnx.GraphProto,
    inputs: Mapping[str, onnx.ValueInfoProto],
    fixed: set[str],
    state: str,
    out: str,
) -> CellPart | None:
    """Return the nodes from the first sigmoids and tanhs above an output down to it.

    What these read has to be free of the state, and nothing else may reach the output.
    """
    makers = {name: node for node in graph.node for name in node.output}
    nodes: list[str] = []
    bends: list[str] = []
    stack, met = [out], False
    while stack and len(nodes) <= MOST_NODES:
        name = stack.pop()
        if name == state:
            met = True
        elif name in nodes or is_constant(name, makers, inputs, fixed):
            continue
        elif name not in makers:
            return None  # an input without a sigmoid or tanh above the state
        else:
            nodes.append(name)
            if makers[name].op_type not in ("Sigmoid", "Tanh"):
                stack += [n for n in makers[name].input if n]
                continue
            argument = makers[name].input[0]
            while argument in makers and makers[argument].op_type == "Neg":  # sigmoid(-a) = 1 - z
                nodes.append(argument)
                argument = makers[argument].input[0]
            bends.append(argument)
    given = tuple(dict.fromkeys(bends))
    if not met or len(given) != 2 or any(state in list_above(makers, name) for name in given):
        return None
    kept = tuple(node for node in graph.node if set(nodes) & set(node.output))
    return CellPart(kept, given, (state,), out)


def _fit(graph: onnx.GraphProto, part: CellPart, opset: int) -> tuple[CellPart, FoundCell] | None:
    """Return the part, its gate's argument first, and the GRU that it equals."""
    ask = Asking(graph, part, [part.out], opset)
    hidden = ask.widths[part.states[0]]
    ranks = {ask.ranks[name] for name in part.given}
    if len(ranks) != 1 or any(ask.widths[name] != hidden for name in part.given):
        return None
    values = ask.draw(SAMPLES)
    h, out = values[part.states[0]], values[part.out]
    for gate, candidate in itertools.permutations(part.given):
        arguments = np.concatenate([values[gate], values[candidate]], axis=1)
        for sign, half in itertools.product((1.0, -1.0), (1.0, 0.5)):
            cell = _make_gru(hidden, (sign, half))
            moved = cell.step(arguments, (h - (1.0 - half)) / half)
            if agree(half * moved + (1.0 - half), out):
                own = CellPart(part.nodes, (gate, candidate), part.states, part.out)
                return own, FoundCell(cell, "", ask.ranks, half, 1.0 - half)
    return None


def _make_gru(hidden: int, factors: Sequence[float]) -> FloatGru:
    """Return the GRU [3, H, 2 H] over the arguments of gate and candidate."""
    one = np.eye(hidden)
    w_x: Array = np.zeros((3, hidden, 2 * hidden))
    w_x[1, :, :hidden], w_x[2, :, hidden:] = factors[0] * one, factors[1] * one
    return FloatGru(w_x, np.zeros((3, hidden, hidden)), np.zeros((4, hidden)), "after")


# Single steps of a GRU or an LSTM that an exporter has taken apart become one node again.

SPARE = 24
"""Samples beyond the unknowns."""


def restore_cells(graph: onnx.GraphProto, opset: int) -> None:
    """Put a GRU or LSTM node in the place of every step that is taken apart; changes the graph."""
    kinds = [node.op_type for node in graph.node]
    if "Sigmoid" not in kinds or len(graph.input) < 2:
        return
    for out in [o.name for o in graph.output]:
        if not _restore(graph, out, opset):
            identified = identify_min_gru(graph, out, opset)
            if identified is not None:
                put_back(graph, *identified, opset)


def _restore(graph: onnx.GraphProto, out: str, opset: int) -> bool:
    """Put a GRU or LSTM node in the place of the step that gives an output, where it is one."""
    for part in _list_parts(graph, out):
        try:
            found = _identify(graph, part, opset)
        except (ValueError, IndexError, KeyError, TypeError, RuntimeError):
            found = None  # the reader refuses the node that it does not know, by name
        if found is not None:
            put_back(graph, part, found, opset)
            return True
    return False


def _list_parts(graph: onnx.GraphProto, out: str) -> list[CellPart]:
    """Return nodes that make an output from states handed in, where they look like a cell."""
    makers = {name: node for node in graph.node for name in node.output}
    fixed = {tensor.name for tensor in graph.initializer}
    inputs = {i.name: i for i in graph.input if i.name not in fixed}
    above = list_above(makers, out)
    wide = {name for name in inputs if name in above and is_state(inputs[name])}
    choices = [*((state,) for state in sorted(wide)), *itertools.permutations(sorted(wide), 2)]
    parts = (
        _describe(_list_below(graph, above, states), inputs, fixed, makers, states, out)
        for states in choices
    )
    return [part for part in parts if part is not None]


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
) -> CellPart | None:
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
        if name not in made | fixed | set(states) and not is_constant(name, makers, inputs, fixed)
    ]
    if any(name in inputs and not is_state(inputs[name]) for name in given):
        return None
    return CellPart(tuple(nodes), tuple(given), tuple(states), out)


def _identify(graph: onnx.GraphProto, part: CellPart, opset: int) -> FoundCell | None:
    """Return the cell that a part of a graph computes; None if it is none."""
    sigmoids = [n.input[0] for n in part.nodes if n.op_type == "Sigmoid"]
    tanhs = [n.input[0] for n in part.nodes if n.op_type == "Tanh"]
    ask = Asking(graph, part, [*sigmoids, *tanhs, part.out], opset)
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
        return None if gru is None else FoundCell(gru, "", ask.ranks)
    lstm = _fit_lstm(x, h, values[part.states[1]], part, arguments, values[part.out])
    return None if lstm is None else FoundCell(*lstm, ask.ranks)


def _solve(columns: Array, wanted: Array) -> Array | None:
    """Return wanted = columns @ solution, or None where that does not hold."""
    solution = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    if not agree(columns @ solution, wanted):
        return None
    size = float(np.abs(solution).max(initial=0.0))
    return np.where(np.abs(solution) > 1e-12 * size, solution, 0.0)


def _fit_gru(
    x: Array, h: Array, gates: Sequence[Array], bend: Array, out: Array
) -> FloatGru | None:
    """Return the GRU of a sample of its values, each [n, width]."""
    one, n_x = np.ones((len(x), 1)), x.shape[1]
    linear = [_solve(np.hstack([x, h, one]), a) for a in gates]
    for r_at, u_at in ((0, 1), (1, 0)):
        candidate = _fit_candidate(x, h, sigmoid(gates[r_at]), bend)
        rows_r, rows_u = linear[r_at], linear[u_at]
        if candidate is None or rows_r is None or rows_u is None:
            continue
        rows_n, inside, reset = candidate
        for sign in (1.0, -1.0):  # h moves by sigmoid(a), or by 1 - sigmoid(a) = sigmoid(-a)
            three = np.stack([rows_r.T, sign * rows_u.T, rows_n.T])
            bias = np.concatenate([three[:, :, -1], inside[None]])
            gru = FloatGru(three[:, :, :n_x], three[:, :, n_x:-1], bias, reset)
            if agree(gru.step(x, h), out):
                return gru
    return None


def _fit_candidate(x: Array, h: Array, r: Array, bend: Array) -> tuple[Array, Array, str] | None:
    """Return the candidate's rows, its bias inside the reset product, and where the reset acts."""
    one, hidden = np.ones((len(x), 1)), h.shape[1]
    before = _solve(np.hstack([x, r * h, one]), bend)
    if before is not None:
        return before, np.zeros(hidden), "before"
    each = []
    for j in range(hidden):
        r_j = r[:, j : j + 1]
        each.append(_solve(np.hstack([x, r_j * h, one, r_j]), bend[:, j : j + 1]))
    solved = [e for e in each if e is not None]
    if len(solved) < hidden:
        return None
    both = np.hstack(solved)
    return both[:-1], both[-1], "after"


def _fit_lstm(
    x: Array, h: Array, c: Array, part: CellPart, arguments: Mapping[str, Array], out: Array
) -> tuple[FloatLstm, str] | None:
    """Return the LSTM of a sample of its values, each [n, width], and the name of c after it."""
    one, n_x = np.ones((len(x), 1)), x.shape[1]
    linear = {name: _solve(np.hstack([x, h, one]), a) for name, a in arguments.items()}
    tanhs = [n.input[0] for n in part.nodes if n.op_type == "Tanh"]
    sigmoids = [n.input[0] for n in part.nodes if n.op_type == "Sigmoid"]
    for g, after in itertools.permutations(tanhs):
        for i, f, o in itertools.permutations(sigmoids):
            rows = [rows.T for name in (i, f, g, o) if (rows := linear[name]) is not None]
            if len(rows) < len(GATES):
                continue
            four = np.stack(rows)
            lstm = FloatLstm(four[:, :, :n_x], four[:, :, n_x:-1], four[:, :, -1])
            shown, state = lstm.run(x[:, None], np.hstack([h, c]))
            if agree(state[:, lstm.hidden :], arguments[after]) and agree(shown[:, 0], out):
                return lstm, after
    return None
