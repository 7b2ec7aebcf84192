"""Integer nodes with formats: sums, products and offsets of signals that fit by proof."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import choose_exponent
from zerodrift.operations.graph import Node
from zerodrift.operations.gru import IntegerGru
from zerodrift.operations.intervals import Interval
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.signal import IntegerOffset, IntegerProduct
from zerodrift.operations.total import IntegerSum

RANGE_SPANS = 4.0
"""A signal that could leave its calibrated range by more than this multiple of the range's span is
limited there: bits spent on what was never seen are taken from what was. The clock is limited there
too: age goes on, and a quarter of what a calibration lasts would be no time."""
SIGNAL_BITS = 27
"""A result is shifted until its magnitude is at most 2**27, so that a low-pass and sums of a few
signals fit 32 bits without another shift."""
EXACT_BITS = 30
"""A sum that needs no shift is left as it is up to here."""
MOST_EXTRA_BITS = 16
"""A sum of signals of unequal scales gets at most this many bits more than the coarsest of them."""
ROW_ERROR = 2.0**-4
"""Rounded coefficients may put a sum wrong by this many counts at most, as far as bits allow."""
COEFFICIENT_LIMIT = 2**30
SUM_LIMIT = 2**61
"""64-bit sums stay below this, halves and biases included."""


@dataclass(frozen=True)
class Signal:
    """An integer signal q and its meaning: physical value = q * scale + offset.

    A constant has no node (an empty name), scale 0 and its value as offset.
    """

    node: str
    scale: float
    offset: float = 0.0


def _describe(node: IntegerNode) -> object:
    """Return all of a node but its name, or None where nodes are never equal."""
    values = {key: value for key, value in node.attributes().items() if key != "name"}
    if any(isinstance(value, np.ndarray | IntegerGru) for value in values.values()):
        return None
    return (node.kind, *values.items())


@dataclass(kw_only=True)
class FormattedNodes:
    """Integer nodes in the order of computation, each proven when it is added.

    Args:
        ranges: lowest and highest value of float nodes over calibration, as far as known.
    """

    ranges: Mapping[Node, tuple[float, float]] = field(default_factory=dict)
    nodes: list[IntegerNode] = field(default_factory=list)
    intervals: dict[str, list[Interval]] = field(default_factory=dict)
    _equal: dict[object, str] = field(default_factory=dict)

    def append(self, node: IntegerNode) -> str:
        """Add an integer node, prove it, and return its name; an equal node is not added again."""
        key = _describe(node)
        if key in self._equal:
            return self._equal[key]
        interval, _ = node.prove([self.intervals[name] for name in node.inputs])
        self.nodes.append(node)
        self.intervals[node.name] = interval
        if key is not None:
            self._equal[key] = node.name
        return node.name

    def reach(self, x: Signal) -> int:
        """Return the largest magnitude of a signal's integers."""
        return self.intervals[x.node][0].magnitude

    def new_name(self, kind: str) -> str:
        """Return a name for the next node."""
        return f"{kind}_{len(self.nodes)}"

    def find_limits(self, node: Node | None, offset: float) -> tuple[float, float]:
        """Return the range of (value - offset) beyond which a node's result is to be limited."""
        if node is None or node not in self.ranges:
            return -math.inf, math.inf
        low, high = self.ranges[node]
        margin = RANGE_SPANS * max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-300)
        return low - margin - offset, high + margin - offset

    def fit(self, x: Signal, bits: int) -> Signal:
        """Return the signal with integers of at most 2**bits in magnitude."""
        surplus = (self.reach(x) - 1).bit_length() - bits
        if surplus <= 0:
            return x
        node = IntegerSum(self.new_name("sum"), (x.node,), (1,), 1 << surplus >> 1, surplus)
        return Signal(self.append(node), x.scale * 2.0**surplus, x.offset)

    def add(self, terms: Sequence[Signal], low: float, high: float, offset: float) -> Signal:
        """Return the sum of q * scale of the terms, limited to low .. high, plus offset."""
        ends = [
            sorted(
                (self.intervals[t.node][0].low * t.scale, self.intervals[t.node][0].high * t.scale)
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
        name = self.new_name("sum")
        coefficients, bias, shift = self.format_row(terms, row, 0.0, name)
        limits = {}
        if (low, high) != (bottom, top):
            limits = {"low": round(low / scale), "high": round(high / scale)}
        node = IntegerSum(
            name, tuple(t.node for t in terms), tuple(coefficients), bias, shift, **limits
        )
        return Signal(self.append(node), scale, offset)

    def format_row(
        self,
        signals: Sequence[Signal],
        row: NDArray[np.float64],
        constant: float,
        where: str,
        widest: int = 2**61,
    ) -> tuple[list[int], int, int]:
        """Return coefficients, bias (half folded in) and shift of a 64-bit sum of signals.

        Args:
            signals: the J inputs.
            row: [J] wanted result per integer of each signal.
            constant: wanted result of the signals' zeros.
            where: names the row in messages.
            widest: largest coefficient.

        Raises:
            CheckError: the sum does not fit 64 bits in any format.
        """
        magnitudes = [self.reach(s) for s in signals]
        total = abs(constant) + sum(abs(float(c)) * m for c, m in zip(row, magnitudes, strict=True))
        largest = float(np.abs(row).max(initial=0.0))
        most = min(choose_exponent(total, SUM_LIMIT), choose_exponent(largest, widest), 56)
        if most < 0:
            raise CheckError(
                f"{where}: the coefficients of {[s.node for s in signals]} are too large for a"
                " 64-bit sum; the model is refused. Use a coarser output unit."
            )
        shift = min(most, max(choose_exponent(largest, COEFFICIENT_LIMIT), 0))
        while shift < most and any(
            abs(float(c) * 2.0**shift - round(float(c) * 2.0**shift)) * m > ROW_ERROR * 2.0**shift
            for c, m in zip(row, magnitudes, strict=True)
        ):
            shift += 1
        while (
            shift > 0
            and constant == 0.0
            and all(
                float(c) * 2.0 ** (shift - 1) == round(float(c) * 2.0 ** (shift - 1)) for c in row
            )
        ):
            shift -= 1  # exact with fewer bits
        coefficients = [round(float(c) * 2.0**shift) for c in row]
        return coefficients, round(constant * 2.0**shift) + (1 << shift >> 1), shift

    def remove_offset(self, x: Signal) -> Signal:
        """Return the same physical signal with offset 0, as far as the format resolves it."""
        offset = round(-x.offset / x.scale)
        if offset == 0:
            return replace(x, offset=0.0)
        if abs(offset) + self.reach(x) >= 2**EXACT_BITS:
            return self._absorb_offset(x)
        node = IntegerOffset(name=self.new_name("offset"), inputs=(x.node,), offset=offset)
        return Signal(self.append(node), x.scale)

    def _absorb_offset(self, x: Signal) -> Signal:
        """Return the signal with offset 0 where the offset is beyond the signal's own format."""
        reach = abs(x.offset) + self.reach(x) * abs(x.scale)
        scale = 2.0 ** -choose_exponent(reach, 2**SIGNAL_BITS)
        name = self.new_name("sum")
        coefficients, bias, shift = self.format_row(
            [x], np.array([x.scale / scale]), x.offset / scale, name
        )
        node = IntegerSum(name, (x.node,), tuple(coefficients), bias, shift)
        return Signal(self.append(node), scale)

    def multiply(self, a: Signal, b: Signal, node: Node | None = None) -> Signal:
        """Return a * b, limited to the range of the float node that it is, if that is given."""
        if not a.node or not b.node:
            moving, factor = (b, a.offset) if not a.node else (a, b.offset)
            if factor == 0.0 or not moving.node:
                return Signal("", 0.0, moving.offset * factor)
            return replace(moving, scale=moving.scale * factor, offset=moving.offset * factor)
        same = a == b
        a = self.fit(self.remove_offset(a), EXACT_BITS)
        b = a if same else self.fit(self.remove_offset(b), EXACT_BITS)
        out = self.intervals[a.node][0] * self.intervals[b.node][0]
        scale = a.scale * b.scale
        ends = sorted(end / scale for end in self.find_limits(node, 0.0))
        low, high = (min(max(end, float(out.low)), float(out.high)) for end in ends)
        shift = max(0, -choose_exponent(max(abs(low), abs(high), 1.0), 2**SIGNAL_BITS))
        limits = {}
        if (low, high) != (out.low, out.high):
            limits = {"low": round(low / 2.0**shift), "high": round(high / 2.0**shift)}
        product = IntegerProduct(self.new_name("product"), (a.node, b.node), shift, **limits)
        return Signal(self.append(product), scale * 2.0**shift)

    def negate(self, x: Signal) -> Signal:
        """Return the same physical signal with a scale of the other sign."""
        node = IntegerSum(self.new_name("sum"), (x.node,), (-1,), 0, 0)
        return Signal(self.append(node), -x.scale, x.offset)
