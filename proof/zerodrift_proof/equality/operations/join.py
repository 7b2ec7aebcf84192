"""Features and copies of layers side by side (integer-layers.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Row
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Join(Node):
    """round_shift(x, shift) of each input, one behind the other."""

    kind: ClassVar[str] = "join"
    shift: Row
    widths: Row

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return all numbers."""
        pairs = zip(given, self.shift, strict=True)
        return [m.round_shift(one, by) for part, by in pairs for one in part]


NODES = (Join,)
