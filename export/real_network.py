"""What the network's integers stand for: the float network with its unrounded weights."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.export.float_model import FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.layered_network import FloatLayeredNetwork
from zerodrift.export.quantize_layered import LayeredScales
from zerodrift.export.quantize_layers import ReadOut
from zerodrift.operations.dense import COPY_BITS, FloatDense, FloatFeedForward
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.recurrent import IntegerRecurrent, number_layers
from zerodrift.operations.signals import Signal, constant

STATE_BITS = 30


def describe_features(
    taps: Sequence[Signal], whitening: Array, tap_mean: Array, exponents: NDArray[np.int64]
) -> list[Signal]:
    """Return the features, which stand for whitening @ (taps - mean), limited to int16.

    Args:
        taps: J signals.
        whitening: [I, J].
        tap_mean: [J].
        exponents: [I] f with feature = integer * 2**-f.
    """
    centres = [constant(-float(mean)) for mean in tap_mean]
    features = []
    for i, row in enumerate(whitening.tolist()):
        feature = Signal("features", 2.0 ** -int(exponents[i]), index=i)
        features.append(feature.standing_for("linear", (*taps, *centres), *row, *row))
    return features


def describe_network(
    network: FloatNetwork | FloatFeedForward, features: Sequence[Signal], read_out: ReadOut
) -> list[Signal]:
    """Return the head's signals [K] of a model with a network, without the head's bias."""
    below = list(features)
    if isinstance(network, FloatNetwork):
        below = _describe_states(network, features)
    for layer, node, exponents in zip(
        network.dense, read_out.dense, read_out.dense_exponents, strict=True
    ):
        below = _describe_dense(layer, node.name, below, exponents)
    heads = []
    for k, row in enumerate(network.head.tolist()):
        head = Signal("head", 2.0 ** -int(read_out.head_exponents[k]), index=k)
        heads.append(head.standing_for("linear", below, *row))
    return heads


def _describe_states(network: FloatNetwork, features: Sequence[Signal]) -> list[Signal]:
    """Return the topmost state's signals; they are made of the int16 copies of the one below."""
    below = list(features)
    names = number_layers("gru", len(network.layers), ".")
    for name, gru in zip(names, network.layers, strict=True):
        top = gru is network.layers[-1]
        node, bits = ("gru", STATE_BITS) if top else (name, COPY_BITS)
        states = []
        for j in range(gru.w_h.shape[1]):
            row = [*gru.bias[:, j], *gru.w_x[:, j].ravel(), *gru.w_h[:, j].ravel()]
            state = Signal(node, 2.0**-bits, index=j)
            states.append(state.standing_for(f"gru_{gru.reset}", below, *map(float, row)))
        below = states
    return below


def describe_layered(
    network: FloatLayeredNetwork,
    scales: LayeredScales,
    nodes: Sequence[IntegerNode],
    features: Sequence[Signal],
) -> list[Signal]:
    """Return the head's signals [K] of a network whose layers may read several others.

    Where it is more than one LSTM over the features, no more is said of what the head reads than
    that it carries errors on: of each state, where it is the states of one recurrent layer.
    """
    read = next(node for node in nodes if node.name in nodes[-1].inputs)
    width, gains = 1, [[1.0]] * len(network.head)
    if isinstance(read, IntegerRecurrent):
        width, gains = read.width, network.head.tolist()
    carried = [Signal(read.name, 2.0**-STATE_BITS, index=j) for j in range(width)]
    states = [state.standing_for("recurrent", features) for state in carried]
    only = network.layers[0] if network.reads == (1,) and len(network.layers) == 1 else None
    if only is not None and isinstance(only.cell, FloatLstm) and only.reads == (0,):
        states = _describe_lstm(read.name, only.cell, features)
    heads = []
    for k, row in enumerate(gains):
        head = Signal("head", 2.0 ** -int(scales.head[k]), index=k)
        heads.append(head.standing_for("linear", states, *row))
    return heads


def _describe_lstm(name: str, lstm: FloatLstm, features: Sequence[Signal]) -> list[Signal]:
    """Return the signals of an LSTM's output over the features."""
    states = []
    for j in range(lstm.hidden):
        row = [*lstm.bias[:, j], *lstm.w_x[:, j].ravel(), *lstm.w_h[:, j].ravel()]
        state = Signal(name, 2.0**-STATE_BITS, index=j)
        states.append(state.standing_for("lstm", features, *map(float, row)))
    return states


def _describe_dense(
    layer: FloatDense, name: str, below: list[Signal], exponents: NDArray[np.int64]
) -> list[Signal]:
    signals = []
    for i, row in enumerate(layer.weight.tolist()):
        signal = Signal(name, 2.0 ** -(int(exponents[i]) + COPY_BITS), index=i)
        numbers = (layer.low, layer.high, float(layer.bias[i]), *row)
        signals.append(signal.standing_for(f"dense_{layer.activation}", below, *numbers))
    return signals


def describe_answers(
    model: FloatModel, features: Sequence[Signal], heads: Sequence[Signal]
) -> tuple[Signal, ...]:
    """Return the drifts [K]: features . coefficients + offset, and the network's answer."""
    answers = []
    for k, output in enumerate(model.outputs):
        terms, gains = [*features], model.coefficients[:, k].tolist()
        terms.append(constant(float(model.offset[k])))
        gains.append(1.0)
        if model.network is not None:
            terms += [heads[k], constant(float(model.network.head_bias[k]))]
            gains += [1.0, 1.0]
        answer = Signal("drift", 1.0 / output.lsb_per_unit, index=k)
        answers.append(answer.standing_for("linear", terms, *gains))
    return tuple(answers)
