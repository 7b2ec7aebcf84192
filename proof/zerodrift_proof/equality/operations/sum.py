"""A sum of signals of any scales (3.5)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node, Row, bound_dot
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Sum(Node):
    """saturate((bias + sum_j c_j x_j) >> shift, low, high)."""

    kind: ClassVar[str] = "sum"
    coefficients: Row
    bias: int
    shift: int
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of the sum, limited."""
        total = bound_dot(self.bias, self.coefficients, given)
        return total.shift(self.shift).saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the sum."""
        total = m.dot(self.bias, self.coefficients, [x[0] for x in given])
        return [m.saturate(m.terms.shift(total, self.shift), self.low, self.high)]


NODES = (Sum,)
