"""The LSTM as TensorFlow Lite's converter quantizes it (16x8): int16 values, int8 weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.layers import LARGEST, Array, Task
from zerodrift.operations.lstm.cell import FloatLstm

INPUT_SCALE = LARGEST / 2**15
"""What one count of an input is worth; the zero points are 0."""
STATE_SCALE = 2.0**-15


@dataclass(frozen=True)
class Gate:
    """Weights and biases of one gate."""

    w_x: NDArray[np.int8]
    """[H, I]"""
    scale_x: float
    """What one count of `w_x` is worth."""
    w_h: NDArray[np.int8]
    """[H, H]"""
    scale_h: float
    bias: NDArray[np.int64]
    """[H], one count is worth `INPUT_SCALE * scale_x`."""


@dataclass(frozen=True)
class Lstm16x8:
    """The integers of an LSTM."""

    gates: tuple[Gate, ...]
    """In the order of `FloatLstm`: i, f, g, o."""
    power: int
    """One count of the cell's state is worth 2**power."""


def quantize_16x8(task: Task) -> Lstm16x8:
    """Return an LSTM with a scale for each matrix and a power of two for the cell's state."""
    lstm = task.cell
    assert isinstance(lstm, FloatLstm)
    gates = []
    for k in range(4):
        w_x, scale_x = _round_weights(lstm.w_x[k])
        w_h, scale_h = _round_weights(lstm.w_h[k])
        bias = np.round(lstm.bias[k] / (INPUT_SCALE * scale_x)).astype(np.int64)
        gates.append(Gate(w_x, scale_x, w_h, scale_h, bias))
    return Lstm16x8(tuple(gates), int(np.ceil(np.log2(task.largest_carry))) - 15)


def encode(x: Array) -> NDArray[np.generic]:
    """Return inputs [T, I] in counts."""
    return np.clip(np.round(x / INPUT_SCALE), -32768, 32767).astype("<i2")


def decode(out: NDArray[np.generic]) -> Array:
    """Return states [T, H] from counts."""
    return out.astype(np.float64) * STATE_SCALE


def _round_weights(weights: Array) -> tuple[NDArray[np.int8], float]:
    """Return a matrix in 8 bits and what one count is worth."""
    scale = float(np.abs(weights).max()) / 127.0
    return np.round(weights / scale).astype(np.int8), scale
