"""Powers: x**2, x**3 of polynomials, t**p of ageing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.c_text import CTable, make_table
from zerodrift.operations.clip import limit
from zerodrift.operations.errors import HALF, Error, Known, require
from zerodrift.operations.formats import EXACT_BITS, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import (
    Bound,
    Interval,
    Range,
    Shift,
    check_shift,
    enclose_power,
    furthest,
    shorten,
)
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.offset import remove_offset
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.polynomial import (
    bound_polynomial,
    bound_power_octave,
    evaluate_polynomial,
    fit_octave,
    write_polynomial,
)
from zerodrift.operations.product import multiply
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import fit, negate

LARGEST_WHOLE_POWER = 16


POWER_DEGREE = 8
"""Degree of the polynomial of a power on one octave; within 2**-27 of it."""


def power(x: Array, exponent: float) -> Array:
    """Return x**exponent.

    Args:
        x: any shape; less than 0 counts as 0 unless the exponent is a whole number.
        exponent: dimensionless, > 0.
    """
    whole = round(exponent)
    if abs(exponent - whole) < 1e-12:
        return np.asarray(x**whole)
    return np.asarray(np.maximum(x, 0.0) ** exponent)


@dataclass(frozen=True)
class IntegerPower(IntegerNode):
    """x**p for a p > 0 that is not whole; 0 for x <= 0. Whole powers are products.

    With x = 2**n (1 + f), x**p = (1 + f)**p 2**(n p): a polynomial on one octave, times the entry
    of a table for the octave.

        result = round_shift(saturate(octave(f), low, high) gains[n], shift)
    """

    kind: ClassVar[str] = "power"
    octave: tuple[int, ...]
    """Coefficients of (1 + f)**p for 0 <= f < 1."""
    low: int
    high: int
    """(1 + f)**p at the ends of the octave, in the format of `octave`."""
    gains: tuple[int, ...]
    """2**(n p) for n = 0, 1, ... up to the largest x."""
    shift: int

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the power."""
        return {}, self._raise(values[self.inputs[0]])

    def _raise(self, x: IntArray) -> IntArray:
        positive = np.maximum(x, 1)
        n = np.frexp(positive.astype(np.float64))[1].astype(np.int64) - 1
        f_q31 = (positive << (31 - n)) - (1 << 31)
        mantissa = saturate(evaluate_polynomial(f_q31, self.octave), self.low, self.high)
        product = mantissa * np.array(self.gains, dtype=np.int64)[n]
        half = np.int64(1) << self.shift >> 1
        return np.asarray(np.where(x > 0, (product + half) >> self.shift, 0))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the polynomial, the index of the octave, the product and the result."""
        check_shift(self.name, self.shift, 62)
        largest = max(inputs[0][0].high, 1)
        octaves = largest.bit_length() - 1
        if octaves >= len(self.gains) or min(self.gains) < 0 or not 0 <= self.low <= self.high:
            raise CheckError(
                f"{self.name}: x reaches {largest}, in octave {octaves}, and the table of octaves"
                f" has {len(self.gains)}, all to be positive. The model is refused."
            )
        product = Interval(0, self.high * max(self.gains[: octaves + 1]))
        half = Interval(0, 1 << self.shift >> 1)
        out = product.round_shift(self.shift)
        return [out], [
            *bound_polynomial(self.name, self.octave),
            Bound(f"{self.name}.octaves", Interval(0, len(self.gains)), 6).check(),
            Bound(f"{self.name}.mantissa", Interval(self.low, self.high), 32).check(),
            Bound(f"{self.name}.gain", Interval(0, max(self.gains)), 32).check(),
            Bound(f"{self.name}.product", product + half, 64).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return x's error as the power passes it on, the octave's, the gains', and half a count.

        With x = scale 2**n (1 + f), the wanted gain is scale**p 2**(n p) in the result's format.
        """
        (x,) = inputs
        exponent = Fraction(real.numbers[0])
        require(x.offset == 0 and x.scale > 0, f"{self.name}: x's zero is not 0")
        bits = self.low.bit_length() - 1
        largest = max(x.high, 1).bit_length()
        octave = bound_power_octave(self.octave, exponent, bits)
        top = enclose_power(Fraction(2), exponent).high * (1 << bits)
        octave += max(top - self.high, Fraction(0)) + abs(self.low - (1 << bits))
        unit = out.scale / (1 << self.shift)
        of_scale = enclose_power(x.scale, exponent)
        gaps, table = [], Fraction(0)
        for n, gain in enumerate(self.gains[:largest]):
            of_octave = enclose_power(Fraction(1 << n), exponent)
            wanted = Range(of_scale.low * of_octave.low, of_scale.high * of_octave.high)
            gaps.append(furthest(gain * unit * (1 << bits), wanted) * top / (1 << bits))
            table = max(table, octave * gain * unit)
        passed = self._pass_on(x, exponent)
        rounded = out.scale * HALF if self.shift else Fraction(0)
        return passed + Error(
            coefficients=shorten(max(gaps)), table=shorten(table), rounding=rounded
        )

    @staticmethod
    def _pass_on(x: Known, exponent: Fraction) -> Error:
        """Return what x's error becomes: by the largest slope, or near 0 by what e itself becomes.

        Below 1 the power is concave: numbers e apart have powers at most e**p apart.
        """
        e = x.error.total
        if e == 0:
            return x.error
        lowest, highest = max(x.ends[0] - e, Fraction(0)), max(x.ends[1] + e, Fraction(0))
        steepest = lowest if exponent < 1 else highest
        slopes = []
        if steepest > 0:
            slopes.append(exponent * enclose_power(steepest, exponent - 1).high)
        elif exponent > 1:
            return x.error.scale(Fraction(0))
        if exponent < 1:
            slopes.append(enclose_power(e, exponent).high / e)
        return x.error.scale(min(slopes))

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write round_shift(saturate(octave(f), low, high) gains[n], shift), x = 2**n (1 + f)."""
        x = values[self.inputs[0]]
        positive = w.maximum(x, w.constant(1))
        powers = w.constant([1 << n for n in range(1, 31)])
        reached = w.flag(
            w.op("GreaterOrEqual", w.op("Unsqueeze", positive, w.constant([1])), powers)
        )
        n = w.op("ReduceSum", reached, w.constant([1]), keepdims=0)
        scale = w.op("Gather", w.constant([1 << (31 - n) for n in range(31)]), n)
        f_q31 = w.sub(w.mul(positive, scale), w.constant(1 << 31))
        mantissa = w.saturate(write_polynomial(w, f_q31, self.octave), self.low, self.high)
        product = w.mul(mantissa, w.op("Gather", w.constant(list(self.gains)), n))
        power = w.round_shift(product, self.shift)
        return {}, w.op("Where", w.op("Greater", x, w.constant(0)), power, w.constant(0))

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        return (
            make_table(f"{self.name}_octave", "i32", self.octave),
            make_table(f"{self.name}_gains", "i32", self.gains),
        )

    def express(self) -> str:
        """Return the power in C."""
        return f"zd_power(&{self.name}_p, {self.inputs[0]})"

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}.shift", self.shift, 62)]


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return x**exponent: products where that is whole, octaves where not."""
    exponent = node.constants[0]
    whole = round(exponent)
    if exponent <= 0.0 or (exponent > LARGEST_WHOLE_POWER):
        raise CheckError(
            f"a power of {exponent:g} in {node!r} has no fixed-point form; above 0 up to"
            f" {LARGEST_WHOLE_POWER} have. Write the effect with another exponent."
        )
    if not x.node:
        return _raise_constant(x, exponent)
    if abs(exponent - whole) < 1e-12:
        return _raise_whole(nodes, node, x, whole)
    return _raise_fraction(nodes, node, x, exponent)


def _raise_constant(x: Signal, exponent: float) -> Signal:
    value = float(power(np.array(x.offset), exponent))
    return Signal("", 0.0, value).standing_for("power", (x,), exponent)


def _raise_whole(nodes: FormattedNodes, node: Node, x: Signal, whole: int) -> Signal:
    """Return x**whole by squares and products, the last of which is limited to its range."""
    if whole == 1:
        return x
    x = fit(nodes, remove_offset(nodes, x), EXACT_BITS)
    factors: list[Signal | None] = []  # of the running result: itself, or x
    for digit in bin(whole)[3:]:
        factors += [None, x] if digit == "1" else [None]
    result = x
    for i, factor in enumerate(factors):
        last = i == len(factors) - 1
        result = multiply(nodes, result, factor or result, node if last else None)
    return result


def _raise_fraction(nodes: FormattedNodes, node: Node, x: Signal, exponent: float) -> Signal:
    if x.scale < 0.0:
        x = negate(nodes, x)
    x = fit(nodes, remove_offset(nodes, x), EXACT_BITS)
    top = nodes.find_limits(node, 0.0)[1] ** (1.0 / exponent)
    x = limit(nodes, x, -math.inf, top)
    if not x.node:
        return _raise_constant(x, exponent)
    largest = max(nodes.intervals[x.node][0].high, 1)
    octaves = largest.bit_length() - 1
    bits = 29 - math.ceil(exponent)
    high = min(round(2.0 ** (bits + exponent)), 2**30)
    gain_bits = 30 - math.ceil(octaves * exponent)
    gains = tuple(round(2.0 ** (n * exponent + gain_bits)) for n in range(octaves + 1))
    shift = max(0, (high * gains[-1]).bit_length() - SIGNAL_BITS)
    raised = IntegerPower(
        name=nodes.new_name("power"),
        inputs=(x.node,),
        octave=fit_octave(lambda v: float(v**exponent), POWER_DEGREE, bits),
        low=1 << bits,
        high=high,
        gains=gains,
        shift=shift,
    )
    scale = float(x.scale**exponent * 2.0 ** (shift - bits - gain_bits))
    return Signal(nodes.append(raised), scale).standing_for("power", (x,), exponent)


OPERATION = Operation("power", power, lower, ("x",), ("exponent",))
NODES = (IntegerPower,)
