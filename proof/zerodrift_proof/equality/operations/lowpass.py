"""A low-pass of first order (3.10)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Lowpass(Node):
    """y = v + c x, v' = v + a (x - y)."""

    kind: ClassVar[str] = "lowpass"
    c_q24: int
    m_q31: int
    shift: int

    def _bound_state(self, x: Ends) -> Ends:
        """Return (1 - c) x and what rounding adds, 2^21 + 1/a counts, by induction (section 6)."""
        margin = 2**21 - (-(1 << (self.shift + 22)) // self.m_q31)
        return x.scale(2**24 - self.c_q24).plus(Ends(-margin, margin))

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x and the same margin, rounded."""
        margin = 2**21 - (-(1 << (self.shift + 22)) // self.m_q31)
        return given[0].scale(2**24).plus(Ends(-margin, margin)).round_shift(24)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return v."""
        return [Field(f"{self.name}_v", "int64_t", (), *self._bound_state(given[0]))]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin where y = x."""
        x = values[self.inputs[0]][0]
        return {f"{self.name}_v": [m.terms.scale(x, 2**24 - self.c_q24)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Move v on."""
        terms, x, v = m.terms, at.values[self.inputs[0]][0], at.state[f"{self.name}_v"][0]
        y = terms.add(v, terms.scale(x, self.c_q24))
        gap = m.round_shift(terms.subtract(terms.scale(x, 1 << 24), y), 22)
        moved = m.round_shift(terms.scale(gap, self.m_q31), self.shift)
        return {f"{self.name}_v": [terms.add(v, moved)]}, [m.round_shift(y, 24)]


NODES = (Lowpass,)
