"""Powers of two: a photo-transistor's dark current doubles every so many kelvin."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.c_text import RuntimePart, format_factor, format_int32, format_int64
from zerodrift.operations.errors import HALF, Error, Known, SumTerm, bound_sum, require
from zerodrift.operations.formats import SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import Bound, Interval, Shift, check_shift, enclose_exp2
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.polynomial import (
    bound_exp2_octave,
    bound_polynomial,
    evaluate_polynomial,
    write_polynomial,
)
from zerodrift.operations.signals import Real, Signal

EXPONENT_LIMIT = 60.0
"""|x| beyond this is limited: 2**60 of anything is no longer a measurement."""


EXP2 = RuntimePart("zd_exp2.h", "zd_exp2_is_sound")
EXPONENT_BITS = 24
"""Fractional bits of the exponent in fixed point."""


OCTAVE_Q29 = (536870912, 372130457, 128972571, 29786284, 5198974, 665093, 117533)
"""2**f = sum c_i f**i for 0 <= f <= 1 in Q2.29, exact at both ends, within 4.1 LSB between them.

All are positive, so that Horner's rule is monotone in f.
"""


MANTISSA_SHIFT = 2
"""Results stay at or below 2**28: this many bits fewer than the octave's 2**30."""


def exp2(x: Array) -> Array:
    """Return 2**x for x limited to -60 .. 60.

    Args:
        x: any shape, dimensionless.
    """
    return np.exp2(np.clip(x, -EXPONENT_LIMIT, EXPONENT_LIMIT))


@dataclass(frozen=True)
class IntegerExp2(IntegerNode):
    """2**e of an affine function e of the input, the largest result near 2**28.

        t = saturate((bias + coefficient x) >> shift, low, high)         e in Q7.24
        result = round_shift(octave(t mod 2**24), min(top + 2 - (t >> 24), 31))

    It stands for 2**(e - top) 2**27.
    """

    kind: ClassVar[str] = "exp2"
    coefficient: int
    bias: int
    """The rounding half of `shift` folded in."""
    shift: int
    low: int
    high: int
    """Limits of the exponent in Q7.24."""
    top: int
    """high >> 24, or in a unit's block above it: the octave in which results are largest."""

    @property
    def ends(self) -> tuple[int, int]:
        """No result is as low as -1, and that at the exponent's upper limit.

        At the lower one the float model is limited as well.
        """
        return -1, self.raise_to(self.high)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the power of two."""
        total = values[self.inputs[0]] * self.coefficient + self.bias
        return {}, self._raise(np.asarray(saturate(total >> self.shift, self.low, self.high)))

    def raise_to(self, t_q24: int) -> int:
        """Return the result of an exponent in Q7.24."""
        return int(self._raise(np.array([t_q24]))[0])

    def _raise(self, t_q24: IntArray) -> IntArray:
        f_q31 = (t_q24 & ((1 << EXPONENT_BITS) - 1)) << (31 - EXPONENT_BITS)
        mantissa = evaluate_polynomial(f_q31, OCTAVE_Q29)
        shift = np.minimum(self.top + MANTISSA_SHIFT - (t_q24 >> EXPONENT_BITS), 31)
        return np.asarray((mantissa + (np.int64(1) << (shift - 1))) >> shift)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the exponent's sum and every step of the polynomial; exact for the result.

        All coefficients of the octave are positive and octave(1) <= 2**30, so the result is
        monotone in t and lies between its values at the ends.
        """
        check_shift(self.name, self.shift, 62)
        if not (self.low <= self.high and self.high >> EXPONENT_BITS <= self.top):
            raise CheckError(
                f"{self.name}: exponents {self.low} .. {self.high} end above octave {self.top}."
                " The model is refused."
            )
        bias = Interval(self.bias, self.bias)
        scaled = inputs[0][0].scale(self.coefficient)
        total = scaled + bias
        t = Interval(total.low >> self.shift, total.high >> self.shift)
        t = t.saturate(self.low, self.high)
        out = Interval(self.raise_to(t.low), self.raise_to(t.high))
        reach = abs(self.bias) + scaled.magnitude
        return [out], [
            Bound(f"{self.name}.sum", Interval(-reach, reach), 64).check(),
            Bound(f"{self.name}.exponent", t, 32).check(),
            *bound_polynomial(self.name, OCTAVE_Q29),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of the largest result from an exponent error of d, and the octave's.

        Both exponents are limited to low .. high, so that 2**e is off by 2**top (2**d - 1) at most.
        """
        unit = Fraction(1, 1 << (self.shift + EXPONENT_BITS))
        chip = {(self.inputs[0], 0): self.coefficient * unit}
        constant = (self.bias - (1 << self.shift >> 1)) * unit
        terms = [SumTerm(Fraction(1), (self.inputs[0], 0), inputs[0])]
        exponent = bound_sum(terms, chip, constant, "coefficients")
        if self.shift:
            exponent += Error(rounding=HALF / (1 << EXPONENT_BITS))
        highest = Fraction(self.high, 1 << EXPONENT_BITS)
        largest = enclose_exp2(highest).high
        # 2**d - 1 <= d (2**d - 1) / d, the slope of a chord: causes keep their shares
        require(exponent.total <= 1, f"{self.name}: its exponent is off by more than 1")
        moved = enclose_exp2(exponent.total).high - 1
        slope = moved / exponent.total if exponent.total else Fraction(0)
        far = self.top + MANTISSA_SHIFT - (self.low >> EXPONENT_BITS) > 31
        rounded = out.scale * (1 if far else HALF)  # smaller ones may become a whole count
        table = bound_exp2_octave(OCTAVE_Q29, 29) * out.scale / (1 << MANTISSA_SHIFT)
        return exponent.scale(largest * slope) + Error(rounding=rounded, table=table)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write round_shift(octave(t mod 2**24), min(top + 2 - (t >> 24), 31))."""
        total = w.add(
            w.mul(values[self.inputs[0]], w.constant(self.coefficient)), w.constant(self.bias)
        )
        t = w.saturate(w.floor_shift(total, self.shift), self.low, self.high)
        octave = w.floor_shift(t, EXPONENT_BITS)
        fraction = w.op("Mod", t, w.constant(1 << EXPONENT_BITS))
        mantissa = write_polynomial(w, w.shift_left(fraction, 31 - EXPONENT_BITS), OCTAVE_Q29)
        shift = w.minimum(w.sub(w.constant(self.top + MANTISSA_SHIFT), octave), w.constant(31))
        divisor = w.op("Gather", w.constant([1 << s for s in range(32)]), shift)
        half = w.op("Gather", w.constant([1 << s >> 1 for s in range(32)]), shift)
        return {}, w.op("Div", w.add(mantissa, half), divisor)  # the mantissa is positive

    def express(self) -> str:
        """Return the power of two in C."""
        term = f"({format_factor(self.coefficient)} * {self.inputs[0]})"
        total = f"zd_asr64({format_int64(self.bias)} + {term}, {self.shift}u)"
        exponent = f"zd_clamp64({total}, {format_int32(self.low)}, {self.high})"
        return f"zd_exp2((int32_t){exponent}, {self.top})"

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The table of 2**f."""
        return (EXP2,)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        return [Shift(f"{self.name}.shift", self.shift, 62)]


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return 2**x, limited to its range."""
    if not x.node:
        value = 2.0 ** min(max(x.offset, -EXPONENT_LIMIT), EXPONENT_LIMIT)
        return Signal("", 0.0, value).standing_for("exp2", (x,))
    one = 2.0**EXPONENT_BITS
    name = nodes.new_name("exp2")
    coefficients, bias, shift = nodes.format_row(
        [x], np.array([x.scale * one]), x.offset * one, name
    )
    interval = nodes.intervals[x.node][0]
    ends = sorted(end * x.scale + x.offset for end in (interval.low, interval.high))
    top = min(nodes.find_limits(node, 0.0)[1], 2.0**EXPONENT_LIMIT)
    high = min(math.log2(top), ends[1] + 1.0 / one, EXPONENT_LIMIT)
    high_q24 = math.floor(high * one)
    low_q24 = min(round(-EXPONENT_LIMIT * one), high_q24)
    octave = high_q24 >> EXPONENT_BITS
    power = IntegerExp2(name, (x.node,), coefficients[0], bias, shift, low_q24, high_q24, octave)
    out = Signal(nodes.append(power), 2.0 ** (octave - SIGNAL_BITS))
    return out.standing_for("exp2", (x,))


OPERATION = Operation("exp2", exp2, lower, ("x",))
NODES = (IntegerExp2,)
