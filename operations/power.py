"""Powers: x**2, x**3 of polynomials, t**p of ageing."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import IntArray, saturate
from zerodrift.operations.intervals import Bound, Interval, check_shift
from zerodrift.operations.node import IntegerNode, State, Values
from zerodrift.operations.polynomial import bound_polynomial, evaluate_polynomial

Array = NDArray[np.float64]


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
