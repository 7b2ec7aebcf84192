"""The meaning of a signal's integers, in its unit and in real arithmetic."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Signal:
    """An integer signal q and its meaning: physical value = q * scale + offset.

    A constant has no node (an empty name), scale 0 and its value as offset.
    """

    node: str
    scale: float
    offset: float = 0.0
    index: int = 0
    """Of the integer, where the node gives several."""
    real: "Real | None" = field(default=None, compare=False, repr=False)
    """Its value in real arithmetic; see `meaning`."""

    def standing_for(
        self, operation: str, inputs: Sequence["Signal"] = (), *numbers: float
    ) -> "Signal":
        """Return the signal with what it stands for in real arithmetic; see `Real`."""
        place = (self.node, self.index, self.scale, self.offset)
        return replace(self, real=Real(operation, tuple(inputs), numbers, place))

    @property
    def meaning(self) -> "Real | None":
        """The signal in real arithmetic; None where not stated, or stated for another format."""
        place = (self.node, self.index, self.scale, self.offset)
        return self.real if self.real is not None and self.real.place == place else None


@dataclass(frozen=True, eq=False)
class Real:
    """A signal in real arithmetic: an operation on other signals, with unrounded numbers.

    The error rules (`bound_error`) are about this. `operation` is that of the float graph, or one
    of "same" (its input in another format), "linear" (a sum with a gain for each input, limited
    where the chip's is), "dense_tanh" and "dense_clip" (low, high, bias, weights), "gru_after" and
    "gru_before": a unit of a GRU over the features, or over int16 copies of the states below, with
    its biases r, u, n, n inside the reset product, its weights of the inputs for r, u, n and those
    of the state; and "lstm": a unit of an LSTM, with its biases i, f, g, o and the weights of
    these. The other units of a layer are those of the same node. "state" is a state of any
    recurrent layer, of which no more is said than that it lies between -1 and 1.
    """

    operation: str
    inputs: tuple[Signal, ...]
    numbers: tuple[float, ...]
    place: tuple[str, int, float, float]
    """Node, index, scale and offset of the signal that this was said of."""


def constant(value: float) -> Signal:
    """Return the signal that is always `value`."""
    return Signal("", 0.0, value).standing_for("constant", (), value)
