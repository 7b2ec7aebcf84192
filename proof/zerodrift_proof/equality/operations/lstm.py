"""LSTMs, one or several on top of each other (integer-layers.md)."""

from dataclasses import dataclass
from itertools import chain
from typing import ClassVar

from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30, Numbered
from zerodrift_proof.equality.node import Field, State
from zerodrift_proof.equality.recurrent import (
    LayerNumbers,
    Recurrent,
    Several,
    lay_out,
    name_layers,
)
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class LstmNumbers(LayerNumbers):
    """An LSTM's layer."""

    cell_bits: int
    """Fractional bits of the cell state."""


@dataclass(frozen=True)
class Lstm(Recurrent):
    """LSTMs over the features, the lowest first."""

    kind: ClassVar[str] = "lstm"
    layers: tuple[LstmNumbers, ...]

    def _lay_out(self) -> list[Numbered]:
        names = name_layers(self.name, len(self.layers))
        pairs = zip(names, self.layers, strict=True)
        return [lay_out(name, "lstm", one, one.cell_bits) for name, one in pairs]

    def _list_states(self) -> list[Field]:
        """Return cells and outputs of all layers, in the order of their names."""
        units = (sum(layer.hidden for layer in self.numbered),)
        return [
            Field(f"{self.name}_cell", "int32_t", units, -CELL_LIMIT, CELL_LIMIT),
            Field(f"{self.name}_h_q30", "int32_t", units, -H_LIMIT_Q30, H_LIMIT_Q30),
        ]

    def _split(self, state: State) -> tuple[list[Whole], list[Whole]]:
        return state[f"{self.name}_h_q30"], state[f"{self.name}_cell"]

    def _join(self, h: Several, c: Several) -> State:
        return {f"{self.name}_h_q30": [*chain(*h)], f"{self.name}_cell": [*chain(*c)]}


NODES = (Lstm,)
