"""A measured output, less its drift in the step before (3.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import DRIFT, Ends, Meaning, Moment, Node, State
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Load(Node):
    """saturate(code - drift, low, high) 2^shift."""

    kind: ClassVar[str] = "load"
    reads_drift: ClassVar[bool] = True
    channel: int
    low: int
    high: int
    shift: int
    output: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the limits' own range."""
        return Ends(self.low, self.high).scale(1 << self.shift)

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Read code and drift."""
        load = m.terms.subtract(at.codes[self.channel], at.state[DRIFT][self.output])
        return {}, [m.terms.scale(m.saturate(load, self.low, self.high), 1 << self.shift)]


NODES = (Load,)
