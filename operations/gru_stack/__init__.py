"""GRUs on top of each other, each on the state of the one below."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, IntArray, round_shift
from zerodrift.operations.c_text import StateField
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.gru import IntegerGruLayer, move_window, rest_window
from zerodrift.operations.gru.cell import H_LIMIT_Q30, IntegerGru, write_gru_step, write_relaxed
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import Names, OnnxStep, State, Values, Writer


@dataclass(frozen=True)
class IntegerGruStack(IntegerGruLayer):
    """GRUs on top of each other: each reads the state of the one below after its step.

    `gru` is the topmost; its state is the output.
    """

    kind: ClassVar[str] = "gru_stack"
    lower: tuple[IntegerGru, ...]
    """The layers below, the one that reads the features first."""

    @property
    def layers(self) -> tuple[IntegerGru, ...]:
        """All layers from the bottom up."""
        return (*self.lower, self.gru)

    def _split(self, lower_q30: IntArray, h_q30: IntArray) -> list[IntArray]:
        ends = np.cumsum([layer.hidden for layer in self.lower])
        return [*np.split(lower_q30, ends[:-1], axis=1), h_q30]

    def _step_all(self, x: IntArray, states: list[IntArray]) -> list[IntArray]:
        after = []
        for layer, h_q30 in zip(self.layers, states, strict=True):
            after.append(layer.step(x, h_q30))
            x = round_shift(after[-1], COPY_BITS)
        return after

    def _zeros(self, batch: int) -> list[IntArray]:
        return [np.zeros((batch, layer.hidden), dtype=np.int64) for layer in self.layers]

    def rest(self, values: Values) -> State:
        """Return cold states: all h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        *lower, top = self._zeros(x.shape[0])
        return {"h_q30": top, "lower_q30": np.concatenate(lower, axis=1)}

    def settle(self, values: Values) -> State:
        """Return the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.rest(values)
        x, states = values[self.inputs[0]], []
        for layer in self.layers:
            states.append(layer.settle(x))
            x = round_shift(states[-1], COPY_BITS)
        return {"h_q30": states[-1], "lower_q30": np.concatenate(states[:-1], axis=1)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next states and the topmost one in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._step_all(x, self._split(state["lower_q30"], state["h_q30"]))
            lower = np.concatenate(states[:-1], axis=1)
            return {"h_q30": states[-1], "lower_q30": lower}, states[-1]
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        states = self._zeros(x.shape[0])
        for k in range(self.window):
            states = self._step_all(window[:, k], states)
        return {"window": window}, states[-1]

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a state's int16 copy is at most 32767."""
        if not self.lower:
            raise CheckError(f"{self.name}: one layer is no stack. The model is refused.")
        below: list[Interval] = inputs[0]
        if self.window:
            below = [Interval(INT16_MIN, INT16_MAX)] * self.lower[0].inputs
        bounds: list[Bound] = []
        for level, layer in enumerate(self.layers):
            if layer.inputs != len(below):
                raise CheckError(
                    f"{self.name}: layer {level} reads {layer.inputs} values, and gets"
                    f" {len(below)}. The model is refused."
                )
            bounds += layer.prove(f"{self.name}.{level}", below)
            below = [Interval(-INT16_MAX, INT16_MAX)] * layer.hidden
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        limit = Interval(-H_LIMIT_Q30, H_LIMIT_Q30)
        return [limit] * self.width, bounds

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in time of all layers, or the whole window from h = 0."""
        x = values[self.inputs[0]]
        if not self.window:
            lower = w.split(state["lower_q30"], [layer.hidden for layer in self.lower])
            states = write_stack_step(w, self.layers, x, [*lower, state["h_q30"]])
            return _join_lower(w, states), states[-1]
        window = move_window(w, self.window, x, state["window"])
        widths = [layer.hidden for layer in self.layers]
        states = w.scan(
            lambda carried, slices: (write_stack_step(w, self.layers, slices[0], carried), []),
            [(w.zeros(x, width), ("B", width)) for width in widths],
            [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", self.lower[0].inputs))],
            [],
        )
        return {"window": window}, states[-1]

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write all h = 0, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": rest_window(w, self.window, x)}
        return _join_lower(w, [w.zeros(x, layer.hidden) for layer in self.layers])

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.write_rest(w, values)
        x, states = values[self.inputs[0]], []
        for layer in self.layers:
            states.append(write_relaxed(w, layer, x))
            x = w.round_shift(states[-1], COPY_BITS)
        return _join_lower(w, states)

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        if self.window:
            return super().list_state()
        hidden = sum(layer.hidden for layer in self.lower)
        return (*super().list_state(), StateField(32, f"{self.name}_lower_q30", (hidden,)))


def write_stack_step(
    w: Writer, layers: Sequence[IntegerGru], x: str, states: Sequence[str]
) -> list[str]:
    """Write a step of every layer, each on the state of the one below."""
    after = []
    for layer, h_q30 in zip(layers, states, strict=True):
        after.append(write_gru_step(w, layer, x, h_q30))
        x = w.round_shift(after[-1], COPY_BITS)
    return after


def _join_lower(w: Writer, states: Sequence[str]) -> dict[str, str]:
    """Write the state of a stack from its layers' states."""
    *lower, top = states
    return {"h_q30": top, "lower_q30": w.op("Concat", *lower, axis=1)}


NODES = (IntegerGruStack,)
