"""What all recurrent layers have in common for those that look at a model from outside."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.arithmetic import IntArray
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.node import IntegerNode, Names, State, Values, Writer
from zerodrift.operations.signals import Real


@dataclass(frozen=True)
class IntegerRecurrent(IntegerNode):
    """One or several recurrent layers: a step per sample, or afresh over a window.

    The output is the topmost layer's state in Q1.30, which is the field "h_q30" of what is carried.
    """

    @property
    def streams(self) -> bool:
        """Whether the state is carried from sample to sample."""
        raise NotImplementedError

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names from the bottom up: several are numbered after a mark."""
        raise NotImplementedError

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise: no contraction is shown, without which errors may grow from step to step."""
        raise NoRuleError("a recurrent layer carries errors on, and no contraction is shown")

    def at_rest(self, state: State, values: Values) -> IntArray:
        """Return the topmost output as it stands in a carried state, which is last there."""
        if self.streams:
            return np.asarray(state["h_q30"][:, -self.width :])
        return super().at_rest(state, values)

    def write_at_rest(self, w: Writer, values: Names, state: Names) -> str:
        """Write the topmost output as it stands in a carried state."""
        if not self.streams:
            return super().write_at_rest(w, values, state)
        ends = (w.constant([end]) for end in (-self.width, 2**31 - 1, 1))
        return w.op("Slice", state["h_q30"], *ends)
