"""What all recurrent layers have in common: names, the proof through a stack, the state at rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, State, Values, Writer
from zerodrift.operations.signals import Real

STATE = "state"
"""What a state stands for of which no more is said than that it lies between -1 and 1."""
WAYS = ("gru_after", "gru_before", "lstm", "recurrent")
"""What states of recurrent layers stand for by the way they came about."""
NO_RULE = "a recurrent layer of this kind carries errors on, and no contraction is shown"


@dataclass(frozen=True)
class IntegerRecurrent(IntegerNode):
    """One or several recurrent layers: a step per sample, or afresh over a window.

    The output is the topmost layer's state in Q1.30, which is the field "h_q30" of what is carried.
    """

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return True

    @property
    def streams(self) -> bool:
        """Whether the state is carried from sample to sample."""
        raise NotImplementedError

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names from the bottom up: several are numbered after a mark."""
        raise NotImplementedError

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise: a state's error is bounded with those of all others, by `bound_states`."""
        raise NoRuleError(NO_RULE)

    def bound_states(self, rows: Sequence[Real], inputs: Sequence[Known]) -> list[Error]:
        """Return the error of every unit of the topmost state, whatever the number of steps.

        Args:
            rows: what each of them stands for.
            inputs: what is known of the features.

        Raises:
            NoRuleError: no contraction is shown, without which errors may grow from step to step.
        """
        raise NoRuleError(NO_RULE)

    def list_lower(self) -> "list[IntegerRecurrent]":
        """Return the layers below the topmost, each as a node by itself, named as in bounds."""
        return []

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


class Layer(Protocol):
    """One layer of a stack."""

    @property
    def inputs(self) -> int:
        """Numbers that it reads."""

    @property
    def hidden(self) -> int:
        """Number of hidden units H."""

    def prove(self, name: str, features: list[Interval]) -> list[Bound]:
        """Bound every accumulator."""


def number_layers(name: str, count: int, mark: str) -> list[str]:
    """Return the names of a stack's layers, the lowest first: several are numbered after a mark."""
    return [name] if count == 1 else [f"{name}{mark}{level}" for level in range(count)]


def prove_layers(
    names: Sequence[str], layers: Sequence[Layer], below: list[Interval], windowed: bool
) -> list[Bound]:
    """Bound every accumulator of a stack; an output's int16 copy is at most 32767.

    Args:
        names: of the layers, for the bounds.
        layers: from the bottom up.
        below: of the features, int16.
        windowed: the features of a window are taken to be any int16, so that the proof does not
            depend on the stored values.

    Raises:
        CheckError: a layer does not read as many values as the one below gives, or is not safe.
    """
    if windowed:
        below = [Interval(INT16_MIN, INT16_MAX)] * layers[0].inputs
    bounds: list[Bound] = []
    for name, layer in zip(names, layers, strict=True):
        if layer.inputs != len(below):
            raise CheckError(
                f"{name}: the layer reads {layer.inputs} values, and gets {len(below)}."
                " The model is refused."
            )
        bounds += layer.prove(name, below)
        below = [Interval(-INT16_MAX, INT16_MAX)] * layer.hidden
    return bounds
