"""Signals of any scales added up, rounded once: what sums, and other formats, are made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN, choose_exponent, saturate
from zerodrift.operations.c_text import format_factor, format_int32, format_int64
from zerodrift.operations.clip import limit
from zerodrift.operations.errors import HALF, Error, Known, bound_sum, gather, list_terms
from zerodrift.operations.formats import EXACT_BITS, MOST_EXTRA_BITS, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Shift,
    bound_row,
    check_limits,
    check_shift,
)
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node
from zerodrift.operations.signals import Real, Signal


@dataclass(frozen=True)
class IntegerSum(IntegerNode):
    """Signals of any scales added up in 64 bits, rounded once.

    saturate((bias + coefficients . x) >> shift, low, high)
    """

    kind: ClassVar[str] = "sum"
    reads: ClassVar[int | None] = None
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

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the inputs' errors, those of the rounded coefficients, and half a count.

        The real sum is limited where this one is, which brings two numbers no further apart.
        """
        unit = out.scale / (1 << self.shift)
        chip = gather(self.inputs, self.coefficients, unit)
        constant = (self.bias - (1 << self.shift >> 1)) * unit + out.offset
        error = bound_sum(list_terms(real, inputs), chip, constant, "coefficients")
        rounded = abs(out.scale) * HALF if self.shift else Fraction(0)
        return error + Error(rounding=rounded)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate((bias + coefficients . x) >> shift, low, high)."""
        total = w.constant(self.bias)
        for name, coefficient in zip(self.inputs, self.coefficients, strict=True):
            total = w.add(total, w.mul(values[name], w.constant(coefficient)))
        return {}, w.saturate(w.floor_shift(total, self.shift), self.low, self.high)

    def express(self) -> str:
        """Return the sum, without operations that do nothing in C."""
        terms = [format_int64(self.bias)] if self.bias else []
        for coefficient, name in zip(self.coefficients, self.inputs, strict=True):
            terms.append(f"({format_factor(coefficient)} * {name})")
        total = " + ".join(terms)
        total = f"zd_asr64({total}, {self.shift}u)" if self.shift else f"({total})"
        if self.limited:
            total = f"zd_clamp64({total}, {format_int32(self.low)}, {self.high})"
        return f"(int32_t){total}"

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}.shift", self.shift, 62)] if self.shift else []

    @property
    def ends(self) -> tuple[int, int] | None:
        """The values at which the result stands at a limit."""
        return (self.low, self.high) if self.limited else None


def fit(nodes: FormattedNodes, x: Signal, bits: int) -> Signal:
    """Return the signal with integers of at most 2**bits in magnitude."""
    surplus = (nodes.reach(x) - 1).bit_length() - bits
    if surplus <= 0:
        return x
    node = IntegerSum(nodes.new_name("sum"), (x.node,), (1,), 1 << surplus >> 1, surplus)
    out = Signal(nodes.append(node), x.scale * 2.0**surplus, x.offset)
    return out.standing_for("same", (x,))


def add(
    nodes: FormattedNodes, terms: Sequence[Signal], low: float, high: float, offset: float
) -> Signal:
    """Return the sum of q * scale of the terms, limited to low .. high, plus offset."""
    ends = [
        sorted(
            (nodes.intervals[t.node][0].low * t.scale, nodes.intervals[t.node][0].high * t.scale)
        )
        for t in terms
    ]
    bottom, top = sum(e[0] for e in ends), sum(e[1] for e in ends)
    largest = max(abs(t.scale) for t in terms)
    equal = all(abs(t.scale) == largest for t in terms)
    if equal and max(abs(bottom), abs(top)) < largest * 2**EXACT_BITS:
        low, high = bottom, top  # there are bits enough
    low, high = (min(max(end, bottom), top) for end in (low, high))
    reach = max(abs(low), abs(high))
    fits = choose_exponent(reach / largest, 2 ** (EXACT_BITS if equal else SIGNAL_BITS))
    scale = largest * 2.0 ** -min(fits, 0 if equal else MOST_EXTRA_BITS)
    row = np.array([t.scale / scale for t in terms])
    name = nodes.new_name("sum")
    coefficients, bias, shift = nodes.format_row(terms, row, 0.0, name)
    limits = {}
    if (low, high) != (bottom, top):
        limits = {"low": round(low / scale), "high": round(high / scale)}
    node = IntegerSum(
        name, tuple(t.node for t in terms), tuple(coefficients), bias, shift, **limits
    )
    return Signal(
        nodes.append(node), scale, offset
    )  # whoever asks for it knows of what it is a sum


def align(nodes: FormattedNodes, node: Node, signals: Sequence[Signal]) -> list[Signal]:
    """Return signals in one format, held where the float node that they become is limited."""
    held = [limit(nodes, x, *nodes.find_limits(node, 0.0)) for x in signals]
    moving = [x for x in held if x.node]
    if len({(x.scale, x.offset) for x in moving}) < 2 and all(x.scale > 0.0 for x in moving):
        return held
    ends = [
        end * x.scale + x.offset
        for x in moving
        for end in (nodes.intervals[x.node][0].low, nodes.intervals[x.node][0].high)
    ]
    middle = 0.5 * (min(ends) + max(ends))
    finest = max(abs(x.scale) for x in moving) * 2.0**-MOST_EXTRA_BITS
    scale = max(2.0 ** -choose_exponent(max(ends) - middle, 2**SIGNAL_BITS), finest)
    return [rescale(nodes, x, scale, middle) if x.node else x for x in held]


def rescale(nodes: FormattedNodes, x: Signal, scale: float, offset: float) -> Signal:
    """Return a signal in another format."""
    name = nodes.new_name("sum")
    row = np.array([x.scale / scale])
    coefficients, bias, shift = nodes.format_row([x], row, (x.offset - offset) / scale, name)
    node = IntegerSum(name, (x.node,), tuple(coefficients), bias, shift)
    return Signal(nodes.append(node), scale, offset).standing_for("same", (x,))


def negate(nodes: FormattedNodes, x: Signal) -> Signal:
    """Return the same physical signal with a scale of the other sign."""
    node = IntegerSum(nodes.new_name("sum"), (x.node,), (-1,), 0, 0)
    return Signal(nodes.append(node), -x.scale, x.offset).standing_for("same", (x,))


NODES = (IntegerSum,)
