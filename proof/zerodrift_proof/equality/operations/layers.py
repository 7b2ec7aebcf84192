"""A network's layers, from its inputs to its linear output."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import ClassVar

from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30, Numbered
from zerodrift_proof.equality.node import Field, Meaning, Node, Row, State, Table
from zerodrift_proof.equality.recurrent import (
    LayerNumbers,
    Recurrent,
    Several,
    lay_out,
    name_layers,
)
from zerodrift_proof.equality.rules import Normalisation, say_norm
from zerodrift_proof.equality.terms import UndecidedError, Whole

# The network's inputs (3.14).


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


# Dense layers (integer-layers.md).


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


# Features and copies of layers side by side (integer-layers.md).


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


# A layer normalisation (integer-layers.md).


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


# GRUs, one or several on top of each other (section 4, and integer-layers.md).


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


# LSTMs, one or several on top of each other (integer-layers.md).


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


# The network's linear output (4.6).


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


NODES = (
    Features,
    Dense,
    FeatureDense,
    Join,
    LayerNorm,
    Gru,
    GruStack,
    Lstm,
    Head,
    JoinHead,
)
