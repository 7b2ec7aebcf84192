"""Formats for everything from the features to the head: recurrent layers, dense layers, head."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.lowering import Lowering
from zerodrift.export.quantize_gru import quantize_gru, quantize_head
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, INT32_MAX, choose_exponent
from zerodrift.operations.dense import (
    COPY_BITS,
    FloatDense,
    FloatFeedForward,
    IntegerDense,
    IntegerFeatureDense,
)
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import H_LIMIT_Q30, FloatGru, IntegerGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.intervals import Interval
from zerodrift.operations.tables import TABLE_BITS

SHIFT_LIMIT = 30
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


def quantize_dense(
    layer: FloatDense,
    name: str,
    source: str,
    exponents: Exponents,
    inputs: Sequence[Interval],
    of_features: bool = False,
) -> tuple[IntegerDense, Exponents]:
    """Return a dense layer with the finest formats that are provably safe.

    A row of "clip" keeps the largest result that its inputs can give, so that int16 never
    saturates where the float layer would not.

    Args:
        layer: float weights.
        name: of the node.
        source: name of the node that it reads.
        exponents: [N] f with input = int16 copy * 2**-f.
        inputs: [N] range of the int16 copies.
        of_features: whether the layer reads the features themselves.

    Returns:
        The node, and [M] the exponents of its own int16 copies.

    Raises:
        CheckError: not finite, or no scale is safe.
    """
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise CheckError(f"{name}: a weight or bias is not finite; the model is refused")
    count = layer.weight.shape[0]
    rows = np.zeros(layer.weight.shape, dtype=np.int16)
    bias = np.zeros(count, dtype=np.int32)
    shifts, lows, highs = [], [], []
    own = np.full(count, COPY_BITS)
    magnitudes = np.array([x.magnitude for x in inputs], dtype=np.float64)
    for i in range(count):
        scaled = layer.weight[i] * 2.0 ** -exponents.astype(np.float64)
        reach = float(np.abs(scaled) @ magnitudes) + abs(float(layer.bias[i]))
        # the half of the shift, and half a unit of rounding per weight, beside the sum itself
        spare = int(magnitudes.sum()) // 2 + (1 << SHIFT_LIMIT >> 1)
        exponent = min(
            choose_exponent(float(np.abs(scaled).max()), INT16_MAX),
            choose_exponent(reach, INT32_MAX - spare) if spare < INT32_MAX else -1,
        )
        if layer.activation == "tanh":
            exponent = min(exponent, TABLE_BITS + SHIFT_LIMIT)
            shift = exponent - TABLE_BITS
        else:
            largest = min(reach, max(abs(layer.low), abs(layer.high)))
            own[i] = min(choose_exponent(largest, INT16_MAX), exponent)
            exponent = min(exponent, int(own[i]) + SHIFT_LIMIT)
            shift = exponent - int(own[i])
        if shift < 0:
            raise CheckError(
                f"{name}, row {i}: weights that reach {reach:.3g} leave no safe 32-bit format;"
                " the model is refused. Train with weight decay or clip that row."
            )
        rows[i] = np.round(scaled * 2.0**exponent)
        bias[i] = round(float(layer.bias[i]) * 2.0**exponent) + (1 << shift >> 1)
        shifts.append(shift)
        if layer.activation == "clip":
            unit = 2.0 ** float(own[i])
            lows.append(int(np.clip(np.round(layer.low * unit), INT16_MIN, INT16_MAX)))
            highs.append(int(np.clip(np.round(layer.high * unit), INT16_MIN, INT16_MAX)))
    node = (IntegerFeatureDense if of_features else IntegerDense)(
        name=name,
        inputs=(source,),
        weights=rows,
        bias=bias,
        shift=tuple(shifts),
        activation=layer.activation,
        low=tuple(lows),
        high=tuple(highs),
    )
    return node, own
