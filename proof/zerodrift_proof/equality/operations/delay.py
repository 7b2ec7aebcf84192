"""A delay by a ring of samples (3.11)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Delay(Node):
    """older + round_shift((newer - older) newer_q31, 31)."""

    kind: ClassVar[str] = "delay"
    steps: int
    newer_q31: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range: the result lies between two of them."""
        return given[0]

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the ring and the place of its oldest sample."""
        return [
            Field(f"{self.name}_line", "int32_t", (self.steps,), *given[0]),
            Field(f"{self.name}_oldest", "uint16_t", (), 0, self.steps - 1),
        ]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Fill the ring with x."""
        x = values[self.inputs[0]][0]
        return {f"{self.name}_line": [x] * self.steps, f"{self.name}_oldest": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """The oldest place takes the present input; the next one is the oldest then."""
        terms, name, x = m.terms, self.name, at.values[self.inputs[0]][0]
        line, place = at.state[f"{name}_line"], at.state[f"{name}_oldest"][0]
        cells = dict(enumerate(line))
        turn = terms.equal(place, m.number(self.steps - 1))
        after = terms.choose(turn, m.number(0), terms.add(place, m.number(1)))
        older = terms.select(place, cells)
        out = older
        if self.newer_q31:
            newer = x if self.steps == 1 else m.select(cells, after)
            rise = terms.scale(terms.subtract(newer, older), self.newer_q31)
            out = terms.add(older, m.round_shift(rise, 31))
        stored = [
            terms.choose(terms.equal(place, m.number(k)), x, cell) for k, cell in enumerate(line)
        ]
        return {f"{name}_line": stored, f"{name}_oldest": [after]}, [out]


NODES = (Delay,)
