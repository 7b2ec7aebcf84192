"""Collects integer nodes whose formats are proven to fit; operations add their nodes to it."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import choose_exponent
from zerodrift.operations.intervals import Interval
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.operation import Node
from zerodrift.operations.signals import Signal

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
LOWPASS_FRACTION = 24
"""Extra fractional bits of a low-pass's state, against stalling (see `IntegerLowpass`)."""
SUM_LIMIT = 2**61
"""64-bit sums stay below this, halves and biases included."""


def _describe(node: IntegerNode) -> Hashable:
    """Return a node's fields except its name, or None where nodes are never equal."""
    key = (node.kind, *(item for item in node.attributes().items() if item[0] != "name"))
    try:
        hash(key)
    except TypeError:  # arrays
        return None
    return key


@dataclass(kw_only=True)
class FormattedNodes:
    """Integer nodes in the order of computation, each proven when it is added.

    Args:
        sample_period_s: the firmware's step.
        variable_step: whether each step is given its duration.
        ranges: lowest and highest value of float nodes over calibration, as far as known.
    """

    sample_period_s: float
    variable_step: bool = False
    ranges: Mapping[Node, tuple[float, float]] = field(default_factory=dict)
    nodes: list[IntegerNode] = field(default_factory=list)
    intervals: dict[str, list[Interval]] = field(default_factory=dict)
    _equal: dict[Hashable, str] = field(default_factory=dict)

    def append(self, node: IntegerNode) -> str:
        """Add an integer node, prove it, and return its name; an equal node is not added again."""
        key = _describe(node)
        if key in self._equal:
            return self._equal[key]
        if self.variable_step and node.needs_equal_steps:
            raise CheckError(
                f"operation '{node.name}' ({node.kind}) carries from sample to sample what stands"
                " for steps of one length; a variable step has none. Use [network] kind ="
                ' "lag_bank" or "none", or state sample_period_s as a number.'
            )
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

    def format_row(
        self,
        signals: Sequence[Signal],
        row: Array,
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
