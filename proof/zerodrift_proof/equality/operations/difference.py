"""a - b (3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Difference(Node):
    """a - b, of signals of equal scale."""

    kind: ClassVar[str] = "difference"

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of a difference of any two."""
        return given[0].minus(given[1])

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return it."""
        return [m.terms.subtract(given[0][0], given[1][0])]


NODES = (Difference,)
