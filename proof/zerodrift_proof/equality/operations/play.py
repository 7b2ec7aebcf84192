"""Play (3.13)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Play(Node):
    """y' = saturate(y, x - half_width, x + half_width)."""

    kind: ClassVar[str] = "play"
    half_width: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, in which y stays by induction (section 6)."""
        return given[0]

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return y."""
        return [Field(f"{self.name}_y", "int32_t", (), *given[0])]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at x."""
        return {f"{self.name}_y": values[self.inputs[0]]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Move y no further than it is pushed."""
        x, half = at.values[self.inputs[0]][0], m.number(self.half_width)
        low, high = m.terms.subtract(x, half), m.terms.add(x, half)
        y = m.terms.clamp(at.state[f"{self.name}_y"][0], low, high)
        return {f"{self.name}_y": [y]}, [y]


NODES = (Play,)
