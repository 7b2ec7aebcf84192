"""Subtracts a constant from a signal, so that its integers have no offset."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import choose_exponent
from zerodrift.operations.errors import Error, Known, bound_sum, list_terms
from zerodrift.operations.formats import EXACT_BITS, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import rescale


@dataclass(frozen=True)
class IntegerOffset(IntegerNode):
    """x - offset."""

    kind: ClassVar[str] = "offset"
    offset: int

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return x - offset."""
        return {}, values[self.inputs[0]] - self.offset

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the difference."""
        out = inputs[0][0] - Interval(self.offset, self.offset)
        return [out], [Bound(self.name, out, 32).check()]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of x and that of the rounded offset, at most half a count."""
        chip = {(self.inputs[0], 0): out.scale}
        constant = out.offset - self.offset * out.scale
        return bound_sum(list_terms(real, inputs), chip, constant, "coefficients")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write x - offset."""
        return {}, w.sub(values[self.inputs[0]], w.constant(self.offset))

    def express(self) -> str:
        """Return x - offset in C."""
        return f"{self.inputs[0]} - ({self.offset})"


def remove_offset(nodes: FormattedNodes, x: Signal) -> Signal:
    """Return the same physical signal with offset 0, as far as the format resolves it."""
    offset = round(-x.offset / x.scale)
    if offset == 0:
        return replace(x, offset=0.0).standing_for("same", (x,))
    if abs(offset) + nodes.reach(x) >= 2**EXACT_BITS:
        # the offset is beyond the signal's own format
        reach = abs(x.offset) + nodes.reach(x) * abs(x.scale)
        return rescale(nodes, x, 2.0 ** -choose_exponent(reach, 2**SIGNAL_BITS), 0.0)
    node = IntegerOffset(name=nodes.new_name("offset"), inputs=(x.node,), offset=offset)
    return Signal(nodes.append(node), x.scale).standing_for("same", (x,))


NODES = (IntegerOffset,)
