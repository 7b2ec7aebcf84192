"""Numbers of a model's nodes as the proof reads them: layers with their gates side by side."""

from itertools import chain

import numpy as np

from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.layer_norm import IntegerLayerNorm
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.lstm.cell import IntegerLstm
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.recurrent import IntegerRecurrent
from zerodrift.verify.prove_kernels import Numbered, Power
from zerodrift.verify.prove_layer_norm import Normalisation
from zerodrift.verify.prove_state import State
from zerodrift.verify.prove_terms import UndecidedError, Whole


def read_power(node: IntegerPower) -> Power:
    """Return the numbers of a power."""
    return Power(tuple(node.octave), tuple(node.gains), node.low, node.high, node.shift)


def read_norm(node: IntegerLayerNorm) -> Normalisation:
    """Return the numbers of a layer normalisation."""
    rows = (node.align, node.gain.tolist(), node.shift, node.bias.tolist())
    align, gain, shift, bias = (tuple(int(n) for n in row) for row in rows)
    return Normalisation(align, gain, shift, bias, node.epsilon)


def list_layers(node: IntegerNode) -> list[Numbered]:
    """Return the layers of a recurrent node, from the bottom up, named as in the C."""
    if isinstance(node, IntegerGruLayer):
        names = node.name_layers("_")
        return [_read_gru(n, gru) for n, gru in zip(names, node.layers, strict=True)]
    if isinstance(node, IntegerLstmLayer):
        names = node.name_layers("_")
        return [_read_lstm(n, one) for n, one in zip(names, node.layers, strict=True)]
    raise UndecidedError(f"'{node.kind}' has no layers")


def _rows(weights: object, gates: int, hidden: int) -> tuple[tuple[int, ...], ...]:
    """Return weights [G, H, n] as rows, the gates of a unit side by side."""
    assert isinstance(weights, np.ndarray)
    listed = weights.tolist()
    return tuple(tuple(listed[g][j]) for j in range(hidden) for g in range(gates))


def _read_gru(name: str, gru: IntegerGru) -> Numbered:
    hidden = gru.hidden
    bias = tuple(int(gru.bias[g][j]) for j in range(hidden) for g in range(4))
    multiplier: tuple[int, ...] = ()
    if gru.multiplier is not None:
        multiplier = tuple(int(gru.multiplier[g][j]) for j in range(hidden) for g in range(3))
    return Numbered(
        name,
        "gru" if gru.reset == "after" else "gru before",
        gru.inputs,
        hidden,
        _rows(gru.w_x, 3, hidden),
        _rows(gru.w_h, 3, hidden),
        bias,
        tuple(int(s) for s in gru.shift),
        multiplier,
        tuple(int(s) for s in gru.multiplier_shift),
    )


def _read_lstm(name: str, lstm: IntegerLstm) -> Numbered:
    hidden = lstm.hidden
    bias = tuple(int(lstm.bias[g][j]) for j in range(hidden) for g in range(4))
    multiplier: tuple[int, ...] = ()
    if lstm.multiplier is not None:
        multiplier = tuple(int(lstm.multiplier[g][j]) for j in range(hidden) for g in range(4))
    return Numbered(
        name,
        "lstm",
        lstm.inputs,
        hidden,
        _rows(lstm.w_x, 4, hidden),
        _rows(lstm.w_h, 4, hidden),
        bias,
        tuple(int(s) for s in lstm.shift),
        multiplier,
        tuple(int(s) for s in lstm.multiplier_shift),
        int(lstm.cell_bits),
    )


def split_states(
    node: IntegerRecurrent, layers: list[Numbered], state: State
) -> tuple[list[list[Whole]], list[list[Whole]]]:
    """Return the layers' states and cells, from the bottom up."""
    name = node.name
    if isinstance(node, IntegerLstmLayer):
        h, c = state[f"{name}_h_q30"], state[f"{name}_cell"]
    else:
        h, c = [*state.get(f"{name}_lower_q30", []), *state[f"{name}_h_q30"]], []
    h_all, c_all, at = [], [], 0
    for layer in layers:
        h_all.append(h[at : at + layer.hidden])
        c_all.append(c[at : at + layer.hidden])
        at += layer.hidden
    return h_all, c_all


def join_states(
    node: IntegerRecurrent, h_all: list[list[Whole]], c_all: list[list[Whole]]
) -> State:
    """Return the layers' states as the fields of the C."""
    name = node.name
    if isinstance(node, IntegerLstmLayer):
        return {f"{name}_h_q30": [*chain(*h_all)], f"{name}_cell": [*chain(*c_all)]}
    lower = {f"{name}_lower_q30": [*chain(*h_all[:-1])]} if len(h_all) > 1 else {}
    return {f"{name}_h_q30": h_all[-1], **lower}
