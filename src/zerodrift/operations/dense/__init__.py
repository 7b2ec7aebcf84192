"""Dense layers: a network's, also one without any state."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import (
    INT16_MAX,
    INT16_MIN,
    matmul_exact,
    round_shift,
    saturate,
)
from zerodrift.operations.c_text import CTable, RuntimePart, make_table
from zerodrift.operations.errors import (
    HALF,
    Error,
    Known,
    SumTerm,
    bound_held,
    bound_sum,
    copy_known,
)
from zerodrift.operations.intervals import Bound, Interval, Shift, check_shift
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real
from zerodrift.operations.tables import (
    NODE_MAX,
    STEP_BITS,
    TABLE_BITS,
    TANH,
    bound_tanh,
    bound_tanh_slope,
    tanh_q30,
    write_tanh,
)

COPY_BITS = 15
"""Fractional bits that a layer's output has beyond its int16 copy."""


ACTIVATIONS = ("tanh", "clip")


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

    @property
    def ends(self) -> tuple[int, int] | None:
        """The ends of int16; a rectifier's own are the float layer's too."""
        if self.activation == "tanh":
            return None
        return INT16_MIN << COPY_BITS, INT16_MAX << COPY_BITS

    @cached_property
    def _weights_t(self) -> Array:
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

    def _know_copies(self, inputs: Sequence[Known]) -> list[Known]:
        """Return what is known of the int16 copies."""
        return [copy_known(x, COPY_BITS) for x in inputs]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of the sum, by the largest slope of the activation, and the table's.

        The sum's error is that of its inputs, of rounded weights and bias, and of one rounding. A
        real layer of "clip" is limited to its own limits, which are rounded here.
        """
        i, (low, high, bias, *gains) = real.place[1], real.numbers
        of_copy = Fraction(1, 1 << TABLE_BITS)
        if self.activation == "clip":
            of_copy = out.scale * (1 << COPY_BITS)
        unit = of_copy / (1 << self.shift[i])
        below = self.inputs[0]
        chip = {(below, j): int(w) * unit for j, w in enumerate(self.weights[i])}
        terms = [
            SumTerm(Fraction(gain), (below, j), x)
            for j, (gain, x) in enumerate(zip(gains, self._know_copies(inputs), strict=True))
        ]
        constant = (int(self.bias[i]) - (1 << self.shift[i] >> 1)) * unit - Fraction(bias)
        error = bound_sum(terms, chip, constant, "weights")
        if self.shift[i]:
            error += Error(rounding=of_copy * HALF)
        total = Interval(int(self.bias[i]), int(self.bias[i]))
        for weight, term in zip(self.weights[i].tolist(), terms, strict=True):
            total = total + Interval(term.known.low, term.known.high).scale(weight)
        reached = Known(
            total.low >> self.shift[i], total.high >> self.shift[i], of_copy, Fraction(0), error
        )
        if self.activation == "clip":
            scale, bits = out.scale * (1 << COPY_BITS), COPY_BITS
            limited = Known(out.low >> bits, out.high >> bits, scale, Fraction(0))
            return bound_held((low, high), limited, reached)
        return error.scale(bound_tanh_slope(reached)) + Error(table=bound_tanh() * out.scale)

    def _write_copy(self, w: Writer, values: Names) -> str:
        return w.round_shift(values[self.inputs[0]], COPY_BITS)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write activation((bias + weights . x) >> shift), 15 fractional bits added."""
        total = w.op("MatMul", self._write_copy(w, values), w.constant(self.weights.T))
        scaled = w.floor_shift(w.add(total, w.constant(self.bias)), self.shift)
        if self.activation == "tanh":
            return {}, write_tanh(w, scaled)
        return {}, w.shift_left(w.saturate(scaled, self.low, self.high), COPY_BITS)

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        limits = {"low": self.low, "high": self.high} if self.activation == "clip" else {}
        return (
            make_table(f"{self.name}_weights", "i16", self.weights),
            make_table(f"{self.name}_bias", "i32", self.bias),
            make_table(f"{self.name}_shift", "u8", self.shift),
            *(make_table(f"{self.name}_{end}", "i16", limit) for end, limit in limits.items()),
        )

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The table of tanh, if it is the activation."""
        return (TANH,) if self.activation == "tanh" else ()

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}[{i}].shift", by, 31) for i, by in enumerate(self.shift)]


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

    def _know_copies(self, inputs: Sequence[Known]) -> list[Known]:
        """Return what is known of the features."""
        return list(inputs)

    def _write_copy(self, w: Writer, values: Names) -> str:
        return values[self.inputs[0]]


NODES = (
    IntegerDense,
    IntegerFeatureDense,
)
