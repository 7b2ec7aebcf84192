"""A power of two (3.8)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.kernels import find_exp2
from zerodrift_proof.equality.node import Ends, Meaning, Node, bound_dot
from zerodrift_proof.equality.terms import Terms, Whole


@dataclass(frozen=True)
class Exp2(Node):
    """2^t of t = saturate((bias + c x) >> shift, low, high), largest in the octave `top`."""

    kind: ClassVar[str] = "exp2"
    coefficient: int
    bias: int
    shift: int
    low: int
    high: int
    top: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the results at the ends of t, in which it rises."""
        total = bound_dot(self.bias, [self.coefficient], given)
        t = total.shift(self.shift).saturate(self.low, self.high)
        terms = Terms()
        rule = find_exp2(terms, self.top)
        found = [terms.call(rule, [terms.constant(end)]).low for end in t]
        return Ends(found[0], found[1])

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the power."""
        total = m.dot(self.bias, [self.coefficient], [given[0][0]])
        t = m.saturate(m.terms.shift(total, self.shift), self.low, self.high)
        return [m.terms.call(find_exp2(m.terms, self.top), [t])]


NODES = (Exp2,)
