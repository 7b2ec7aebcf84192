"""The front end's whitening: what a network reads."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, saturate
from zerodrift.operations.c_text import CTable, make_table
from zerodrift.operations.errors import HALF, Error, Known, bound_sum, gather, list_terms
from zerodrift.operations.intervals import Bound, Interval, Shift, bound_row, check_shift
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real


@dataclass(frozen=True)
class IntegerFeatures(IntegerNode):
    """The front end's whitening: int16 features from 32-bit signals, 64-bit sums, one rounding."""

    kind: ClassVar[str] = "features"
    reads: ClassVar[int | None] = None
    matrix: NDArray[np.int32]  # [I, J]
    bias: IntArray
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

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the signals' errors, those of the rounded matrix, and half a count.

        The real feature is limited to the same values.
        """
        i = real.place[1]
        unit = out.scale / (1 << self.shift[i])
        chip = gather(self.inputs, map(int, self.matrix[i]), unit)
        constant = (int(self.bias[i]) - (1 << self.shift[i] >> 1)) * unit + out.offset
        error = bound_sum(list_terms(real, inputs), chip, constant, "coefficients")
        return error + Error(rounding=out.scale * HALF if self.shift[i] else Fraction(0))

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate((bias + matrix . signals) >> shift) to int16."""
        signals = w.stack([values[name] for name in self.inputs])
        total = w.op("MatMul", signals, w.constant(self.matrix.T))
        total = w.add(total, w.constant(self.bias))
        return {}, w.saturate(w.floor_shift(total, self.shift), INT16_MIN, INT16_MAX)

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        return (
            make_table(f"{self.name}_matrix", "i32", self.matrix, rows=self.width),
            make_table(f"{self.name}_bias", "i64", self.bias),
            make_table(f"{self.name}_shift", "u8", self.shift),
        )

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}[{i}].shift", by, 63) for i, by in enumerate(self.shift)]

    def check_form(self) -> None:
        """Raise ValueError where the arrays do not fit together, or the inputs."""
        shapes = [self.matrix.shape, self.bias.shape, (len(self.shift),)]
        rows = (self.bias.size,)
        if 0 in self.matrix.shape or shapes != [(*rows, len(self.inputs)), rows, rows]:
            raise ValueError(f"node '{self.name}': arrays {shapes} do not fit its inputs")

    @property
    def ends(self) -> tuple[int, int]:
        """The values at which the result stands at a limit."""
        return INT16_MIN, INT16_MAX


NODES = (IntegerFeatures,)
