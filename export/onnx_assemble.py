"""Builds a network in float64 from the values found in a float ONNX graph."""

import itertools

import numpy as np

from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.layered_network import FloatLayer, FloatLayeredNetwork
from zerodrift.export.onnx_values import OnnxSignal, OnnxSource
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm


def build_network(signal: OnnxSignal) -> FloatNetwork | FloatLayeredNetwork:
    """Return the network of a graph's answer: GRUs below dense layers where it is no more."""
    chain = signal.source.chain()
    layers = [source.layer for source in chain[1:]]
    grus = [layer for layer in layers if isinstance(layer, FloatGru)]
    dense = [layer for layer in layers if isinstance(layer, FloatDense)]
    straight = (
        all(above.below is below for below, above in itertools.pairwise(chain))
        and not signal.source.parts
    )
    if straight and grus and layers == [*grus, *dense]:
        return FloatNetwork(
            gru=grus[0],
            head=signal.matrix,
            head_bias=signal.bias,
            upper=tuple(grus[1:]),
            dense=tuple(dense),
        )
    return _build_layered(signal, chain)


def _build_layered(signal: OnnxSignal, chain: list[OnnxSource]) -> FloatLayeredNetwork:
    inputs = next(source for source in chain if source.layer is None)
    layers = [source for source in chain if source.layer is not None]
    places = {id(inputs): 0} | {id(source): k for k, source in enumerate(layers, 1)}

    def order(source: OnnxSource) -> tuple[tuple[int, ...], list[int]]:
        """Return what a source is made of in ascending order, and its columns in that order."""
        singles = source.singles
        ends = np.cumsum([0, *(s.width for s in singles)])
        ascending = sorted(range(len(singles)), key=lambda i: places[id(singles[i])])
        columns = [c for i in ascending for c in range(ends[i], ends[i + 1])]
        return tuple(places[id(singles[i])] for i in ascending), columns

    found = []
    for source in layers:
        assert source.layer is not None and source.below is not None
        reads, columns = order(source.below)
        layer = source.layer
        if isinstance(layer, FloatLayerNorm):
            found.append(FloatLayer(layer, reads))
        elif isinstance(layer, FloatDense):
            found.append(
                FloatLayer(
                    FloatDense(
                        layer.weight[:, columns],
                        layer.bias,
                        layer.activation,
                        layer.low,
                        layer.high,
                    ),
                    reads,
                )
            )
        elif isinstance(layer, FloatGru):
            w_x = layer.w_x[:, :, columns]
            found.append(FloatLayer(FloatGru(w_x, layer.w_h, layer.bias, layer.reset), reads))
        else:
            found.append(
                FloatLayer(type(layer)(layer.w_x[:, :, columns], layer.w_h, layer.bias), reads)
            )
    reads, columns = order(signal.source)
    return FloatLayeredNetwork(
        inputs.width, tuple(found), reads, signal.matrix[:, columns], signal.bias
    )
