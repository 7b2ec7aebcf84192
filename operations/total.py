"""Sum of signals, of equal scale or not."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN, IntArray, saturate
from zerodrift.operations.intervals import Bound, Interval, bound_row, check_limits, check_shift
from zerodrift.operations.node import IntegerNode, State, Values

Array = NDArray[np.float64]


def total(a: Array, b: Array) -> Array:
    """Return a + b, both in the same unit."""
    return np.asarray(a + b)


@dataclass(frozen=True)
class IntegerSum(IntegerNode):
    """Signals of any scales added up in 64 bits, rounded once.

    saturate((bias + coefficients . x) >> shift, low, high)
    """

    kind: ClassVar[str] = "sum"
    coefficients: tuple[int, ...]
    bias: int
    """The rounding half of `shift` folded in."""
    shift: int
    low: int = INT32_MIN
    high: int = INT32_MAX

    @property
    def limited(self) -> bool:
        """Whether the result is limited to less than its 32 bits."""
        return (self.low, self.high) != (INT32_MIN, INT32_MAX)

    @cached_property
    def _coefficients(self) -> IntArray:
        return np.array(self.coefficients, dtype=np.int64)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the sum."""
        signals = np.stack([values[name] for name in self.inputs], axis=1)
        total = (signals @ self._coefficients + self.bias) >> self.shift
        return {}, np.asarray(saturate(total, self.low, self.high) if self.limited else total)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 64-bit sum in whatever order, and the 32-bit result."""
        check_shift(self.name, self.shift, 62)
        check_limits(self.name, self.low, self.high)
        total, bound = bound_row(
            f"{self.name}.sum", self._coefficients, self.bias, [x[0] for x in inputs], 64
        )
        out = Interval(total.low >> self.shift, total.high >> self.shift)
        out = out.saturate(self.low, self.high)
        return [out], [bound, Bound(self.name, out, 32).check()]
