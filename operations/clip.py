"""Limits: a converter's rails, a calibrated range."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.arithmetic import IntArray, saturate
from zerodrift.operations.intervals import Bound, Interval, check_limits
from zerodrift.operations.node import IntegerNode, State, Values

Array = NDArray[np.float64]


def clip(x: Array, low: float, high: float) -> Array:
    """Return x limited to low .. high, limits in x's unit."""
    return np.clip(x, low, high)


@dataclass(frozen=True)
class IntegerClip(IntegerNode):
    """saturate(x, low, high)."""

    kind: ClassVar[str] = "clip"
    low: int
    high: int

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return saturate(x, low, high)."""
        return {}, np.asarray(saturate(values[self.inputs[0]], self.low, self.high))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the limits and the result."""
        limits = check_limits(self.name, self.low, self.high)
        out = inputs[0][0].saturate(self.low, self.high)
        return [out], [
            Bound(f"{self.name}.limits", limits, 32).check(),
            Bound(self.name, out, 32).check(),
        ]
