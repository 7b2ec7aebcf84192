"""A GRU over the features, one step per sample or over a window."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.config import LONGEST_WINDOW
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, IntArray
from zerodrift.operations.c_text import RuntimePart, StateField, list_ring
from zerodrift.operations.gru.cell import (
    GATES,
    H_LIMIT_Q30,
    IntegerGru,
    check_layer,
    write_gru_step,
    write_relaxed,
)
from zerodrift.operations.gru.layouts import FILTERS
from zerodrift.operations.intervals import Bound, Interval, Shift
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.tables import TANH


@dataclass(frozen=True)
class IntegerGruLayer(IntegerNode):
    """A GRU over the features: one step per sample, or afresh over the last `window` samples.

    The output is the hidden state in Q1.30.
    """

    kind: ClassVar[str] = "gru"
    gru: IntegerGru
    window: int
    """0: the state is carried from sample to sample ("stream")."""

    @property
    def layers(self) -> tuple[IntegerGru, ...]:
        """All layers from the bottom up."""
        return (self.gru,)

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names: those of a stack are numbered after a mark."""
        if len(self.layers) == 1:
            return [self.name]
        return [f"{self.name}{mark}{level}" for level in range(len(self.layers))]

    @property
    def width(self) -> int:
        """Number of hidden units H."""
        return self.gru.hidden

    def rest(self, values: Values) -> State:
        """Return a cold state: h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        return {"h_q30": np.zeros((x.shape[0], self.gru.hidden), dtype=np.int64)}

    def settle(self, values: Values) -> State:
        """Return the state at rest under the present features."""
        if self.window:
            return self.rest(values)
        return {"h_q30": self.gru.settle(values[self.inputs[0]])}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next state and the hidden state in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            h_q30 = self.gru.step(x, state["h_q30"])
            return {"h_q30": h_q30}, h_q30
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        h_q30 = np.zeros((x.shape[0], self.gru.hidden), dtype=np.int64)
        for k in range(self.window):
            h_q30 = self.gru.step(window[:, k], h_q30)
        return {"window": window}, h_q30

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of the recurrent layer.

        A window's features are taken to be any int16, so that the proof does not rest on what is
        stored in it; its position needs 16 bits.
        """
        features = [Interval(INT16_MIN, INT16_MAX)] * self.gru.inputs if self.window else inputs[0]
        bounds = self.gru.prove(self.name, features)
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * self.width, bounds

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in time, or the whole window from h = 0."""
        x, gru = values[self.inputs[0]], self.gru
        if not self.window:
            h_q30 = write_gru_step(w, gru, x, state["h_q30"])
            return {"h_q30": h_q30}, h_q30
        window = move_window(w, self.window, x, state["window"])
        h_q30 = w.scan(
            lambda carried, slices: ([write_gru_step(w, gru, slices[0], carried[0])], []),
            [(w.zeros(x, gru.hidden), ("B", gru.hidden))],
            [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", gru.inputs))],
            [],
        )[0]
        return {"window": window}, h_q30

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": rest_window(w, self.window, x)}
        return {"h_q30": w.zeros(x, self.gru.hidden)}

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the state at rest under the present features."""
        if self.window:
            return self.write_rest(w, values)
        return {"h_q30": write_relaxed(w, self.gru, values[self.inputs[0]])}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        if self.window:
            return list_ring(self.name, "window", 16, (self.window, self.layers[0].inputs))
        return (StateField(32, f"{self.name}_h_q30", (self.width,)),)

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The table of tanh."""
        return (TANH,)

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


def move_window(w: Writer, length: int, x: str, window: str) -> str:
    """Write a window [B, N, I] with x [B, I] appended and the oldest left out."""
    newest = w.op("Unsqueeze", x, w.constant([1]))
    if length == 1:
        return newest
    newer = w.op("Slice", window, w.constant([1]), w.constant([length]), w.constant([1]))
    return w.op("Concat", newer, newest, axis=1)


def rest_window(w: Writer, length: int, x: str) -> str:
    """Write a window [B, N, I] filled with x [B, I]."""
    newest = w.op("Unsqueeze", x, w.constant([1]))
    return w.op("Tile", newest, w.constant([1, length, 1]))


NODES = (IntegerGruLayer,)
__all__ = ["FILTERS", "NODES", "IntegerGruLayer"]
