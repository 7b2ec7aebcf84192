"""The network's inputs (3.14)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Row, Table
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Features(Node):
    """saturate((bias_i + sum_j matrix_ij s_j) >> shift_i, -32768, 32767)."""

    kind: ClassVar[str] = "features"
    matrix: Table
    bias: Row
    shift: Row

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the features."""
        signals = [one[0] for one in given]
        out = []
        for bias, row, by in zip(self.bias, self.matrix, self.shift, strict=True):
            shifted = m.terms.shift(m.dot(bias, row, signals), by)
            out.append(m.saturate(shifted, -(2**15), 2**15 - 1))
        return out


NODES = (Features,)
