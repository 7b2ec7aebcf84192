"""Time since the start (3.16)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.rules import say_time
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Elapsed(Node):
    """time' = min(time + S, limit 2^bits), of which round_shift(time', bits) is given."""

    kind: ClassVar[str] = "elapsed"
    limit: int
    bits: int
    period_us: int
    """Of the logs; nothing in the chip depends on it."""

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the limit."""
        return Ends(0, self.limit)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the time."""
        return [Field(f"{self.name}_time", "int64_t", (), 0, self.limit << self.bits)]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at 0."""
        return {f"{self.name}_time": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Add the step's time."""
        before = at.state[f"{self.name}_time"][0]
        time, ticks = say_time(m.terms, before, m.span, self.limit, self.bits)
        return {f"{self.name}_time": [time]}, [ticks]


NODES = (Elapsed,)
