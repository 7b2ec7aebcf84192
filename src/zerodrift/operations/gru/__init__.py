"""A GRU over the features, one step per sample or over a window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift.base.arrays import IntArray
from zerodrift.operations.c_text import RuntimePart, StateField, list_ring
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.gru.error import bound_states
from zerodrift.operations.gru.layouts import FILTERS
from zerodrift.operations.node import Names, State, Writer
from zerodrift.operations.recurrent import IntegerRecurrent
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
    def layers(self) -> tuple[IntegerGru, ...]:
        """All layers from the bottom up."""
        return (self.gru,)

    def _split(self, state: State) -> list[IntArray]:
        """Return the layers' states from the bottom up."""
        return [state["h_q30"]]

    def _join(self, states: Sequence[IntArray]) -> State:
        """Return the state that `_split` takes apart."""
        return {"h_q30": states[-1]}

    def _write_split(self, w: Writer, state: Names) -> list[list[str]]:
        return [[state["h_q30"]]]

    def _write_joined(self, w: Writer, states: Sequence[Sequence[str]]) -> dict[str, str]:
        return {"h_q30": states[-1][0]}

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


NODES = (IntegerGruLayer,)
__all__ = ["FILTERS", "NODES", "IntegerGruLayer"]
