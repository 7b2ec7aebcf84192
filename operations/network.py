"""The network's nodes in fixed point: features, recurrent layer (stream or window), head, drift."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.arithmetic import (
    INT16_MAX,
    INT16_MIN,
    IntArray,
    matmul_exact,
    round_shift,
    saturate,
)
from zerodrift.operations.gru import H_LIMIT_Q30, IntegerGru
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    bound_row,
    check_limits,
    check_shift,
)
from zerodrift.operations.node import IntegerNode, State, Values


@dataclass(frozen=True)
class IntegerFeatures(IntegerNode):
    """The front end's whitening: int16 features from 32-bit signals, 64-bit sums, one rounding."""

    kind: ClassVar[str] = "features"
    matrix: NDArray[np.int32]  # [I, J]
    bias: NDArray[np.int64]
    """[I], the rounding half folded in."""
    shift: tuple[int, ...]

    @property
    def width(self) -> int:
        """Number of features I."""
        return int(self.matrix.shape[0])

    @cached_property
    def _matrix_t(self) -> IntArray:
        return np.ascontiguousarray(self.matrix.T, dtype=np.int64)

    @cached_property
    def _shifts(self) -> IntArray:
        return np.array(self.shift, dtype=np.int64)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return saturate((bias + matrix . signals) >> shift) to int16."""
        signals = np.stack([values[name] for name in self.inputs], axis=1)
        total = signals @ self._matrix_t + self.bias
        return {}, np.asarray(saturate(total >> self._shifts, INT16_MIN, INT16_MAX))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 64-bit sums; the outputs are at most int16 by saturation."""
        flat = [x[0] for x in inputs]
        out, bounds = [], []
        for i in range(self.width):
            check_shift(f"{self.name}[{i}]", self.shift[i], 63)
            total, bound = bound_row(
                f"{self.name}[{i}]", self.matrix[i].astype(np.int64), int(self.bias[i]), flat, 64
            )
            shifted = Interval(total.low >> self.shift[i], total.high >> self.shift[i])
            out.append(shifted.saturate(INT16_MIN, INT16_MAX))
            bounds.append(bound)
        return out, bounds


@dataclass(frozen=True)
class IntegerGruLayer(IntegerNode):
    """A GRU over the features: one step per sample, or afresh over the last `window` samples.

    The output is the hidden state in Q1.30.
    """

    kind: ClassVar[str] = "gru"
    gru: IntegerGru
    window: int
    """0: the state is carried from sample to sample ("stream")."""

    @property
    def width(self) -> int:
        """Number of hidden units H."""
        return self.gru.hidden

    def rest(self, values: Values) -> State:
        """Return a cold state: h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        return {"h_q30": np.zeros((x.shape[0], self.gru.hidden), dtype=np.int64)}

    def settle(self, values: Values) -> State:
        """Return the state at rest under the present features."""
        if self.window:
            return self.rest(values)
        return {"h_q30": self.gru.settle(values[self.inputs[0]])}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next state and the hidden state in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            h_q30 = self.gru.step(x, state["h_q30"])
            return {"h_q30": h_q30}, h_q30
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        h_q30 = np.zeros((x.shape[0], self.gru.hidden), dtype=np.int64)
        for k in range(self.window):
            h_q30 = self.gru.step(window[:, k], h_q30)
        return {"window": window}, h_q30

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of the recurrent layer.

        A window's features are taken to be any int16, so that the proof does not rest on what is
        stored in it; its position needs 16 bits.
        """
        features = [Interval(INT16_MIN, INT16_MAX)] * self.gru.inputs if self.window else inputs[0]
        bounds = self.gru.prove(self.name, features)
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * self.width, bounds


@dataclass(frozen=True)
class IntegerHead(IntegerNode):
    """The network's linear output layer: int16 weights, the state in Q0.15, 32-bit sums."""

    kind: ClassVar[str] = "head"
    weights: NDArray[np.int16]  # [K, H]

    @property
    def width(self) -> int:
        """Number of outputs K."""
        return int(self.weights.shape[0])

    @cached_property
    def _weights_t(self) -> NDArray[np.float64]:
        return np.ascontiguousarray(self.weights.T, dtype=np.float64)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return weights . round_shift(h_q30, 15); the bias is part of `drift`."""
        h_q15 = round_shift(values[self.inputs[0]], 15)
        return {}, matmul_exact(h_q15, self._weights_t)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 32-bit sums."""
        h_q15 = [h_q30.round_shift(15) for h_q30 in inputs[0]]
        rows = [
            bound_row(f"{self.name}[{k}]", self.weights[k].astype(np.int64), 0, h_q15, 32)
            for k in range(self.width)
        ]
        return [total for total, _ in rows], [bound for _, bound in rows]


@dataclass(frozen=True)
class IntegerDrift(IntegerNode):
    """The answer: per output a 64-bit sum of signals and the head's row, rounded once and limited.

    Inputs are the scalar signals in order and, last and only if `head` is set, the head's vector.
    """

    kind: ClassVar[str] = "drift"
    coefficients: NDArray[np.int64]  # [K, J] for the J scalar signals
    head_coefficients: NDArray[np.int64]  # [K]; zeros without a head
    bias: NDArray[np.int64]
    """[K], the rounding half folded in."""
    shift: tuple[int, ...]
    low: tuple[int, ...]
    high: tuple[int, ...]
    head: bool

    @property
    def width(self) -> int:
        """Number of outputs K."""
        return int(self.coefficients.shape[0])

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the scalar signals."""
        return self.inputs[:-1] if self.head else self.inputs

    @cached_property
    def _coefficients_t(self) -> IntArray:
        return np.ascontiguousarray(self.coefficients.T)

    @cached_property
    def _shifts(self) -> IntArray:
        return np.array(self.shift, dtype=np.int64)

    @cached_property
    def _limits(self) -> tuple[IntArray, IntArray]:
        return np.array(self.low, dtype=np.int64), np.array(self.high, dtype=np.int64)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return saturate((bias + sum of products) >> shift, low, high)."""
        return {}, self.limit(self.sum(values))

    def sum(self, values: Values) -> IntArray:
        """Return the drift before it is limited to low .. high."""
        total = self.bias
        if self.signals:
            signals = np.stack([values[name] for name in self.signals], axis=1)
            total = total + signals @ self._coefficients_t
        if self.head:
            total = total + values[self.inputs[-1]] * self.head_coefficients
        return np.asarray(total >> self._shifts)

    def limit(self, drift: IntArray) -> IntArray:
        """Return the drift limited to low .. high."""
        return np.asarray(saturate(drift, *self._limits))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 64-bit sums; the outputs lie within low .. high by saturation."""
        scalars = [x[0] for x in (inputs[:-1] if self.head else inputs)]
        out, bounds = [], []
        for k in range(self.width):
            check_shift(f"{self.name}[{k}]", self.shift[k], 63)
            check_limits(f"{self.name}[{k}]", self.low[k], self.high[k])
            row = self.coefficients[k]
            terms = list(scalars)
            if self.head:
                row = np.append(row, self.head_coefficients[k])
                terms.append(inputs[-1][k])
            total, bound = bound_row(f"{self.name}[{k}]", row, int(self.bias[k]), terms, 64)
            shifted = Interval(total.low >> self.shift[k], total.high >> self.shift[k])
            out.append(shifted.saturate(self.low[k], self.high[k]))
            bounds.append(bound)
        return out, bounds
