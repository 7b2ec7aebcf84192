"""x - offset (3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Offset(Node):
    """x - offset."""

    kind: ClassVar[str] = "offset"
    offset: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, moved."""
        return given[0].minus(Ends(self.offset, self.offset))

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the difference."""
        return [m.terms.subtract(given[0][0], m.number(self.offset))]


NODES = (Offset,)
