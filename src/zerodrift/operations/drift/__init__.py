"""The drift: the last node of every model."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.errors import HALF, Error, Known, bound_sum, gather, list_terms
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Shift,
    bound_row,
    check_limits,
    check_shift,
)
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real


@dataclass(frozen=True)
class IntegerDrift(IntegerNode):
    """The drift: per output a 64-bit sum of signals and the head's row, rounded once and limited.

    Inputs are the scalar signals in order and, last and only if `head` is set, the head's vector.
    """

    kind: ClassVar[str] = "drift"
    reads: ClassVar[int | None] = None
    coefficients: IntArray  # [K, J] for the J scalar signals
    head_coefficients: IntArray  # [K]; zeros without a head
    bias: IntArray
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

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the errors of signals and head, those of the coefficients, and half a count.

        The real drift is limited where this one is.
        """
        k = real.place[1]
        unit = out.scale / (1 << self.shift[k])
        chip = gather(self.signals, map(int, self.coefficients[k]), unit)
        if self.head:
            chip[self.inputs[-1], k] = int(self.head_coefficients[k]) * unit
        constant = (int(self.bias[k]) - (1 << self.shift[k] >> 1)) * unit
        error = bound_sum(list_terms(real, inputs), chip, constant, "coefficients")
        return error + Error(output=out.scale * HALF if self.shift[k] else Fraction(0))

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write the drift, limited."""
        return {}, w.saturate(self.write_sum(w, values), self.low, self.high)

    def write_sum(self, w: Writer, values: Names) -> str:
        """Write the drift [B, K] before it is limited."""
        terms = []
        if self.signals:
            signals = w.stack([values[name] for name in self.signals])
            terms.append(w.op("MatMul", signals, w.constant(self.coefficients.T)))
        if self.head:
            terms.append(w.mul(values[self.inputs[-1]], w.constant(self.head_coefficients)))
        total = w.constant(self.bias)
        for term in terms:
            total = w.add(total, term)
        return w.floor_shift(total, self.shift)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}[{i}].shift", by, 63) for i, by in enumerate(self.shift)]


NODES = (IntegerDrift,)
