"""A layer normalisation (integer-layers.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Meaning, Node, Row
from zerodrift_proof.equality.rules import Normalisation, say_norm
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class LayerNorm(Node):
    """gain (x - mean) / sqrt(variance + epsilon) + bias, of the copies of a layer."""

    kind: ClassVar[str] = "layer_norm"
    align: Row
    gain: Row
    shift: Row
    bias: Row
    epsilon: int

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the normalised numbers."""
        norm = Normalisation(self.align, self.gain, self.shift, self.bias, self.epsilon)
        return say_norm(m.terms, norm, [m.round_shift(one, 15) for one in given[0]])


NODES = (LayerNorm,)
