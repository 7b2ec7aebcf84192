"""Further layers of a network in fixed point: GRUs on top of each other, and dense layers.

The output of every layer is int32 with 15 more fractional bits than the int16 copy that the layer
after it reads: Q1.30 for a GRU's state, and Q0.15 in that copy.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import (
    INT16_MAX,
    INT16_MIN,
    IntArray,
    matmul_exact,
    round_shift,
    saturate,
)
from zerodrift.operations.gru import H_LIMIT_Q30, IntegerGru
from zerodrift.operations.intervals import Bound, Interval, check_shift
from zerodrift.operations.network import IntegerGruLayer
from zerodrift.operations.node import IntegerNode, State, Values
from zerodrift.operations.tables import NODE_MAX, STEP_BITS, tanh_q30

COPY_BITS = 15
"""Fractional bits that a layer's output has beyond its int16 copy."""
ACTIVATIONS = ("tanh", "clip")


@dataclass(frozen=True)
class IntegerGruStack(IntegerGruLayer):
    """GRUs on top of each other: each reads the state of the one below after its step.

    `gru` is the topmost; its state is the output.
    """

    kind: ClassVar[str] = "gru_stack"
    lower: tuple[IntegerGru, ...]
    """The layers below, the one that reads the features first."""

    @property
    def layers(self) -> tuple[IntegerGru, ...]:
        """All layers from the bottom up."""
        return (*self.lower, self.gru)

    def _split(self, lower_q30: IntArray, h_q30: IntArray) -> list[IntArray]:
        ends = np.cumsum([layer.hidden for layer in self.lower])
        return [*np.split(lower_q30, ends[:-1], axis=1), h_q30]

    def _step_all(self, x: IntArray, states: list[IntArray]) -> list[IntArray]:
        after = []
        for layer, h_q30 in zip(self.layers, states, strict=True):
            after.append(layer.step(x, h_q30))
            x = round_shift(after[-1], COPY_BITS)
        return after

    def _zeros(self, batch: int) -> list[IntArray]:
        return [np.zeros((batch, layer.hidden), dtype=np.int64) for layer in self.layers]

    def rest(self, values: Values) -> State:
        """Return cold states: all h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        *lower, top = self._zeros(x.shape[0])
        return {"h_q30": top, "lower_q30": np.concatenate(lower, axis=1)}

    def settle(self, values: Values) -> State:
        """Return the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.rest(values)
        x, states = values[self.inputs[0]], []
        for layer in self.layers:
            states.append(layer.settle(x))
            x = round_shift(states[-1], COPY_BITS)
        return {"h_q30": states[-1], "lower_q30": np.concatenate(states[:-1], axis=1)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next states and the topmost one in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._step_all(x, self._split(state["lower_q30"], state["h_q30"]))
            lower = np.concatenate(states[:-1], axis=1)
            return {"h_q30": states[-1], "lower_q30": lower}, states[-1]
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        states = self._zeros(x.shape[0])
        for k in range(self.window):
            states = self._step_all(window[:, k], states)
        return {"window": window}, states[-1]

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a state's int16 copy is at most 32767."""
        if not self.lower:
            raise CheckError(f"{self.name}: one layer is no stack. The model is refused.")
        below: list[Interval] = inputs[0]
        if self.window:
            below = [Interval(INT16_MIN, INT16_MAX)] * self.lower[0].inputs
        bounds: list[Bound] = []
        for level, layer in enumerate(self.layers):
            if layer.inputs != len(below):
                raise CheckError(
                    f"{self.name}: layer {level} reads {layer.inputs} values, and gets"
                    f" {len(below)}. The model is refused."
                )
            bounds += layer.prove(f"{self.name}.{level}", below)
            below = [Interval(-INT16_MAX, INT16_MAX)] * layer.hidden
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        limit = Interval(-H_LIMIT_Q30, H_LIMIT_Q30)
        return [limit] * self.width, bounds


@dataclass(frozen=True)
class IntegerDense(IntegerNode):
    """A dense layer with its activation: int16 weights, 32-bit sums, one rounding per row.

    "tanh" reads the table that the GRU reads; "clip" limits to `low` .. `high`, so that a rectifier
    has low = 0.
    """

    kind: ClassVar[str] = "dense"
    weights: NDArray[np.int16]  # [M, N]
    bias: NDArray[np.int32]
    """[M], the rounding half of the shift folded in."""
    shift: tuple[int, ...]
    """[M] from the accumulator to the table's t_q16, or to the int16 result of "clip"."""
    activation: str
    low: tuple[int, ...]
    high: tuple[int, ...]
    """[M] int16 limits of "clip"; empty for "tanh"."""

    @property
    def width(self) -> int:
        """Number of rows M."""
        return int(self.weights.shape[0])

    @cached_property
    def _weights_t(self) -> NDArray[np.float64]:
        return np.ascontiguousarray(self.weights.T, dtype=np.float64)

    def _copy(self, values: Values) -> IntArray:
        """Return the int16 copies [B, N] of the layer below."""
        return np.asarray(round_shift(values[self.inputs[0]], COPY_BITS))

    def _bound_copies(self, below: list[Interval]) -> list[Interval]:
        """Return the ranges of the int16 copies."""
        return [x.round_shift(COPY_BITS) for x in below]

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return activation((bias + weights . x) >> shift), 15 fractional bits added."""
        x = self._copy(values)
        scaled = (matmul_exact(x, self._weights_t) + self.bias) >> np.array(self.shift)
        if self.activation == "tanh":
            return {}, tanh_q30(scaled).astype(np.int64)
        limited = saturate(scaled, np.array(self.low), np.array(self.high))
        return {}, np.asarray(limited << COPY_BITS)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 32-bit sums, whatever their order; the outputs are limited."""
        copies = self._bound_copies(inputs[0])
        limits = [self.low, self.high] if self.activation == "clip" else [(), ()]
        rows = [self.width] * 2 if self.activation == "clip" else [0, 0]
        if (
            self.activation not in ACTIVATIONS
            or self.weights.shape[1] != len(copies)
            or self.bias.shape != (self.width,)
            or len(self.shift) != self.width
            or [len(limit) for limit in limits] != rows
        ):
            raise CheckError(
                f"{self.name}: {self.activation} over weights {self.weights.shape} with"
                f" {self.bias.size} biases does not fit {len(copies)} inputs. The model is refused."
            )
        out, bounds = [], []
        for i in range(self.width):
            where = f"{self.name}[{i}]"
            check_shift(where, self.shift[i], 31)
            total = Interval(int(self.bias[i]), int(self.bias[i]))
            reach = abs(int(self.bias[i]))
            for weight, x in zip(self.weights[i].tolist(), copies, strict=True):
                total = total + x.scale(weight)
                reach += abs(weight) * x.magnitude
            bounds.append(Bound(where, Interval(-reach, reach), 32).check())
            if self.activation == "tanh":
                end = NODE_MAX << STEP_BITS
                out.append(Interval(-end, end))
                continue
            limit = Interval(self.low[i], self.high[i])
            bounds.append(Bound(f"{where}.limit", limit, 16).check())
            shifted = Interval(total.low >> self.shift[i], total.high >> self.shift[i])
            out.append(shifted.saturate(limit.low, limit.high).scale(1 << COPY_BITS))
        return out, bounds


@dataclass(frozen=True)
class IntegerFeatureDense(IntegerDense):
    """A dense layer that reads the int16 features: the first of a network without a GRU."""

    kind: ClassVar[str] = "feature_dense"

    def _copy(self, values: Values) -> IntArray:
        """Return the features [B, N]."""
        return np.asarray(values[self.inputs[0]])

    def _bound_copies(self, below: list[Interval]) -> list[Interval]:
        """Return the features' ranges."""
        return list(below)
