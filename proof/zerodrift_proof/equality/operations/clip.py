"""A signal within limits (3.12)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Node
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Clip(Node):
    """saturate(x, low, high)."""

    kind: ClassVar[str] = "clip"
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, limited."""
        return given[0].saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return x limited."""
        return [m.saturate(given[0][0], self.low, self.high)]


NODES = (Clip,)
