"""Halves what an LSTM's features can be, so that its gates are taken at their worst together.

Any way to halve is sound: at each step the features lie in one of the parts. Which part is halved
next is chosen in floating point, as docs/reference/error-bound.md states it, so that whoever
derives the bound again comes to the same parts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

Box = tuple[tuple[int, int], ...]
"""The lowest and highest integer of every feature."""

HALVINGS = 48
WAYS = ("size", "cell", "cell", "output", "cell", "cell")
"""What the part that is halved next is the worst in, in turn."""
OF_TABLE = 2.0**-14
LARGEST = 40.0
OUTPUT = 3


@dataclass(frozen=True)
class FloatGate:
    """A gate's argument: bias + sum of weight times integer, and what the chip adds to it."""

    bias: float
    weights: tuple[float, ...]
    """Of a count of each feature."""
    states: float
    """The sum of the sizes of the states' weights."""
    gap: float
    gaps: tuple[float, ...]
    """By how much the chip's weight of a count is larger."""
    off: float
    """What else both may be apart."""

    def reach(self, box: Box) -> tuple[float, float, float]:
        """Return the lowest and highest argument, and the most that the chip's is off."""
        low, high = self.bias - self.states, self.bias + self.states
        gap_low = gap_high = self.gap
        for (first, last), weight, gap in zip(box, self.weights, self.gaps, strict=True):
            low += min(weight * first, weight * last)
            high += max(weight * first, weight * last)
            gap_low += min(gap * first, gap * last)
            gap_high += max(gap * first, gap * last)
        return low, high, max(abs(gap_low), abs(gap_high)) + self.off


@dataclass(frozen=True)
class Worst:
    """How bad a part is, in about what is bounded later on."""

    size: float
    """Of the cell state."""
    added: float
    """To the cell state's error, but for the forget gate's."""
    of_forget: float
    """To it for each 1 that the cell state is."""
    most: float
    """The output gate."""
    of_output: float
    """What the output gate is off."""


def halve(gates: Sequence[FloatGate], box: Box) -> list[Box]:
    """Return parts that cover a box, `HALVINGS` more than one, or fewer where they are points.

    Args:
        gates: i, f, g, o of a unit.
        box: all that the features can be.
    """
    parts = [(box, _judge(gates, box))]
    for turn in range(HALVINGS):
        way = WAYS[turn % len(WAYS)]
        size = max(worst.size for _, worst in parts)
        cell = max(worst.added + worst.of_forget * size for _, worst in parts)
        scores = [_score(worst, way, size, cell) for _, worst in parts]
        k = max(range(len(parts)), key=scores.__getitem__)
        halves = _cut(gates[OUTPUT:] if way == "output" else gates[:OUTPUT], parts[k][0])
        parts[k : k + 1] = [(half, _judge(gates, half)) for half in halves]
    return [part for part, _ in parts]


def _score(worst: Worst, way: str, size: float, cell: float) -> float:
    if way == "size":
        return worst.size
    if way == "cell":
        return worst.added + worst.of_forget * size
    return worst.most * cell + worst.of_output


def _judge(gates: Sequence[FloatGate], box: Box) -> Worst:
    i, f, g, o = (gate.reach(box) for gate in gates)
    gain = 1.0 + math.exp(min(f[1], LARGEST))
    most_i, most_g = _sigmoid(i[1]), max(abs(math.tanh(g[0])), abs(math.tanh(g[1])))
    of_i = _slope(i[0] / 2.0, i[1] / 2.0) / 4.0 * i[2] + OF_TABLE / 2.0
    of_g = _slope(g[0], g[1]) * g[2] + OF_TABLE
    of_o = _slope(o[0] / 2.0, o[1] / 2.0) / 4.0 * o[2]
    size = gain * most_i * most_g
    added = gain * (most_i * of_g + most_g * of_i)
    return Worst(size, added, f[2] + OF_TABLE, _sigmoid(o[1]), of_o)


def _cut(gates: Sequence[FloatGate], box: Box) -> list[Box]:
    """Return the halves of a box by the feature that moves the arguments most."""
    moved = [
        (last - first) * sum(abs(gate.weights[k]) for gate in gates)
        for k, (first, last) in enumerate(box)
    ]
    k = moved.index(max(moved))
    first, last = box[k]
    if first == last:
        return [box]
    middle = (first + last) // 2
    return [(*box[:k], ends, *box[k + 1 :]) for ends in ((first, middle), (middle + 1, last))]


def _sigmoid(x: float) -> float:
    return 1.0 / (1.0 + math.exp(min(-x, LARGEST)))


def _slope(low: float, high: float) -> float:
    """Return the largest slope of tanh."""
    return 1.0 - math.tanh(max(low, -high, 0.0)) ** 2
