"""The GRU and the LSTM that every library is given, their inputs, and their answers in float64."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from benchmarks.bench_kernels import HIDDEN, INPUTS
from zerodrift.base.arrays import Array
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import FloatLstm

LARGEST = 4.0
"""|x| of every input is below it."""
STEPS = 2000


@dataclass(frozen=True)
class Task:
    """A recurrent layer over one sequence from a state of zero."""

    kind: str
    """"gru" or "lstm"."""
    cell: FloatGru | FloatLstm
    x: Array
    """[T, I]"""

    @cached_property
    def truth(self) -> Array:
        """Return the states h [T, H] in float64."""
        if isinstance(self.cell, FloatGru):
            return self.cell.run(self.x[None], np.zeros((1, HIDDEN)))[0]
        return self.cell.run(self.x[None], np.zeros((1, 2 * HIDDEN)))[0][0]

    @cached_property
    def largest_carry(self) -> float:
        """Return the largest |c| of the LSTM's cells over the sequence."""
        assert isinstance(self.cell, FloatLstm)
        state, largest = np.zeros((1, 2 * HIDDEN)), 0.0
        for row in self.x:
            state = self.cell.run(row[None, None], state)[1]
            largest = max(largest, float(np.abs(state[:, HIDDEN:]).max()))
        return largest

    def without_inner_bias(self) -> "Task":
        """Return the same with a GRU whose bias inside the reset is 0."""
        assert isinstance(self.cell, FloatGru)
        bias = self.cell.bias.copy()
        bias[3] = 0.0
        return Task(self.kind, replace(self.cell, bias=bias), self.x)

    def measure_error(self, h: Array) -> float:
        """Return the RMS error of states [T, H], in % of the RMS of the true ones' variation."""
        error = np.sqrt(((h - self.truth) ** 2).mean())
        return float(100.0 * error / np.sqrt(self.truth.var(axis=0).mean()))


def draw_task(kind: str, seed: int) -> Task:
    """Return a random layer of 16 units on 4 inputs: weights as large as training leaves them."""
    rng = np.random.default_rng(seed)
    gates = 4 if kind == "lstm" else 3
    w_x = rng.normal(size=(gates, HIDDEN, INPUTS)) * 0.5
    w_h = rng.normal(size=(gates, HIDDEN, HIDDEN)) / np.sqrt(HIDDEN)
    bias = rng.normal(size=(4, HIDDEN)) * 0.2
    cell = FloatLstm(w_x, w_h, bias) if kind == "lstm" else FloatGru(w_x, w_h, bias, "after")
    return Task(kind, cell, _draw_inputs())


def _draw_inputs() -> Array:
    """Return [T, I]: noise through a low-pass, of RMS 1."""
    rng, x = np.random.default_rng(5), np.zeros((STEPS, INPUTS))
    for t in range(1, STEPS):
        x[t] = 0.9 * x[t - 1] + rng.normal(size=INPUTS) * np.sqrt(1.0 - 0.9**2)
    return np.clip(x, -0.99 * LARGEST, 0.99 * LARGEST)
