"""GRUs on top of each other, each on the state of the one below."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.c_text import StateField
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import Names, State, Writer
from zerodrift.operations.recurrent import IntegerRecurrent


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

    def list_lower(self) -> list[IntegerRecurrent]:
        """Return the layers below the topmost, each as a node by itself, named as in bounds."""
        names = self.name_layers(".")
        return [
            IntegerGruLayer(name, self.inputs, gru=gru, window=self.window)
            for name, gru in zip(names, self.lower, strict=False)
        ]

    def _split(self, state: State) -> list[IntArray]:
        ends = np.cumsum([layer.hidden for layer in self.lower])
        return [*np.split(state["lower_q30"], ends[:-1], axis=1), state["h_q30"]]

    def _join(self, states: Sequence[IntArray]) -> State:
        return {"h_q30": states[-1], "lower_q30": np.concatenate(states[:-1], axis=1)}

    def _write_split(self, w: Writer, state: Names) -> list[list[str]]:
        widths = [layer.hidden for layer in self.lower]
        return [[name] for name in (*w.split(state["lower_q30"], widths), state["h_q30"])]

    def _write_joined(self, w: Writer, states: Sequence[Sequence[str]]) -> dict[str, str]:
        *lower, top = (state[0] for state in states)
        return {"h_q30": top, "lower_q30": w.op("Concat", *lower, axis=1)}

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer."""
        if not self.lower:
            raise CheckError(f"{self.name}: one layer is no stack. The model is refused.")
        return super().prove(inputs)

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        if self.window:
            return super().list_state()
        hidden = sum(layer.hidden for layer in self.lower)
        return (*super().list_state(), StateField(32, f"{self.name}_lower_q30", (hidden,)))


NODES = (IntegerGruStack,)
