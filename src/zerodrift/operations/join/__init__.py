"""The input of a layer that reads several others: their int16 copies side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real

SHIFTS = (0, 15)


@dataclass(frozen=True)
class IntegerJoin(IntegerNode):
    """The features as they are, and the int16 copies of layers, side by side."""

    kind: ClassVar[str] = "join"
    reads: ClassVar[int | None] = None
    shift: tuple[int, ...]
    """Of each input: 0 for features, or another join; 15 for a layer, of which it takes copies."""
    widths: tuple[int, ...]
    """Numbers of each input."""

    @property
    def width(self) -> int:
        """Numbers of all inputs."""
        return sum(self.widths)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the copies [B, width]."""
        parts = [round_shift(values[n], s) for n, s in zip(self.inputs, self.shift, strict=True)]
        return {}, np.concatenate(parts, axis=1)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the copies, which fit 16 bits.

        Raises:
            CheckError: one does not, or there are more or fewer than joined.
        """
        parts = zip(inputs, self.shift, strict=True)
        out = [x.round_shift(shift) for part, shift in parts for x in part]
        if len(out) != self.width:
            raise CheckError(
                f"{self.name}: joins {self.width} values, and gets {len(out)}. The model is"
                " refused."
            )
        for i, x in enumerate(out):
            Bound(f"{self.name}[{i}]", x, 16).check()
        reach = (Interval(-x.magnitude, x.magnitude) for x in out)
        return out, [Bound(f"{self.name}[{i}]", x, 32) for i, x in enumerate(reach)]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise NoRuleError: joins occur with recurrent layers, for which no real meaning is
        stated."""
        raise NoRuleError("a join stands beside a recurrent layer, which carries errors on")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write the copies side by side."""
        parts = [w.round_shift(values[n], s) for n, s in zip(self.inputs, self.shift, strict=True)]
        return {}, parts[0] if len(parts) == 1 else w.op("Concat", *parts, axis=1)

    def check_form(self) -> None:
        """Raise ValueError where the fields do not fit together."""
        if not len(self.inputs) == len(self.shift) == len(self.widths) or not self.inputs:
            raise ValueError(f"node '{self.name}': {len(self.inputs)} inputs do not fit its fields")
        if any(s not in SHIFTS for s in self.shift) or any(n < 1 for n in self.widths):
            raise ValueError(f"node '{self.name}': shifts {self.shift}, widths {self.widths}")


NODES = (IntegerJoin,)
