"""A raw code, limited and counted from an origin (3.1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Meaning, Moment, Node, State
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Input(Node):
    """(saturate(code, low, high) - origin) 2^shift."""

    kind: ClassVar[str] = "input"
    channel: int
    low: int
    high: int
    shift: int
    origin: int = 0

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the limits' own range."""
        return Ends(self.low - self.origin, self.high - self.origin).scale(1 << self.shift)

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Read the code."""
        code = m.saturate(at.codes[self.channel], self.low, self.high)
        return {}, [m.terms.scale(m.terms.subtract(code, m.number(self.origin)), 1 << self.shift)]


NODES = (Input,)
