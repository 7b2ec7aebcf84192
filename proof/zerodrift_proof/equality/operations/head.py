"""The network's linear output (4.6)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Table
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Head(Node):
    """sum_j weight_kj copy_j, of the copies of the layer below."""

    kind: ClassVar[str] = "head"
    weights: Table

    def _copy(self, m: Meaning, below: list[Whole]) -> list[Whole]:
        return [m.round_shift(one, 15) for one in below]

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the sums."""
        copies = self._copy(m, given[0])
        return [m.dot(0, row, copies) for row in self.weights]


@dataclass(frozen=True)
class JoinHead(Head):
    """The same of a join, which holds copies already."""

    kind: ClassVar[str] = "join_head"

    def _copy(self, m: Meaning, below: list[Whole]) -> list[Whole]:
        return below


NODES = (Head, JoinHead)
