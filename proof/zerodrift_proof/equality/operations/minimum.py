"""The smaller of a and b (3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Minimum(Node):
    """The smaller of a and b, of equal scale and offset."""

    kind: ClassVar[str] = "minimum"

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the smaller of each two ends."""
        return Ends(*map(min, *given))

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return it."""
        return [m.terms.minimum(given[0][0], given[1][0])]


NODES = (Minimum,)
