"""The load as the chip computes it: the raw output less the drift of the step before."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN, saturate
from zerodrift.operations.errors import Error, Known, require
from zerodrift.operations.intervals import Bound, Interval, check_limits, check_shift
from zerodrift.operations.node import (
    CODES,
    PREVIOUS_DRIFT,
    ChannelNode,
    Names,
    OnnxStep,
    State,
    Values,
    Writer,
)
from zerodrift.operations.signals import Real

START_PASSES = 4
"""Times that the state of rest is computed with the drift that the time before gave.

The load at the start needs the drift, and the drift the load. An effect of the load is a few
percent of it, so each pass leaves a few percent of the last one's error."""


@dataclass(frozen=True)
class IntegerLoad(ChannelNode):
    """saturate(code - drift, low, high) << shift, with the previous step's drift of this output.

    Code and drift are counts of the same output.
    """

    kind: ClassVar[str] = "load"
    reads: ClassVar[int | None] = 0
    output: int
    """Index of the output."""

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the load."""
        load = values[CODES][:, self.channel] - values[PREVIOUS_DRIFT][:, self.output]
        return {}, np.asarray(saturate(load, self.low, self.high) << self.shift)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the shifted load; holds for every int32 code and drift because of the limits."""
        check_shift(self.name, self.shift, 30)
        full = Interval(INT32_MIN, INT32_MAX)
        out = Interval(self.low << self.shift, self.high << self.shift)
        return [out], [
            Bound(f"{self.name}.difference", full - full, 64).check(),
            Bound(f"{self.name}.limits", check_limits(self.name, self.low, self.high), 32).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of the drift one step before, which both models take off the same code.

        The real load is limited where this one is.
        """
        (lsb,) = map(Fraction, real.numbers)
        (drift,) = inputs  # in counts of the code
        require(
            out.scale * (1 << self.shift) == lsb and out.offset == 0, f"{self.name}: other counts"
        )
        return drift.error.scale(lsb)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate(code - drift of the step before, low, high) << shift."""
        code = w.column(values[CODES], self.channel)
        load = w.sub(code, w.column(values[PREVIOUS_DRIFT], self.output))
        return {}, w.shift_left(w.saturate(load, self.low, self.high), self.shift)

    @property
    def ends(self) -> tuple[int, int]:
        """The values at which the result stands at a limit."""
        return self.low << self.shift, self.high << self.shift

    @property
    def reads_drift(self) -> bool:
        """Whether the step takes the drift that the step before gave."""
        return True


NODES = (IntegerLoad,)
