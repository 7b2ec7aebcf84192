"""A recurrent network in float64, whoever trained it: GRUs, dense layers, a linear head."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.train.onnx_network import OnnxNetwork

STEPS_AT_ONCE = 10_000


@dataclass(frozen=True)
class FloatNetwork:
    """GRUs on top of each other, dense layers, and outputs = head x + head_bias."""

    gru: FloatGru
    """The layer that reads the features."""
    head: Array
    """[K, N] in output units."""
    head_bias: Array
    """[K] in output units."""
    upper: tuple[FloatGru, ...] = ()
    """Further layers, each on the state of the one before it."""
    dense: tuple[FloatDense, ...] = ()
    """Between the topmost state and the head."""
    trained: OnnxNetwork | None = None
    """The file that training left, where it is one of ours: its answers are asked of it."""

    @property
    def inputs(self) -> int:
        """Number of features I."""
        return int(self.gru.w_x.shape[2])

    def list_arrays(self) -> list[tuple[str, Array]]:
        """Return all weights and biases by name."""
        named = [("head", self.head), ("head bias", self.head_bias)]
        for k, gru in enumerate(self.layers):
            named += [(f"GRU {k} {name}", getattr(gru, name)) for name in ("w_x", "w_h", "bias")]
        for k, layer in enumerate(self.dense):
            named.append((f"dense layer {k}", np.column_stack([layer.weight, layer.bias])))
        return named

    @property
    def layers(self) -> tuple[FloatGru, ...]:
        """All recurrent layers from the bottom up."""
        return (self.gru, *self.upper)

    def with_layers(self, layers: Sequence[FloatGru]) -> "FloatNetwork":
        """Return the network with other recurrent layers."""
        return replace(self, gru=layers[0], upper=tuple(layers[1:]), trained=None)

    def start(self, batch: int) -> list[Array]:
        """Return states of zero, [B, H] each."""
        return [np.zeros((batch, layer.w_h.shape[1])) for layer in self.layers]

    def settle(self, x: Array) -> list[Array]:
        """Return the states at rest under constant features x [B, I]."""
        states = []
        for layer in self.layers:
            x = layer.settle(x)
            states.append(x)
        return states

    def step(self, x: Array, states: Sequence[Array]) -> list[Array]:
        """Return the states after features x [B, I]."""
        after = []
        for layer, state in zip(self.layers, states, strict=True):
            x = layer.step(x, state)
            after.append(x)
        return after

    def read_out(self, top: Array) -> Array:
        """Return the outputs [..., K] for the topmost state [..., H]."""
        for layer in self.dense:
            top = layer.step(top)
        return np.asarray(top @ self.head.T + self.head_bias)

    def run(self, features: Array, states: Sequence[Array] | None = None) -> Array:
        """Return the outputs [B, T, K] for features [B, T, I], from states or else from zero."""
        now = list(states) if states is not None else self.start(features.shape[0])
        parts = []
        for first in range(0, features.shape[1], STEPS_AT_ONCE):  # bounds the memory
            x = features[:, first : first + STEPS_AT_ONCE]
            for i, layer in enumerate(self.layers):
                x = layer.run(x, now[i])
                now[i] = x[:, -1]
            parts.append(self.read_out(x))
        return np.concatenate(parts, axis=1)

    def answer(self, features: Array, window: int) -> Array:
        """Return the outputs [n, K] for features [n, I] of a run that starts at rest.

        Args:
            features: of the whole run.
            window: samples that each answer is from; 0 carries the state from sample to sample.
        """
        if self.trained is not None:
            return self.trained.run(features, window)
        if window:
            return self.run_windows(features, window)
        return np.asarray(self.run(features[None], self.settle(features[:1]))[0])

    def run_windows(self, features: Array, length: int) -> Array:
        """Return the outputs [n, K] for features [n, I], each from zero over the last `length`.

        Before the first sample the features are taken to have been what they are there.
        """
        padded = np.concatenate([np.repeat(features[:1], length - 1, axis=0), features])
        windows = np.lib.stride_tricks.sliding_window_view(padded, length, axis=0)  # [n, I, N]
        now = self.start(len(features))
        for t in range(length):
            now = self.step(windows[:, :, t], now)
        return self.read_out(now[-1])

    def rescale_inputs(self, center: Array, scale: Array) -> "FloatNetwork":
        """Return the same network for features (x - center) / scale in place of x."""
        gru = self.gru
        bias = gru.bias.copy()
        bias[:3] += gru.w_x @ center
        return FloatNetwork(
            FloatGru(gru.w_x * scale, gru.w_h, bias, gru.reset),
            self.head,
            self.head_bias,
            self.upper,
            self.dense,
        )
