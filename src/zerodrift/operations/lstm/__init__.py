"""One or several LSTMs over the features: a step per sample, or afresh over a window."""

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
from zerodrift.operations.gru.cell import H_LIMIT_Q30
from zerodrift.operations.intervals import Bound, Interval, Shift
from zerodrift.operations.lstm.cell import (
    CELL_LIMIT,
    GATES,
    IntegerLstm,
    check_layer,
    write_lstm_step,
    write_relaxed,
)
from zerodrift.operations.lstm.error import bound_states
from zerodrift.operations.lstm.layouts import FILTERS
from zerodrift.operations.node import Names, OnnxStep, State, Values, Writer
from zerodrift.operations.recurrent import IntegerRecurrent, number_layers, prove_layers
from zerodrift.operations.signals import Real

LSTM = RuntimePart("zd_lstm.h", "zd_gates_are_sound")


@dataclass(frozen=True)
class IntegerLstmLayer(IntegerRecurrent):
    """LSTMs on top of each other, the lowest over the features: each reads the output below it.

    The output is the topmost h in Q1.30. What is carried is h ("h_q30") and c ("cell") of all
    layers side by side, the lowest first.
    """

    kind: ClassVar[str] = "lstm"
    layers: tuple[IntegerLstm, ...]
    """From the bottom up."""
    window: int
    """0: the state is carried from sample to sample ("stream")."""

    @property
    def streams(self) -> bool:
        """Whether the state is carried from sample to sample."""
        return not self.window

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names: several are numbered after a mark."""
        return number_layers(self.name, len(self.layers), mark)

    @property
    def width(self) -> int:
        """Number of hidden units H of the topmost layer."""
        return self.layers[-1].hidden

    @property
    def units(self) -> int:
        """Number of hidden units of all layers."""
        return sum(layer.hidden for layer in self.layers)

    def _split(self, state: State) -> list[IntArray]:
        """Return the layers' states [B, 2 H], h beside c, from the bottom up."""
        ends = np.cumsum([layer.hidden for layer in self.layers])[:-1]
        parts = zip(*(np.split(state[k], ends, axis=1) for k in ("h_q30", "cell")), strict=True)
        return [np.concatenate(both, axis=1) for both in parts]

    def _join(self, states: Sequence[IntArray]) -> State:
        """Return the state that `_split` takes apart."""
        halves = [np.split(state, 2, axis=1) for state in states]
        h_q30, cell = (np.concatenate(part, axis=1) for part in zip(*halves, strict=True))
        return {"h_q30": h_q30, "cell": cell}

    def _zeros(self, x: IntArray) -> list[IntArray]:
        return [np.zeros((x.shape[0], 2 * n.hidden), dtype=np.int64) for n in self.layers]

    def rest(self, values: Values) -> State:
        """Return cold states: all zero, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        return self._join(self._zeros(x))

    def settle(self, values: Values) -> State:
        """Return the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.rest(values)
        states: list[IntArray] = []
        x = values[self.inputs[0]]
        for layer in self.layers:
            states.append(layer.settle(x))
            x = round_shift(states[-1][:, : layer.hidden], COPY_BITS)
        return self._join(states)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next states and the topmost output in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._step_all(x, self._split(state))
            return self._join(states), states[-1][:, : self.width]
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        states = self._zeros(x)
        for k in range(self.window):
            states = self._step_all(window[:, k], states)
        return {"window": window}, states[-1][:, : self.width]

    def _step_all(self, x: IntArray, states: Sequence[IntArray]) -> list[IntArray]:
        after: list[IntArray] = []
        for layer, state in zip(self.layers, states, strict=True):
            after.append(layer.step(x, state))
            x = round_shift(after[-1][:, : layer.hidden], COPY_BITS)
        return after

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a window's position needs 16 bits."""
        names = self.name_layers(".")
        bounds = prove_layers(names, self.layers, inputs[0], bool(self.window))
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        else:
            limit = Interval(-CELL_LIMIT, CELL_LIMIT)
            bounds.append(Bound(f"{self.name}.cell", limit, 32).check())
        return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * self.width, bounds

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write all zero, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            newest = w.op("Unsqueeze", x, w.constant([1]))
            return {"window": w.op("Tile", newest, w.constant([1, self.window, 1]))}
        zeros = w.zeros(x, self.units)
        return {"h_q30": zeros, "cell": zeros}

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.write_rest(w, values)
        states: list[tuple[str, str]] = []
        x = values[self.inputs[0]]
        for layer in self.layers:
            states.append(write_relaxed(w, layer, x))
            x = w.round_shift(states[-1][0], COPY_BITS)
        return self._write_joined(w, states)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in time of all layers, or the whole window from zero."""
        x = values[self.inputs[0]]
        if not self.window:
            widths = [layer.hidden for layer in self.layers]
            halves = [
                [state[key]] if len(widths) == 1 else w.split(state[key], widths)
                for key in ("h_q30", "cell")
            ]
            states = self._write_all(w, x, list(zip(*halves, strict=True)))
            return self._write_joined(w, states), states[-1][0]
        window = w.op("Unsqueeze", x, w.constant([1]))
        if self.window > 1:
            ends = (w.constant([end]) for end in (1, self.window, 1))
            window = w.op("Concat", w.op("Slice", state["window"], *ends), window, axis=1)
        widths = [layer.hidden for layer in self.layers for _ in range(2)]

        def body(carried: Sequence[str], slices: Sequence[str]) -> tuple[list[str], list[str]]:
            pairs = list(zip(carried[::2], carried[1::2], strict=True))
            after = self._write_all(w, slices[0], pairs)
            return [name for pair in after for name in pair], []

        states_after = w.scan(
            body,
            [(w.zeros(x, width), ("B", width)) for width in widths],
            [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", self.layers[0].inputs))],
            [],
        )
        return {"window": window}, states_after[-2]

    def _write_all(
        self, w: Writer, x: str, states: Sequence[tuple[str, str]]
    ) -> list[tuple[str, str]]:
        after: list[tuple[str, str]] = []
        for layer, (h_q30, cell) in zip(self.layers, states, strict=True):
            after.append(write_lstm_step(w, layer, x, h_q30, cell))
            x = w.round_shift(after[-1][0], COPY_BITS)
        return after

    def _write_joined(self, w: Writer, states: Sequence[tuple[str, str]]) -> dict[str, str]:
        if len(states) == 1:
            return {"h_q30": states[0][0], "cell": states[0][1]}
        h_q30, cell = (w.op("Concat", *part, axis=1) for part in zip(*states, strict=True))
        return {"h_q30": h_q30, "cell": cell}

    def bound_states(self, rows: Sequence[Real], inputs: Sequence[Known]) -> list[Error]:
        """Return the error of every output where the layer is alone and forgets; see `error`."""
        if len(self.layers) > 1 or any(row.operation != "lstm" for row in rows):
            return super().bound_states(rows, inputs)
        return bound_states(self.layers[0], [row.numbers for row in rows], inputs)

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C, in the order of their names."""
        if self.window:
            return list_ring(self.name, "window", 16, (self.window, self.layers[0].inputs))
        return (
            StateField(32, f"{self.name}_cell", (self.units,)),
            StateField(32, f"{self.name}_h_q30", (self.units,)),
        )

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The kernel, and with it the tables of tanh and sigmoid."""
        return (LSTM,)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        shifts = []
        for name, layer in zip(self.name_layers("."), self.layers, strict=True):
            for gate, by, scaled_by in zip(GATES, layer.shift, layer.multiplier_shift, strict=True):
                shifts.append(Shift(f"{name}.{gate}.shift", by, 31))
                if layer.multiplier is not None:
                    shifts.append(Shift(f"{name}.{gate}.multiplier_shift", scaled_by, 62))
            shifts.append(Shift(f"{name}.cell_bits", layer.cell_bits, 31))
        return shifts

    def check_form(self) -> None:
        """Raise ValueError where the window is too long, or a layer's arrays do not fit."""
        if not 0 <= self.window <= LONGEST_WINDOW:
            raise ValueError(
                f"node '{self.name}' has a window of {self.window}, not 0 to {LONGEST_WINDOW}"
            )
        if not self.layers:
            raise ValueError(f"node '{self.name}' has no layer")
        for layer in self.layers:
            check_layer(self.name, layer)


NODES = (IntegerLstmLayer,)
__all__ = ["FILTERS", "NODES", "IntegerLstmLayer"]
