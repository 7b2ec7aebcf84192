"""Play (backlash): the rate-independent memory of which hysteresis is composed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import saturate
from zerodrift.operations.c_text import StateField
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.formats import SIGNAL_BITS, FormattedNodes
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.operation import Node, Operation
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.sum import fit

FEW_MOVES = 0.25
"""Share of samples that differ from the one before, up to which the others are left out."""


def play(x: Array, half_width: float) -> Array:
    """Return the play operator of half-width r: y[n] = min(max(y[n-1], x[n] - r), x[n] + r).

    y follows x on a slack of r to either side; it starts centred, y[0] = x[0].

    Args:
        x: [..., n], uninterrupted stretches along the last axis.
        half_width: r >= 0 in x's unit; 0 returns x.

    Limits: takes about 3 sqrt(n) vector operations; n counts samples that differ from the one
    before, where these are few.
    """
    if half_width <= 0.0 or x.size == 0:
        return x.copy()
    stretches = x.reshape(-1, x.shape[-1])
    moves = np.ones(stretches.shape, dtype=np.bool_)
    np.not_equal(stretches[:, 1:], stretches[:, :-1], out=moves[:, 1:])
    most = int(moves.sum(axis=1).max())
    if most > FEW_MOVES * x.shape[-1]:
        return _play(stretches, half_width).reshape(x.shape)
    # Where x stands still y does too: a load's steps are few beside the samples of its plateaus.
    places = [np.flatnonzero(row) for row in moves]
    moving = np.repeat(stretches[:, -1:], most, axis=1)
    for row, values, at in zip(moving, stretches, places, strict=True):
        row[: at.size] = values[at]
    y = np.empty_like(stretches)
    for row, values, at in zip(y, _play(moving, half_width), places, strict=True):
        row[:] = np.repeat(values[: at.size], np.diff(at, append=row.size))
    return y.reshape(x.shape)


def _play(stretches: Array, half_width: float) -> Array:
    """Return the play of stretches [S, n].

    A step maps y to its clip between x - r and x + r, and clips compose to clips, so a stretch is
    cut into about sqrt(n) blocks, the blocks' clips are composed side by side, and then run
    through once more from each block's start.
    """
    count = stretches.shape[-1]
    length = max(1, math.isqrt(count))
    blocks = -(-count // length)
    padded = np.empty((stretches.shape[0], blocks * length))
    padded[:, :count] = stretches
    padded[:, count:] = stretches[:, -1:]
    # [length, blocks, stretches]: row i holds step i of every block, contiguous for speed.
    steps = np.ascontiguousarray(padded.reshape(-1, blocks, length).transpose(2, 1, 0))
    high = steps + half_width
    low = np.subtract(steps, half_width, out=steps)

    ends = np.stack([low[0], high[0]])
    for i in range(1, length):
        _limit(ends, low[i], high[i], out=ends)
    floor, ceiling = ends
    present = np.empty_like(floor)
    value = stretches[:, 0].copy()
    for block in range(blocks):
        present[block] = value
        _limit(value, floor[block], ceiling[block], out=value)

    y = low
    for i in range(length):
        present = _limit(present, low[i], high[i], out=y[i])
    return np.asarray(y.transpose(2, 1, 0).reshape(-1, blocks * length)[:, :count])


def _limit(x: Array, low: Array, high: Array, out: Array) -> Array:
    """Write x limited to low .. high into `out`; half the time of `np.clip` on short vectors."""
    np.maximum(x, low, out=out)
    return np.minimum(out, high, out=out)


@dataclass(frozen=True)
class IntegerPlay(IntegerNode):
    """y' = saturate(y, x - half_width, x + half_width): no rounding, nothing but comparisons."""

    kind: ClassVar[str] = "play"
    half_width: int

    def rest(self, values: Values) -> State:
        """Return y in the middle of its slack."""
        return {"y": values[self.inputs[0]]}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next y, which is the output."""
        x = values[self.inputs[0]]
        y = np.asarray(saturate(state["y"], x - self.half_width, x + self.half_width))
        return {"y": y}, y

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound x -+ half_width, and y by induction.

        y starts at an x, within x's range X. A y in X that is below x - r becomes x - r, which lies
        between y and x; one that is above x + r likewise. So y stays in X.
        """
        if self.half_width < 0:
            raise CheckError(
                f"{self.name}: a half-width of {self.half_width}; at least 0 is possible."
                " The model is refused."
            )
        x = inputs[0][0]
        slack = Interval(-self.half_width, self.half_width)
        return [x], [
            Bound(f"{self.name}.slack", x + slack, 32).check(),
            Bound(f"{self.name}.y", x, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return the error of x and of the slack; y is limited by x -+ r, so errors do not
        accumulate.

        y is the old y limited to x - r .. x + r. Two limits at most d apart leave two y at most d
        apart, if they were before, as they are at rest. A slack wider than all that x can do never
        moves y; the real x goes beyond its integers' range by its error on either side, and moves
        its y by twice that at most.
        """
        (x,) = inputs
        (half_width,) = map(Fraction, real.numbers)
        wanted = min(half_width / abs(x.scale), Fraction(x.high - x.low))
        gap = abs(self.half_width - wanted) * abs(out.scale)
        wide = half_width >= (x.high - x.low) * abs(x.scale)
        return x.error.scale(Fraction(3 if wide else 1)) + Error(coefficients=gap)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write saturate(y, x - half_width, x + half_width)."""
        x, r = values[self.inputs[0]], w.constant(self.half_width)
        y = w.minimum(w.maximum(state["y"], w.sub(x, r)), w.add(x, r))
        return {"y": y}, y

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write y in the middle of its slack."""
        return {"y": values[self.inputs[0]]}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return (StateField(32, f"{self.name}_y"),)

    def express(self) -> str:
        """Return the next y in C."""
        return f"zd_play(&s->{self.name}_y, {self.inputs[0]}, {self.half_width})"


def lower(nodes: FormattedNodes, node: Node, x: Signal) -> Signal:
    """Return the play of x, in its own format."""
    half_width = node.constants[0]
    if half_width <= 0.0 or not x.node:
        return x
    x = fit(nodes, x, SIGNAL_BITS + 1)
    interval = nodes.intervals[x.node][0]
    width = round(half_width / abs(x.scale))
    span = interval.high - interval.low
    # A slack wider than the whole range of x acts like one of that width.
    slack = IntegerPlay(nodes.new_name("play"), (x.node,), min(width, span))
    out = Signal(nodes.append(slack), x.scale, x.offset)
    return out.standing_for("play", (x,), half_width)


OPERATION = Operation("play", play, lower, ("x",), ("half_width",))
NODES = (IntegerPlay,)
