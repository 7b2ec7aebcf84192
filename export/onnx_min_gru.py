"""Single steps of a minGRU become a GRU without recurrent weights.

A minGRU is h' = h + z * (c - h), where the gate z = sigmoid(a) and the candidate c follow from the
step's input alone (Feng et al., "Were RNNs All We Needed?", 2024). With c = tanh(b) this is a GRU
whose recurrent weights are zero; with c = sigmoid(b) = (1 + tanh(b / 2)) / 2 it is one whose state
g is h = (1 + g) / 2. A candidate that is not bounded is neither.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from zerodrift.base.arrays import Array
from zerodrift.export.onnx_parts import (
    Asking,
    CellPart,
    FoundCell,
    agree,
    is_constant,
    is_state,
    list_above,
)
from zerodrift.operations.gru.cell import FloatGru

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
        part = _describe(graph, inputs, fixed, state, out)
        try:
            found = None if part is None else _fit(graph, part, opset)
        except (ValueError, IndexError, KeyError, TypeError, RuntimeError):
            found = None  # the reader refuses the node that it does not know, by name
        if part is not None and found is not None:
            return found
    return None


def _describe(
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
