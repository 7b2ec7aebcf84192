"""A product of two signals (3.6)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Product(Node):
    """saturate(round_shift(a b, shift), low, high)."""

    kind: ClassVar[str] = "product"
    shift: int
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of a product of any two, limited."""
        return given[0].times(given[1]).round_shift(self.shift).saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the product."""
        rounded = m.round_shift(m.terms.multiply(given[0][0], given[1][0]), self.shift)
        return [m.saturate(rounded, self.low, self.high)]


NODES = (Product,)
