"""A GRU over the features, one step per sample or over a window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.config import LONGEST_WINDOW
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.c_text import RuntimePart, StateField, list_ring
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.gru.cell import (
    GATES,
    H_LIMIT_Q30,
    IntegerGru,
    check_layer,
    write_gru_step,
    write_relaxed,
)
from zerodrift.operations.gru.error import bound_states
from zerodrift.operations.gru.layouts import FILTERS
from zerodrift.operations.intervals import Bound, Interval, Shift
from zerodrift.operations.node import Names, OnnxStep, State, Values, Writer
from zerodrift.operations.recurrent import IntegerRecurrent, number_layers, prove_layers
from zerodrift.operations.signals import Real
from zerodrift.operations.tables import CURVES


@dataclass(frozen=True)
class IntegerGruLayer(IntegerRecurrent):
    """A GRU over the features: one step per sample, or afresh over the last `window` samples.

    The output is the hidden state in Q1.30.
    """

    kind: ClassVar[str] = "gru"
    gru: IntegerGru
    window: int
    """0: the state is carried from sample to sample ("stream")."""

    @property
    def streams(self) -> bool:
        """Whether the state is carried from sample to sample."""
        return not self.window

    @property
    def layers(self) -> tuple[IntegerGru, ...]:
        """All layers from the bottom up."""
        return (self.gru,)

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names: those of a stack are numbered after a mark."""
        return number_layers(self.name, len(self.layers), mark)

    @property
    def width(self) -> int:
        """Number of hidden units H."""
        return self.gru.hidden

    def rest(self, values: Values) -> State:
        """Return cold states: all h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        return self._join(self._zeros(x))

    def settle(self, values: Values) -> State:
        """Return the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.rest(values)
        states: list[IntArray] = []
        for layer in self.layers:
            x = round_shift(states[-1], COPY_BITS) if states else values[self.inputs[0]]
            states.append(layer.settle(x))
        return self._join(states)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next states and the topmost one in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._step_all(x, self._split(state))
            return self._join(states), states[-1]
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        states = self._zeros(x)
        for k in range(self.window):
            states = self._step_all(window[:, k], states)
        return {"window": window}, states[-1]

    def _step_all(self, x: IntArray, states: list[IntArray]) -> list[IntArray]:
        after: list[IntArray] = []
        for layer, h_q30 in zip(self.layers, states, strict=True):
            after.append(layer.step(round_shift(after[-1], COPY_BITS) if after else x, h_q30))
        return after

    def _zeros(self, x: IntArray) -> list[IntArray]:
        return [np.zeros((x.shape[0], layer.hidden), dtype=np.int64) for layer in self.layers]

    def _split(self, state: State) -> list[IntArray]:
        """Return the layers' states from the bottom up."""
        return [state["h_q30"]]

    def _join(self, states: list[IntArray]) -> State:
        """Return the state that `_split` takes apart."""
        return {"h_q30": states[-1]}

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a window's position needs 16 bits."""
        names = self.name_layers(".")
        bounds = prove_layers(names, self.layers, inputs[0], bool(self.window))
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * self.width, bounds

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write all h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            newest = w.op("Unsqueeze", x, w.constant([1]))
            return {"window": w.op("Tile", newest, w.constant([1, self.window, 1]))}
        return self._write_joined(w, [w.zeros(x, layer.hidden) for layer in self.layers])

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.write_rest(w, values)
        states: list[str] = []
        for layer in self.layers:
            x = w.round_shift(states[-1], COPY_BITS) if states else values[self.inputs[0]]
            states.append(write_relaxed(w, layer, x))
        return self._write_joined(w, states)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in time of all layers, or the whole window from h = 0."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._write_all(w, x, self._write_split(w, state))
            return self._write_joined(w, states), states[-1]
        window = w.op("Unsqueeze", x, w.constant([1]))
        if self.window > 1:
            ends = (w.constant([end]) for end in (1, self.window, 1))
            window = w.op("Concat", w.op("Slice", state["window"], *ends), window, axis=1)
        widths = [layer.hidden for layer in self.layers]
        states = w.scan(
            lambda carried, slices: (self._write_all(w, slices[0], carried), []),
            [(w.zeros(x, width), ("B", width)) for width in widths],
            [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", self.layers[0].inputs))],
            [],
        )
        return {"window": window}, states[-1]

    def _write_all(self, w: Writer, x: str, states: Sequence[str]) -> list[str]:
        after: list[str] = []
        for layer, h_q30 in zip(self.layers, states, strict=True):
            below = w.round_shift(after[-1], COPY_BITS) if after else x
            after.append(write_gru_step(w, layer, below, h_q30))
        return after

    def _write_split(self, w: Writer, state: Names) -> list[str]:
        return [state["h_q30"]]

    def _write_joined(self, w: Writer, states: Sequence[str]) -> dict[str, str]:
        return {"h_q30": states[-1]}

    def bound_states(self, rows: Sequence[Real], inputs: Sequence[Known]) -> list[Error]:
        """Return the error of every unit of the topmost layer where it forgets; see `error`.

        It reads `inputs`: the features, or the int16 copies of the layer below.
        """
        if any(row.operation != f"gru_{self.gru.reset}" for row in rows):
            return super().bound_states(rows, inputs)
        return bound_states(self.gru, [row.numbers for row in rows], inputs)

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        if self.window:
            return list_ring(self.name, "window", 16, (self.window, self.layers[0].inputs))
        return (StateField(32, f"{self.name}_h_q30", (self.width,)),)

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The table of tanh, and that of the sigmoid."""
        return (CURVES,)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        shifts = []
        for name, gru in zip(self.name_layers("."), self.layers, strict=True):
            for gate, by, scaled_by in zip(GATES, gru.shift, gru.multiplier_shift, strict=True):
                shifts.append(Shift(f"{name}.{gate}.shift", by, 31))
                if gru.multiplier is not None:
                    shifts.append(Shift(f"{name}.{gate}.multiplier_shift", scaled_by, 62))
        return shifts

    def check_form(self) -> None:
        """Raise ValueError where the window is too long, or a layer's arrays do not fit."""
        if not 0 <= self.window <= LONGEST_WINDOW:
            raise ValueError(
                f"node '{self.name}' has a window of {self.window}, not 0 to {LONGEST_WINDOW}"
            )
        for layer in self.layers:
            check_layer(self.name, layer)


NODES = (IntegerGruLayer,)
__all__ = ["FILTERS", "NODES", "IntegerGruLayer"]
