"""What an effect is written against: one set of operations, computed at once or recorded.

`NumpyOperations` gives arrays; `zerodrift.operations.graph.GraphOperations` gives nodes that the
exporter turns into integers and C. An effect's definition cannot tell the two apart.
"""

from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.affine import affine
from zerodrift.operations.clip import clip
from zerodrift.operations.delay import delay
from zerodrift.operations.difference import difference
from zerodrift.operations.exp2 import exp2
from zerodrift.operations.lowpass import lowpass
from zerodrift.operations.play import play
from zerodrift.operations.power import power
from zerodrift.operations.product import product
from zerodrift.operations.total import total

Array = NDArray[np.float64]
S = TypeVar("S")


class Operations(Protocol[S]):
    """The operations a compensator is made of, on signals of type S (arrays or graph nodes)."""

    @property
    def sample_period_s(self) -> float:
        """Seconds between samples."""
        ...

    def constant(self, value: float) -> S:
        """Return a signal that is always `value`."""
        ...

    def affine(self, x: S, gain: float, offset: float) -> S:
        """Return gain * x + offset."""
        ...

    def total(self, a: S, b: S) -> S:
        """Return a + b."""
        ...

    def difference(self, a: S, b: S) -> S:
        """Return a - b."""
        ...

    def product(self, a: S, b: S) -> S:
        """Return a * b."""
        ...

    def power(self, x: S, exponent: float) -> S:
        """Return x**exponent."""
        ...

    def exp2(self, x: S) -> S:
        """Return 2**x."""
        ...

    def lowpass(self, x: S, tau_s: float) -> S:
        """Return x after a first-order low-pass, at rest at its first sample."""
        ...

    def delay(self, x: S, delay_s: float) -> S:
        """Return x as it was `delay_s` ago."""
        ...

    def play(self, x: S, half_width: float) -> S:
        """Return the play operator (backlash) of x."""
        ...

    def clip(self, x: S, low: float, high: float) -> S:
        """Return x limited to low .. high."""
        ...


class NumpyOperations:
    """The operations computed at once, on float64 arrays with time along the last axis.

    Args:
        sample_period_s: seconds between samples.
        shape: shape of the signals, (n,) for one uninterrupted stretch.
    """

    def __init__(self, sample_period_s: float, shape: tuple[int, ...]) -> None:
        self._sample_period_s = sample_period_s
        self._shape = shape

    @property
    def sample_period_s(self) -> float:
        """Seconds between samples."""
        return self._sample_period_s

    def constant(self, value: float) -> Array:
        """Return an array of `value`."""
        return np.full(self._shape, value)

    def affine(self, x: Array, gain: float, offset: float) -> Array:
        """Return gain * x + offset."""
        return affine(x, gain, offset)

    def total(self, a: Array, b: Array) -> Array:
        """Return a + b."""
        return total(a, b)

    def difference(self, a: Array, b: Array) -> Array:
        """Return a - b."""
        return difference(a, b)

    def product(self, a: Array, b: Array) -> Array:
        """Return a * b."""
        return product(a, b)

    def power(self, x: Array, exponent: float) -> Array:
        """Return x**exponent."""
        return power(x, exponent)

    def exp2(self, x: Array) -> Array:
        """Return 2**x."""
        return exp2(x)

    def lowpass(self, x: Array, tau_s: float) -> Array:
        """Return x after a first-order low-pass, at rest at its first sample."""
        return lowpass(x, self._sample_period_s, tau_s)

    def delay(self, x: Array, delay_s: float) -> Array:
        """Return x as it was `delay_s` ago."""
        return delay(x, self._sample_period_s, delay_s)

    def play(self, x: Array, half_width: float) -> Array:
        """Return the play operator (backlash) of x."""
        return play(x, half_width)

    def clip(self, x: Array, low: float, high: float) -> Array:
        """Return x limited to low .. high."""
        return clip(x, low, high)
