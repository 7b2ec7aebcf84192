"""One or several LSTMs over the features: a step per sample, or afresh over a window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.operations.c_text import RuntimePart, StateField, list_ring
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.lstm.cell import (
    CELL_LIMIT,
    IntegerLstm,
)
from zerodrift.operations.lstm.error import bound_states
from zerodrift.operations.lstm.layouts import FILTERS
from zerodrift.operations.node import Names, State, Writer
from zerodrift.operations.recurrent import IntegerRecurrent, symmetric
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

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a window's position needs 16 bits."""
        reach, bounds = super().prove(inputs)
        if not self.window:
            bounds.append(symmetric(f"{self.name}.cell", CELL_LIMIT, 32).check())
        return reach, bounds

    def _write_split(self, w: Writer, state: Names) -> list[list[str]]:
        widths = [layer.hidden for layer in self.layers]
        halves = [
            [state[key]] if len(widths) == 1 else w.split(state[key], widths)
            for key in ("h_q30", "cell")
        ]
        return [list(both) for both in zip(*halves, strict=True)]

    def _write_joined(self, w: Writer, states: Sequence[Sequence[str]]) -> dict[str, str]:
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


NODES = (IntegerLstmLayer,)
__all__ = ["FILTERS", "NODES", "IntegerLstmLayer"]
