"""Dense layers (integer-layers.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Row, Table
from zerodrift_proof.equality.terms import UndecidedError, Whole


@dataclass(frozen=True)
class Dense(Node):
    """An activation of (bias_i + sum_j weight_ij x_j) >> shift_i, of the copies of a layer."""

    kind: ClassVar[str] = "dense"
    weights: Table
    bias: Row
    shift: Row
    activation: str
    low: Row
    high: Row

    def _copy(self, m: Meaning, below: list[Whole]) -> list[Whole]:
        return [m.round_shift(one, 15) for one in below]

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the layer's states."""
        copies = self._copy(m, given[0])
        out = []
        for i, (bias, row, by) in enumerate(zip(self.bias, self.weights, self.shift, strict=True)):
            scaled = m.terms.shift(m.dot(bias, row, copies), by)
            if self.activation == "tanh":
                out.append(m.tanh(scaled))
            elif self.activation == "clip":
                limited = m.saturate(scaled, self.low[i], self.high[i])
                out.append(m.terms.scale(limited, 1 << 15))
            else:
                raise UndecidedError(f"the activation '{self.activation}' has no rule")
        return out


@dataclass(frozen=True)
class FeatureDense(Dense):
    """The same of the features, which have 16 bits already."""

    kind: ClassVar[str] = "feature_dense"

    def _copy(self, m: Meaning, below: list[Whole]) -> list[Whole]:
        return below


NODES = (Dense, FeatureDense)
