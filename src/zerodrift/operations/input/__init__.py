"""A raw code becomes a signal."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.errors import Error, Known, SumTerm, bound_sum
from zerodrift.operations.intervals import Bound, Interval, check_limits, check_shift
from zerodrift.operations.node import CODES, ChannelNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real


@dataclass(frozen=True)
class IntegerInput(ChannelNode):
    """A raw code, limited to its declared range, counted from `origin`, given fractional bits.

    The code is int16 or int32, as the model's channel says; `origin` is for the wide ones, such as
    seconds since 1970.
    """

    kind: ClassVar[str] = "input"
    reads: ClassVar[int | None] = 0
    origin: int = 0

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return (saturate(code, low, high) - origin) << shift."""
        code = saturate(values[CODES][:, self.channel], self.low, self.high)
        return {}, np.asarray((code - self.origin) << self.shift)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the shifted code; holds for every code because of the limits."""
        check_shift(self.name, self.shift, 30)
        code = check_limits(self.name, self.low, self.high) - Interval(self.origin, self.origin)
        out = Interval(code.low << self.shift, code.high << self.shift)
        return [out], [
            Bound(f"{self.name}.code", code, 32).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return what the offset was rounded by: both models are given the same codes."""
        lsb, offset, taken_off = map(Fraction, real.numbers)
        chip = {(self.name, 0): out.scale}
        code = Known(out.low, out.high, lsb / (1 << self.shift), self.origin * lsb + offset)
        terms = [SumTerm(Fraction(1), (self.name, 0), code)]
        return bound_sum(terms, chip, out.offset + taken_off, "coefficients")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write (saturate(code, low, high) - origin) << shift."""
        code = w.saturate(w.column(values[CODES], self.channel), self.low, self.high)
        counted = w.sub(code, w.constant(self.origin)) if self.origin else code
        return {}, w.shift_left(counted, self.shift)

    @property
    def ends(self) -> tuple[int, int]:
        """The values at which the result stands at a limit."""
        return (self.low - self.origin) << self.shift, (self.high - self.origin) << self.shift


NODES = (IntegerInput,)
