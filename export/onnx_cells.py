"""Single steps of a GRU or an LSTM that an exporter has taken apart become one node again.

PyTorch writes `GRUCell` and `LSTMCell` as products, sums, sigmoids and tanhs, each version in
another order. Such a part of a graph is identified by evaluating it: the arguments of its sigmoids
and tanhs are linear in its inputs, so a few hundred random numbers give its weights, in float64,
and further ones confirm them. A part that does not follow the equations is left as it is.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from zerodrift.base.arrays import Array
from zerodrift.export.onnx_min_gru import identify_min_gru
from zerodrift.export.onnx_parts import (
    Asking,
    CellPart,
    FoundCell,
    agree,
    is_constant,
    is_state,
    list_above,
    put_back,
    sigmoid,
)
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import GATES, FloatLstm

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
