"""x^p for an exponent that is not whole (3.9)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.kernels import Power, find_power
from zerodrift_proof.equality.node import Ends, Meaning, Node, Row
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class PowerOf(Node):
    """round_shift(saturate(octave(f), low, high) gains[n], shift) of x = 2^n (1 + f), or 0."""

    kind: ClassVar[str] = "power"
    octave: Row
    low: int
    high: int
    gains: Row
    shift: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the largest product with a gain that x can reach."""
        octaves = max(given[0].high, 1).bit_length()
        return Ends(0, self.high * max(self.gains[:octaves])).round_shift(self.shift)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the power."""
        numbers = Power(self.octave, self.gains, self.low, self.high, self.shift)
        return [m.terms.call(find_power(m.terms, self.name, numbers), [given[0][0]])]


NODES = (PowerOf,)
