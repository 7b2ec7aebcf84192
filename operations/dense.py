"""Dense layers in float."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FloatDense:
    """activation(weight x + bias)."""

    weight: Array  # [M, N]
    bias: Array  # [M]
    activation: str
    """"tanh", or "clip" to low .. high."""
    low: float = -np.inf
    high: float = np.inf

    def step(self, x: Array) -> Array:
        """Return the layer's output [..., M] for x [..., N]."""
        total = x @ self.weight.T + self.bias
        return np.tanh(total) if self.activation == "tanh" else np.clip(total, self.low, self.high)


@dataclass(frozen=True)
class FloatFeedForward:
    """Dense layers and outputs = head x + head_bias, without any state."""

    dense: tuple[FloatDense, ...]
    """The first reads the features."""
    head: Array
    """[K, N] in output units."""
    head_bias: Array
    """[K] in output units."""

    def run(self, features: Array) -> Array:
        """Return the outputs [..., K] for features [..., I]."""
        x = features
        for layer in self.dense:
            x = layer.step(x)
        return np.asarray(x @ self.head.T + self.head_bias)
