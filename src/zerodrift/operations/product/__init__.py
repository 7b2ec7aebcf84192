"""Product of two signals: span shift is temperature times load."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import (
    INT32_MAX,
    INT32_MIN,
    choose_exponent,
    round_shift,
    saturate,
)
from zerodrift.operations.c_text import format_int32
from zerodrift.operations.errors import HALF, Error, Known, require
from zerodrift.operations.formats import EXACT_BITS, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Shift,
    check_limits,
    check_shift,
    shorten,
)
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.offset import remove_offset
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import fit


def product(a: Array, b: Array) -> Array:
    """Return a * b."""
    return np.asarray(a * b)


@dataclass(frozen=True)
class IntegerProduct(IntegerNode):
    """saturate(round_shift(a * b, shift), low, high), the product in 64 bits."""

    kind: ClassVar[str] = "product"
    reads: ClassVar[int | None] = 2
    shift: int
    low: int = INT32_MIN
    high: int = INT32_MAX

    @property
    def limited(self) -> bool:
        """Whether the result is limited to less than its 32 bits."""
        return (self.low, self.high) != (INT32_MIN, INT32_MAX)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the product."""
        product = round_shift(values[self.inputs[0]] * values[self.inputs[1]], self.shift)
        limited = saturate(product, self.low, self.high) if self.limited else product
        return {}, np.asarray(limited)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the 64-bit product with its rounding half, and the 32-bit result."""
        check_shift(self.name, self.shift, 62)
        check_limits(self.name, self.low, self.high)
        product = inputs[0][0] * inputs[1][0]
        half = Interval(0, 1 << self.shift >> 1)
        out = product.round_shift(self.shift).saturate(self.low, self.high)
        return [out], [
            Bound(f"{self.name}.product", product + half, 64).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return A eb + B ea + ea eb, what the result's scale was rounded by, and half a count.

        Both factors have an offset of 0. The real product is limited where this one is.
        """
        a, b = inputs
        require(a.offset == b.offset == 0, f"{self.name}: a factor's zero is not 0")
        error = a.error.scale(b.magnitude) + b.error.scale(a.magnitude + a.error.total)
        gap = abs(out.scale / (a.scale * b.scale * (1 << self.shift)) - 1)
        wrong = shorten(gap * a.magnitude * b.magnitude + abs(out.offset))
        rounded = abs(out.scale) * HALF if self.shift else Fraction(0)
        return error + Error(coefficients=wrong, rounding=rounded)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate(round_shift(a * b, shift), low, high)."""
        a, b = (values[name] for name in self.inputs)
        return {}, w.saturate(w.round_shift(w.mul(a, b), self.shift), self.low, self.high)

    def express(self) -> str:
        """Return the product in C."""
        a, b = self.inputs
        product = f"zd_round_shift64((int64_t){a} * {b}, {self.shift}u)"
        if self.limited:
            product = f"zd_clamp64({product}, {format_int32(self.low)}, {self.high})"
        return f"(int32_t){product}"

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}.shift", self.shift, 62)]

    @property
    def ends(self) -> tuple[int, int] | None:
        """The values at which the result stands at a limit."""
        return (self.low, self.high) if self.limited else None


def multiply(nodes: FormattedNodes, a: Signal, b: Signal, node: Node | None = None) -> Signal:
    """Return a * b, limited to the range of the float node that it is, if that is given."""
    if not a.node or not b.node:
        moving, factor = (b, a.offset) if not a.node else (a, b.offset)
        if factor == 0.0 or not moving.node:
            scaled = Signal("", 0.0, moving.offset * factor)
        else:
            scaled = replace(moving, scale=moving.scale * factor, offset=moving.offset * factor)
        return scaled.standing_for("product", (a, b))
    a = fit(nodes, remove_offset(nodes, a), EXACT_BITS)
    b = fit(nodes, remove_offset(nodes, b), EXACT_BITS)  # that of a, if they are the same
    out = nodes.intervals[a.node][0] * nodes.intervals[b.node][0]
    scale = a.scale * b.scale
    ends = sorted(end / scale for end in nodes.find_limits(node, 0.0))
    low, high = (min(max(end, float(out.low)), float(out.high)) for end in ends)
    shift = max(0, -choose_exponent(max(abs(low), abs(high), 1.0), 2**SIGNAL_BITS))
    limits = {}
    if (low, high) != (out.low, out.high):
        limits = {"low": round(low / 2.0**shift), "high": round(high / 2.0**shift)}
    product = IntegerProduct(nodes.new_name("product"), (a.node, b.node), shift, **limits)
    result = Signal(nodes.append(product), scale * 2.0**shift)
    return result.standing_for("product", (a, b))


def lower(nodes: FormattedNodes, node: Node, a: Signal, b: Signal) -> Signal:
    """Return a * b, limited to its range."""
    return multiply(nodes, a, b, node)


OPERATION = Operation("product", product, lower, ("a", "b"))
NODES = (IntegerProduct,)
