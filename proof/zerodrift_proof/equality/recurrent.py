"""What GRUs and LSTMs share: layers numbered unit by unit, states that stream, and windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from zerodrift_proof.equality.kernels import RELAX_STEPS, Numbered
from zerodrift_proof.equality.node import (
    Cube,
    Ends,
    Field,
    Meaning,
    Moment,
    Node,
    Row,
    State,
    Table,
    Values,
)
from zerodrift_proof.equality.terms import UndecidedError, Whole

Several = list[list[Whole]]
"""Numbers of each layer, from the bottom up."""


@dataclass(frozen=True)
class LayerNumbers:
    """A layer as the file has it, gate by gate: of a GRU r, u, n, of an LSTM i, f, g, o."""

    w_x: Cube
    """[gates, units, inputs]."""
    w_h: Cube
    """[gates, units, units]."""
    bias: Table
    """[4, units]; of a GRU that of n outside and inside the reset product."""
    shift: Row
    """[gates] from an accumulator to the table of tanh."""
    multiplier: Table | None
    """[gates, units], of recurrent weights of 8 bits."""
    multiplier_shift: Row
    """[gates]."""


def name_layers(name: str, count: int) -> list[str]:
    """Return what the C calls the layers of a node: several are numbered from the bottom up."""
    return [name] if count == 1 else [f"{name}_{level}" for level in range(count)]


def lay_out(name: str, kind: str, given: LayerNumbers, cell_bits: int = 0) -> Numbered:
    """Return a layer unit by unit, the gates of each side by side.

    Raises:
        ValueError: its numbers are not those of one layer.
    """
    units, gates = len(given.w_h[0]), 4 if kind == "lstm" else 3
    each = range(units)
    multiplier = given.multiplier or ()
    inputs = len(given.w_x[0][0])
    shapes = [
        [len(rows) for rows in (given.w_x, given.w_h, given.shift, given.multiplier_shift)],
        [len(rows) for cube in (given.w_x, given.w_h) for rows in cube],
        [len(row) for rows in given.w_h for row in rows],
        [len(row) for row in (*given.bias, *multiplier)],
    ]
    if len(given.bias) != 4 or len(multiplier) not in (0, gates) or shapes != [
        [gates] * 4, [units] * 2 * gates, [units] * units * gates, [units] * (4 + len(multiplier))
    ]:  # fmt: skip
        raise ValueError(f"{name}: its numbers are not those of {units} units of {gates} gates")
    return Numbered(
        name,
        kind,
        inputs,
        units,
        tuple(given.w_x[g][j] for j in each for g in range(gates)),
        tuple(given.w_h[g][j] for j in each for g in range(gates)),
        tuple(given.bias[g][j] for j in each for g in range(4)),
        given.shift,
        tuple(multiplier[g][j] for j in each for g in range(gates)) if multiplier else (),
        given.multiplier_shift,
        cell_bits,
    )


@dataclass(frozen=True)
class Recurrent(Node):
    """One or several recurrent layers: a step per sample, or afresh over a window."""

    window: int

    def _lay_out(self) -> list[Numbered]:
        raise NotImplementedError

    def _list_states(self) -> list[Field]:
        """Return the fields of the states that stream."""
        raise NotImplementedError

    def _split(self, state: State) -> tuple[list[Whole], list[Whole]]:
        """Return states and cells of all layers in a row, from the bottom up."""
        raise NotImplementedError

    def _join(self, h: Several, c: Several) -> State:
        """Return the fields that `_split` reads."""
        raise NotImplementedError

    @cached_property
    def numbered(self) -> list[Numbered]:
        """The layers, from the bottom up."""
        return self._lay_out()

    @property
    def streams(self) -> bool:
        """Whether the states are carried from sample to sample."""
        return not self.window

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the states, or the window of features and the place of its oldest."""
        if not self.window:
            return self._list_states()
        inputs = self.numbered[0].inputs
        return [
            Field(f"{self.name}_window", "int16_t", (self.window, inputs)),
            Field(f"{self.name}_oldest", "uint16_t", (), 0, self.window - 1),
        ]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Fill the window; or begin at 0, and if settled relax layer by layer."""
        x = values[self.inputs[0]]
        if self.window:
            name = self.name
            return {f"{name}_window": x * self.window, f"{name}_oldest": [m.number(0)]}
        h_all, c_all = self._begin(m)
        for k, layer in enumerate(self.numbered):
            for _ in range(RELAX_STEPS if settled else 0):
                h_all[k], c_all[k] = m.layers.step(layer.name, x, h_all[k], c_all[k], relaxing=True)
            x = [m.round_shift(one, 15) for one in h_all[k]]
        return self._join(h_all, c_all)

    def _begin(self, m: Meaning) -> tuple[Several, Several]:
        zeros = [[m.number(0)] * layer.hidden for layer in self.numbered]
        cells = [
            list(h) if layer.kind == "lstm" else []
            for h, layer in zip(zeros, self.numbered, strict=True)
        ]
        return zeros, cells

    def give_at_rest(self, m: Meaning, at: Moment) -> list[Whole]:
        """Return the topmost state as it stands, where it is carried."""
        if not self.window:
            return at.state[f"{self.name}_h_q30"][-self.numbered[-1].hidden :]
        return super().give_at_rest(m, at)

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Step every layer once; or all over the window, whose oldest features are replaced."""
        name, x = self.name, at.values[self.inputs[0]]
        if not self.window:
            h, c = self._split(at.state)
            h_all, c_all = self._step_all(m, x, self._cut(h), self._cut(c))
            return self._join(h_all, c_all), h_all[-1]
        place = at.state[f"{name}_oldest"][0].exact
        if place is None:
            raise UndecidedError("a window of which the oldest place is not known")
        inputs, window = self.numbered[0].inputs, list(at.state[f"{name}_window"])
        window[place * inputs : (place + 1) * inputs] = x
        oldest = 0 if place == self.window - 1 else place + 1
        h_all, c_all = self._begin(m)
        for k in range(self.window):
            row = (oldest + k) % self.window
            given = window[row * inputs : (row + 1) * inputs]
            h_all, c_all = self._step_all(m, given, h_all, c_all)
        return {f"{name}_window": window, f"{name}_oldest": [m.number(oldest)]}, h_all[-1]

    def _cut(self, row: list[Whole]) -> Several:
        parts, at = [], 0
        for layer in self.numbered:
            parts.append(row[at : at + layer.hidden])
            at += layer.hidden
        return parts

    def _step_all(
        self, m: Meaning, x: list[Whole], h_all: Several, c_all: Several
    ) -> tuple[Several, Several]:
        after: tuple[Several, Several] = ([], [])
        for layer, h, c in zip(self.numbered, h_all, c_all, strict=True):
            h_next, c_next = m.layers.step(layer.name, x, h, c, relaxing=False)
            after[0].append(h_next)
            after[1].append(c_next)
            x = [m.round_shift(one, 15) for one in h_next]
        return after
