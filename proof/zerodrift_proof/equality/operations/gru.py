"""GRUs, one or several on top of each other (section 4, and integer-layers.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import ClassVar

from zerodrift_proof.equality.kernels import H_LIMIT_Q30, Numbered
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
class GruNumbers(LayerNumbers):
    """A GRU's layer."""

    reset: str
    """after | before the product with the recurrent weights."""


@dataclass(frozen=True)
class Gru(Recurrent):
    """A GRU over the features."""

    kind: ClassVar[str] = "gru"
    gru: GruNumbers

    def _list_numbers(self) -> Sequence[GruNumbers]:
        return [self.gru]

    def _lay_out(self) -> list[Numbered]:
        given = self._list_numbers()
        return [
            lay_out(name, "gru" if one.reset == "after" else "gru before", one)
            for name, one in zip(name_layers(self.name, len(given)), given, strict=True)
        ]

    def _list_states(self) -> list[Field]:
        """Return the topmost state, then those of all layers below it."""
        *lower, top = (layer.hidden for layer in self.numbered)
        limits = -H_LIMIT_Q30, H_LIMIT_Q30
        fields = [Field(f"{self.name}_h_q30", "int32_t", (top,), *limits)]
        if lower:
            fields.append(Field(f"{self.name}_lower_q30", "int32_t", (sum(lower),), *limits))
        return fields

    def _split(self, state: State) -> tuple[list[Whole], list[Whole]]:
        name = self.name
        return [*state.get(f"{name}_lower_q30", []), *state[f"{name}_h_q30"]], []

    def _join(self, h: Several, c: Several) -> State:
        lower = [*chain(*h[:-1])]
        own = {f"{self.name}_lower_q30": lower} if lower else {}
        return {f"{self.name}_h_q30": h[-1], **own}


@dataclass(frozen=True)
class GruStack(Gru):
    """GRUs on top of each other; `gru` is the topmost."""

    kind: ClassVar[str] = "gru_stack"
    lower: tuple[GruNumbers, ...]

    def _list_numbers(self) -> Sequence[GruNumbers]:
        return [*self.lower, self.gru]


NODES = (Gru, GruStack)
