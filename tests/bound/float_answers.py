"""The float model on the chip's codes, limited where the chip is: what the proven bound is about.

Goes through the float graph by the operations' float meaning and knows nothing of the error rules.
Of the integers it takes where they are limited, as the bound is about a float model with the same
limits. What double precision rounds is some 1e-13 of a value.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.quantize import Quantized
from zerodrift.operations.backend import NumpyOperations
from zerodrift.operations.formats import RANGE_SPANS
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.operations.signals import Signal

Array = NDArray[np.float64]
START_PASSES, MOST_ROUNDS = 4, 100
COUNTER_LIMIT = 2**27
LAYERS = ("drift", "head", "dense", "gru", "lstm")


def answer(
    described: FloatModel, calibration: Calibration, quantized: Quantized, codes: NDArray[np.int64]
) -> Array:
    """Return the drifts [B, T, K] of the float model for codes [B, T, C], from rest."""
    model = _Held(described, calibration, quantized)
    if not quantized.model.feeds_back:
        return model.run(codes, np.zeros((*codes.shape[:2], len(described.outputs))))
    rest = np.zeros((codes.shape[0], 1, len(described.outputs)))
    for _ in range(START_PASSES):
        rest = model.run(codes[:, :1], rest)
    before = np.repeat(rest, codes.shape[1], axis=1)
    for _ in range(max(MOST_ROUNDS, 2)):
        drift = model.run(codes, before)
        again = np.concatenate([rest, drift[:, :-1]], axis=1)
        if np.abs(again - before).max() <= 1e-13 * max(np.abs(again).max(), 1e-300):
            return drift
        before = again
    raise AssertionError("the load's loop does not settle")


class _Held:
    """The float model with the limits of the chip."""

    def __init__(
        self, described: FloatModel, calibration: Calibration, quantized: Quantized
    ) -> None:
        self._float, self._calibration, self._quantized = described, calibration, quantized
        self._integers = {node.name: node for node in quantized.model.nodes}
        self._nodes = list_nodes([*described.features, *described.taps])
        self._intervals = {}
        for node in quantized.model.nodes:
            inputs = [self._intervals[name] for name in node.inputs]
            self._intervals[node.name] = node.prove(inputs)[0]

    def run(self, codes: NDArray[np.int64], before: Array) -> Array:
        """Return the drifts [B, T, K] for codes [B, T, C] and the drifts of the step before."""
        ops = NumpyOperations(self._float.sample_period_s, codes.shape[:2])
        values: dict[Node, Array] = {}
        for node in self._nodes:
            if node.op == "input":
                value = self._read(node, codes, before)
            else:
                value = ops.compute(node, [values[child] for child in node.inputs])
            values[node] = self._limit(node, value)
        drift = np.broadcast_to(self._float.offset, before.shape).copy()
        for j, node in enumerate(self._float.features):
            held = self._hold(node, values[node])
            drift += held[..., None] * self._float.coefficients[j]
        if self._float.network is not None:
            drift += self._run_network(np.stack([values[tap] for tap in self._float.taps], axis=-1))
        last = self._quantized.model.drift
        scale = np.array([output.lsb_per_unit for output in self._float.outputs])
        return np.clip(drift, np.array(last.low) / scale, np.array(last.high) / scale)

    def _read(self, node: Node, codes: NDArray[np.int64], before: Array) -> Array:
        described, limits = self._float, self._calibration.code_limits
        steps = np.arange(codes.shape[1]) * described.sample_period_s
        if node.source not in described.sources:
            return np.broadcast_to(steps, codes.shape[:2]).copy()
        index = described.sources[node.source]
        channel, (low, high) = described.channels[index], limits[index]
        if node.source.startswith("load:"):
            names = [output.name for output in described.outputs]
            k = names.index(node.source.removeprefix("load:"))
            load = codes[..., index] * channel.lsb - before[..., k]
            return np.clip(load, low * channel.lsb, high * channel.lsb)
        value = channel.offset + np.clip(codes[..., index], low, high) * channel.lsb
        return value - (described.clock_origin_s if node.source == "clock_s" else 0.0)

    def _limit(self, node: Node, value: Array) -> Array:
        """Return a value limited where the node that gives it is."""
        signal = self._quantized.signals[node]
        if not signal.node:
            return value if node.op in ("constant", "affine") else self._hold(node, value)
        integer = self._integers[signal.node]
        if node.op in ("maximum", "minimum"):
            value = self._hold(node, value)
        if integer.kind == "power":  # its input is held below what gives the highest result
            value = np.minimum(value, self._hold(node, np.full(1, np.inf)))
        if integer.kind in ("input", "load") or node.op in ("affine", "clip"):
            return value
        if integer.kind in ("sum", "product", "exp2") and integer.ends is not None:
            return np.clip(value, *self._ends(signal))
        return value

    def _ends(self, signal: Signal) -> list[float]:
        interval = self._intervals[signal.node][signal.index]
        ends = [q * signal.scale + signal.offset for q in (interval.low, interval.high)]
        return sorted(ends)

    def _hold(self, node: Node, value: Array) -> Array:
        """Return a value held where it goes far beyond calibration."""
        if node not in self._calibration.ranges:
            return value
        low, high = self._calibration.ranges[node]
        margin = RANGE_SPANS * max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-300)
        return np.clip(value, low - margin, high + margin)

    def _run_network(self, taps: Array) -> Array:
        described = self._float
        assert described.whitening is not None and described.tap_mean is not None
        x = (taps - described.tap_mean) @ described.whitening.T
        scales = np.array([s.scale for s in _list_features(self._quantized)])
        x = np.clip(x, -32768 * scales, 32767 * scales)
        network = described.network
        assert network is not None
        if described.window:
            return np.stack([network.answer(run, described.window) for run in x])
        return network.run(x, network.settle(x[:, 0]))


def _list_features(quantized: Quantized) -> Sequence[Signal]:
    """Return the features' signals, found from the answers on."""
    found: dict[int, Signal] = {}
    stack = list(quantized.answers)
    while stack:
        signal = stack.pop()
        if signal.node == "features":
            found[signal.index] = signal
        elif signal.node.startswith(LAYERS) and signal.meaning is not None:
            first = signal.meaning.inputs
            stack.extend(first)
    return [found[i] for i in sorted(found)]
