"""The answer (4.7): it is the last node, and reads signals and the network's head."""

from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Row, Table, Values
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class Drift(Node):
    """saturate((bias_k + sum_j A_kj s_j + B_k head_k) >> shift_k, low_k, high_k)."""

    kind: ClassVar[str] = "drift"
    coefficients: Table
    head_coefficients: Row
    bias: Row
    shift: Row
    low: Row
    high: Row
    head: bool
    """Whether the last input is the network's head."""

    def answer(self, m: Meaning, values: Values) -> tuple[list[Whole], Whole]:
        """Return the drift of each output, and whether one of them is limited."""
        terms = m.terms
        names = self.inputs[:-1] if self.head else self.inputs
        signals = [values[name][0] for name in names]
        drift, clamped = [], []
        for k, row in enumerate(self.coefficients):
            total = m.dot(self.bias[k], row, signals)
            if self.head:
                below = values[self.inputs[-1]][k]
                total = terms.add(total, terms.scale(below, self.head_coefficients[k]))
            wide = terms.shift(total, self.shift[k])
            limited = m.saturate(wide, self.low[k], self.high[k])
            clamped.append(terms.negate(terms.equal(limited, wide)))
            drift.append(limited)
        return drift, terms.either(clamped)


NODES = (Drift,)
