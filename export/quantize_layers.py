"""Formats for everything from the features to the head: recurrent layers, dense layers, head."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.lowering import Lowering
from zerodrift.export.quantize_dense import quantize_dense
from zerodrift.export.quantize_gru import quantize_gru, quantize_head
from zerodrift.operations.dense import (
    COPY_BITS,
    FloatFeedForward,
    IntegerDense,
)
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import H_LIMIT_Q30, FloatGru, IntegerGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.intervals import Interval

Exponents = NDArray[np.int64]


@dataclass(frozen=True)
class ReadOut:
    """The nodes between state or features and the answer, with their scales."""

    dense: tuple[IntegerDense, ...]
    dense_exponents: tuple[Exponents, ...]
    """Of each dense layer, [M]: its int16 copies stand for copy * 2**-e, its results, which have
    `COPY_BITS` more bits, for result * 2**-(e + COPY_BITS)."""
    head: IntegerHead
    head_exponents: Exponents
    """[K]: a sum stands for sum * 2**-e."""


def append_network(
    lowering: Lowering,
    network: FloatNetwork | FloatFeedForward,
    feature_exponents: Exponents,
    weights: str,
    window: int,
) -> ReadOut:
    """Add recurrent layers if there are any, dense layers and head after the node "features".

    Args:
        lowering: takes the nodes.
        network: the float network.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights.
        window: 0, or the number of samples of a window.

    Returns:
        The nodes after the recurrent layers, with their scales.

    Raises:
        CheckError: a layer has no safe format; names it and its row.
    """
    if isinstance(network, FloatFeedForward):
        read_out = quantize_read_out(
            network, "features", feature_exponents, lowering.intervals["features"]
        )
    else:
        *lower, top = quantize_layers(network.layers, feature_exponents, weights)
        if lower:
            lowering.append(
                IntegerGruStack("gru", ("features",), gru=top, window=window, lower=tuple(lower))
            )
        else:
            lowering.append(IntegerGruLayer("gru", ("features",), gru=top, window=window))
        read_out = quantize_state_read_out(network)
    for node in (*read_out.dense, read_out.head):
        lowering.append(node)
    return read_out


def quantize_layers(
    layers: Sequence[FloatGru], feature_exponents: Exponents, weights: str
) -> list[IntegerGru]:
    """Return the recurrent layers from the bottom up; each reads the state of the one below.

    Raises:
        CheckError: a gate has no safe scale.
    """
    bottom, *upper = layers
    above = [quantize_gru(gru, np.full(gru.w_x.shape[2], COPY_BITS), weights) for gru in upper]
    return [quantize_gru(bottom, feature_exponents, weights), *above]


def quantize_state_read_out(network: FloatNetwork) -> ReadOut:
    """Return everything after the recurrent layers, whatever their weights are.

    Raises:
        CheckError: a layer has no safe format; names it and its row.
    """
    hidden = network.layers[-1].w_h.shape[1]
    reach = [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * hidden
    return quantize_read_out(network, "gru", np.full(hidden, COPY_BITS), reach)


def quantize_read_out(
    network: FloatNetwork | FloatFeedForward,
    last: str,
    exponents: Exponents,
    reach: Sequence[Interval],
) -> ReadOut:
    """Return dense layers and head after the node `last`.

    Args:
        network: whose layers they are.
        last: "gru" or "features".
        exponents: its int16 copies, or the features, stand for value * 2**-e.
        reach: what its values, or the features, can be.

    Raises:
        CheckError: a layer has no safe format; names it and its row.
    """
    nodes, scales = [], []
    known = list(reach)
    for index, layer in enumerate(network.dense):
        of_features = last == "features"
        copies = known if of_features else [x.round_shift(COPY_BITS) for x in known]
        node, exponents = quantize_dense(
            layer, f"dense_{index}", last, exponents, copies, of_features
        )
        known, _ = node.prove([known])
        last = node.name
        nodes.append(node)
        scales.append(exponents)
    rows, head_exponents = quantize_head(network.head * 2.0 ** (COPY_BITS - exponents))
    head = IntegerHead(name="head", inputs=(last,), weights=rows)
    return ReadOut(tuple(nodes), tuple(scales), head, head_exponents)
