"""Steps since the start (3.3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Counter(Node):
    """0 at the first step, one more at each, up to a limit."""

    kind: ClassVar[str] = "counter"
    limit: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the limit."""
        return Ends(0, self.limit)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the count."""
        return [Field(f"{self.name}_count", "int32_t", (), 0, self.limit)]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at 0."""
        return {f"{self.name}_count": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Give the count, and count on."""
        count = at.state[f"{self.name}_count"][0]
        more = m.terms.less(count, m.number(self.limit))
        return {f"{self.name}_count": [m.terms.add(count, more)]}, [count]


NODES = (Counter,)
