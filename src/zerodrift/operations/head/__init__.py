"""A network's linear output layer."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import matmul_exact, round_shift
from zerodrift.operations.c_text import CTable, make_table
from zerodrift.operations.errors import Error, Known, bound_sum, copy_known, list_terms
from zerodrift.operations.intervals import Bound, Interval, bound_row
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real

COPY_SHIFT = 15


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
    def _weights_t(self) -> Array:
        return np.ascontiguousarray(self.weights.T, dtype=np.float64)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return weights . round_shift(h_q30, 15); the bias is part of `drift`."""
        return {}, matmul_exact(self._copy(values), self._weights_t)

    def _copy(self, values: Values) -> IntArray:
        """Return the int16 copies [B, H] of the layer below."""
        return np.asarray(round_shift(values[self.inputs[0]], 15))

    def _bound_copies(self, below: list[Interval]) -> list[Interval]:
        """Return the ranges of the int16 copies."""
        return [h_q30.round_shift(15) for h_q30 in below]

    def _write_copy(self, w: Writer, values: Names) -> str:
        return w.round_shift(values[self.inputs[0]], 15)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 32-bit sums."""
        h_q15 = self._bound_copies(inputs[0])
        rows = [
            bound_row(f"{self.name}[{k}]", self.weights[k].astype(np.int64), 0, h_q15, 32)
            for k in range(self.width)
        ]
        return [total for total, _ in rows], [bound for _, bound in rows]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the errors of the layer below and of its copies in Q0.15, and the weights'."""
        k = real.place[1]
        copies = [copy_known(x, COPY_SHIFT) for x in inputs]
        below = self.inputs[0]
        chip = {(below, j): int(w) * out.scale for j, w in enumerate(self.weights[k])}
        return bound_sum(list_terms(real, copies), chip, out.offset, "weights")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write weights . round_shift(h_q30, 15)."""
        return {}, w.op("MatMul", self._write_copy(w, values), w.constant(self.weights.T))

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        return (make_table(f"{self.name}_weights", "i16", self.weights),)

    def check_form(self) -> None:
        """Raise ValueError where the weights are no matrix."""
        if self.weights.ndim != 2 or not self.weights.shape[1]:
            raise ValueError(f"node '{self.name}': weights {self.weights.shape} do not fit")


@dataclass(frozen=True)
class IntegerJoinHead(IntegerHead):
    """The same over a join, whose numbers are int16 copies already."""

    kind: ClassVar[str] = "join_head"

    def _copy(self, values: Values) -> IntArray:
        """Return the numbers [B, N] of the join."""
        return np.asarray(values[self.inputs[0]])

    def _bound_copies(self, below: list[Interval]) -> list[Interval]:
        """Return the join's ranges."""
        return list(below)

    def _write_copy(self, w: Writer, values: Names) -> str:
        return values[self.inputs[0]]


NODES = (
    IntegerHead,
    IntegerJoinHead,
)
