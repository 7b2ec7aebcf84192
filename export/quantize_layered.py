"""Formats for a network whose layers may read several others, and its nodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.export.layered_network import FloatLayeredNetwork, width_of
from zerodrift.export.lowering import Lowering
from zerodrift.export.quantize_dense import quantize_dense
from zerodrift.export.quantize_gru import quantize_gru, quantize_head
from zerodrift.export.quantize_layer_norm import quantize_layer_norm
from zerodrift.export.quantize_lstm import quantize_lstm
from zerodrift.operations.dense import COPY_BITS, FloatDense
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.head import IntegerHead, IntegerJoinHead
from zerodrift.operations.join import IntegerJoin
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.node import IntegerNode

Exponents = NDArray[np.int64]


@dataclass(frozen=True)
class LayeredScales:
    """What the integers of a layered network stand for."""

    layers: Mapping[str, tuple[int, Exponents]]
    """Node -> the layer whose output it gives, counted from 1, and [M] e: value * 2**-e."""
    head: Exponents
    """[K]: a sum stands for sum * 2**-e."""


def group_layers(network: FloatLayeredNetwork) -> list[list[int]]:
    """Return the layers, counted from 1, in groups that become one node each.

    Recurrent layers of one kind on top of each other, the lower read by nothing else, are one.
    """
    readers: dict[int, int] = {}
    for reads in (*(n.reads for n in network.layers), network.reads):
        for k in reads:
            readers[k] = readers.get(k, 0) + 1
    groups: list[list[int]] = []
    for k, layer in enumerate(network.layers, 1):
        below = layer.reads[0]
        alone = layer.recurrent and len(layer.reads) == 1 and below and readers[below] == 1
        same = alone and type(network.layers[below - 1].cell) is type(layer.cell)
        group = next((g for g in groups if g[-1] == below), None) if same else None
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return sorted(groups, key=lambda group: group[-1])


def append_layered(
    lowering: Lowering,
    network: FloatLayeredNetwork,
    feature_exponents: Exponents,
    weights: str,
    window: int,
) -> LayeredScales:
    """Add all layers and the head after the node "features"; return what they stand for.

    Args:
        lowering: takes the nodes.
        network: the float network.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights.
        window: 0, or the number of samples of a window.

    Raises:
        CheckError: a layer has no safe format; names it and its row. Or, with a window, a recurrent
            layer reads what another recurrent one does not hand up directly.
    """
    names, exponents = {0: "features"}, {0: feature_exponents}
    found: dict[str, tuple[int, Exponents]] = {}
    for group in group_layers(network):
        if window:
            _refuse_split_window(network, group)
        reads = network.layers[group[0] - 1].reads
        source = _append_join(lowering, reads, names, exponents)
        given = np.concatenate([exponents[k] for k in reads])
        top = group[-1]
        node, own = _make_node(lowering, network, group, source, given, weights, window)
        names[top], exponents[top] = lowering.append(node), own
        found[node.name] = top, own + COPY_BITS
    source = _append_join(lowering, network.reads, names, exponents)
    given = np.concatenate([exponents[k] for k in network.reads])
    rows, head = quantize_head(network.head * 2.0 ** (COPY_BITS - given))
    of_layer = len(network.reads) == 1 and network.reads[0] != 0
    lowering.append((IntegerHead if of_layer else IntegerJoinHead)("head", (source,), rows))
    return LayeredScales(found, head)


def _append_join(
    lowering: Lowering,
    reads: Sequence[int],
    names: Mapping[int, str],
    exponents: Mapping[int, Exponents],
) -> str:
    """Return the node that gives all of some sources; a join is added where it needs one."""
    if len(reads) == 1:
        return names[reads[0]]
    return lowering.append(
        IntegerJoin(
            _name(lowering, "join"),
            tuple(names[k] for k in reads),
            tuple(COPY_BITS if k else 0 for k in reads),
            tuple(exponents[k].size for k in reads),
        )
    )


def _name(lowering: Lowering, kind: str) -> str:
    """Return a name that no node has; no digits at its end, which number the layers of one."""
    taken = {node.name for node in lowering.nodes}
    letters = (chr(ord("a") + k) + chr(ord("a") + m) for k in range(26) for m in range(26))
    names = (kind, *(f"{kind}_{both}" for both in letters))
    return next(name for name in names if name not in taken)


def _make_node(
    lowering: Lowering,
    network: FloatLayeredNetwork,
    group: Sequence[int],
    source: str,
    given: Exponents,
    weights: str,
    window: int,
) -> tuple[IntegerNode, Exponents]:
    """Return the node of a group of layers, and the exponents of its int16 copies."""
    copied = _is_layer(lowering, source)
    cells = [network.layers[k - 1].cell for k in group]
    if isinstance(cells[0], FloatDense):
        reach = lowering.intervals[source]
        copies = [x.round_shift(COPY_BITS) for x in reach] if copied else reach
        name = _name(lowering, "dense")
        return quantize_dense(cells[0], name, source, given, copies, not copied)
    if isinstance(cells[0], FloatLayerNorm):
        return quantize_layer_norm(cells[0], _name(lowering, "layer_norm"), source, given)
    if copied:  # a recurrent layer reads 16 bits
        source = lowering.append(
            IntegerJoin(_name(lowering, "join"), (source,), (COPY_BITS,), (given.size,))
        )
    own = np.full(width_of(cells[-1]), COPY_BITS)
    scales = [given, *(np.full(width_of(cell), COPY_BITS) for cell in cells)]
    pairs = list(zip(cells, scales, strict=False))
    grus = [quantize_gru(c, e, weights) for c, e in pairs if isinstance(c, FloatGru)]
    lstms = [quantize_lstm(c, e, weights) for c, e in pairs if isinstance(c, FloatLstm)]
    if lstms:
        name = _name(lowering, "lstm")
        return IntegerLstmLayer(name, (source,), layers=tuple(lstms), window=window), own
    name, (*lower, top) = _name(lowering, "gru"), grus
    if not lower:
        return IntegerGruLayer(name, (source,), gru=top, window=window), own
    return IntegerGruStack(name, (source,), gru=top, window=window, lower=tuple(lower)), own


def _is_layer(lowering: Lowering, name: str) -> bool:
    """Tell whether a node's values have 15 bits more than their int16 copies."""
    node = next(n for n in lowering.nodes if n.name == name)
    return name != "features" and not isinstance(node, IntegerJoin)


def _refuse_split_window(network: FloatLayeredNetwork, group: Sequence[int]) -> None:
    """Refuse a windowed recurrent layer that stands on another one, but not in one node with it."""
    if not network.layers[group[0] - 1].recurrent:
        return
    below, stack = set[int](), list(network.layers[group[0] - 1].reads)
    while stack:
        k = stack.pop()
        if k and k not in below:
            below.add(k)
            stack += network.layers[k - 1].reads
    if any(network.layers[k - 1].recurrent for k in below):
        raise CheckError(
            f"layer {group[0]}: with a window, a recurrent layer has to read the features, dense"
            " layers, or the recurrent layer of its own kind right below it; something else stands"
            " between. Give --memory stream, or train the network with a carried state."
        )
