"""Bounds the distance of an integer GRU's state from that of real arithmetic, for any run length.

h, u, n are the chip's, H, U, N those of real arithmetic, a and A the arguments of the update gates.
A step gives, unit by unit,

    h' - H' = (1 - u) (h - H) + u (n - N) + (u - U) (N - H) + rounding

    u - U   = (u - sigmoid(a)) + sigmoid(a) (1 - U) (1 - exp(A - a))        exactly.

The table is off by at most u (k (1 - u) + r), see `bound_sigmoid_table`. With |a - A| <= d also
1 - U <= (1 - sigmoid(a)) exp(d), so that

    |u - U| <= u (s (1 - u) + t)
    s = k + (1 + k + r) (1 + k) exp(d) (exp(d) - 1)        t = r (1 + s).

N and H lie in an interval of half its width w around c: H is 0 at first, and then between itself
and N. Let g(H) = w - (H - c)**2 / (2 w), which is from w / 2 to w and of a slope of at most 1.
With D = N - H, u D in the place of U D makes g(H') another by at most |u - U| |D|, and

    g(H + u D) = (1 - u) g(H) + u g(N) + u (1 - u) D**2 / (2 w)
              >= (1 - u) g(H) + u (1 - u) |D|,   as (1 - u) (|D| - w)**2 + u w**2 >= 0.

Hence |h - H| <= R + s g(H) holds at every step if it held before, where

    R >= |n - N| + 2 w (t + s (s + t)) + rounding / u,

whatever u is; so |h - H| <= e = R + s w. On the way to rest u = U = 1/2, and R alone is enough.
|n - N| and d are sums of numbers of the model and multiples of the errors e. All in all, e >= F(e)
is wanted with F rising; e = F(e) is solved in floating point, taken a little larger, and shown to
be enough in fractions. There is a solution where the multiples, as a matrix, have eigenvalues below
1: where an error, by the sizes of the weights, shrinks.

For contraction of a GRU by the sizes of its weights see Bonassi, Farina and Scattolini, "On the
stability properties of gated recurrent units neural networks", 2021, arXiv 2011.06806.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.enclosure import shorten
from zerodrift.operations.errors import HALF, ZERO, Error, Known, SumTerm, bound_sum
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.table_error import (
    SigmoidError,
    bound_sigmoid,
    bound_sigmoid_table,
    bound_slope,
    bound_tanh,
)
from zerodrift.operations.tables import T_MIN, sigmoid_q31

Array = NDArray[np.float64]

COPY = Fraction(1, 1 << 15)
"""What a count of a state's int16 copy stands for."""
STEP = Fraction(1, 1 << 30)
"""A step's rounding: half a count of the move, doubled."""
QUARTER = Fraction(1, 4)
TRIES = 40
SPARE = 2.0**-10
"""By which the errors are taken larger than found: the second derivation goes another way."""


@dataclass(frozen=True)
class RealUnit:
    """One unit of the float GRU, gates in the order r, u, n."""

    bias: tuple[Fraction, ...]
    """r, u, n outside the reset product, n inside it."""
    w_x: tuple[tuple[Fraction, ...], ...]
    """[3][I]."""
    w_h: tuple[tuple[Fraction, ...], ...]
    """[3][H]."""

    @classmethod
    def of(cls, numbers: Sequence[float], inputs: int, hidden: int) -> "RealUnit":
        """Return the unit of a row as `Real` has it: four biases, w_x of r, u, n, then w_h."""
        given = tuple(map(Fraction, numbers))
        if len(given) != 4 + 3 * (inputs + hidden):
            raise NoRuleError("a unit of a recurrent layer with another number of weights")
        first = 4 + 3 * inputs
        return cls(
            given[:4],
            tuple(given[4 + g * inputs : 4 + (g + 1) * inputs] for g in range(3)),
            tuple(given[first + g * hidden : first + (g + 1) * hidden] for g in range(3)),
        )


@dataclass(frozen=True)
class GateArgument:
    """What a gate's activation is of: how far off by itself, how much by the states, its range."""

    error: Error
    gains: tuple[Fraction, ...]
    """[H] how much of each state's error is added."""
    low: Fraction
    high: Fraction
    """Of chip and real arithmetic."""

    @property
    def size(self) -> Fraction:
        """The largest absolute value."""
        return max(abs(self.low), abs(self.high))


@dataclass(frozen=True)
class Growth:
    """What a step makes of the errors e of all states, for one unit: F(e)."""

    fixed: Error
    """Without the update gate: |n - N| at e = 0, and the rounding."""
    gains: tuple[Fraction, ...]
    """[H] of |n - N|."""
    update: GateArgument
    """Of the update gate: d = its error + its gains e."""
    table: SigmoidError
    half: Fraction
    """Half the width w of where N and H lie."""

    @property
    def factor(self) -> Fraction:
        """What d (1 + 2 d) is multiplied by in s."""
        return (1 + self.table.share + self.table.rest) * (1 + self.table.share)

    def move(self, errors: Sequence[Fraction]) -> "UpdateMove":
        """Return d and s."""
        d = self.update.error.total + _weigh(self.update.gains, errors)
        return UpdateMove(d, self.table.share + self.factor * d * (1 + 2 * d))

    def grow(self, errors: Sequence[Fraction]) -> Fraction:
        """Return F(e)."""
        s = self.move(errors).s
        of_update = s * (1 + 2 * s) + 2 * self.table.rest * (1 + s) ** 2
        return self.fixed.total + _weigh(self.gains, errors) + self.half * of_update


@dataclass(frozen=True)
class UpdateMove:
    """How far the update gate is off: d and s; exp(d) (exp(d) - 1) <= d (1 + 2 d) to d = 1/4."""

    d: Fraction
    s: Fraction


def bound_states(
    gru: IntegerGru, numbers: Sequence[Sequence[float]], features: Sequence[Known]
) -> list[Error]:
    """Return the error of every state.

    Args:
        gru: the layer.
        numbers: per unit those of the float layer; see `RealUnit.of`.
        features: what is known of its int16 inputs.

    Raises:
        NoRuleError: no contraction is shown.
    """
    units = [RealUnit.of(row, gru.inputs, gru.hidden) for row in numbers]
    rules = _Rules(gru, units, features)
    return _solve([rules.bound_growth(i) for i in range(gru.hidden)])


class _Rules:
    """The error rules of one layer."""

    def __init__(
        self, gru: IntegerGru, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        self._gru, self._units, self._features = gru, units, features
        self._zero = (ZERO,) * gru.hidden
        self._after = gru.reset == "after"
        copied = Error(rounding=COPY / 2)
        self._copies = [Known(-32767, 32767, COPY, ZERO, copied) for _ in units]
        self._tanh = bound_tanh() / (1 << 30)
        self._reset = [self._bound_reset(i) for i in range(gru.hidden)]

    def bound_growth(self, i: int) -> Growth:
        """Return what one step makes of the errors, for unit i."""
        u = self._bound_argument(1, i)
        n = self._bound_candidate(i)
        low, high = math.floor(u.low * (1 << 15)), math.ceil(u.high * (1 << 15))
        slowest = Fraction(int(sigmoid_q31(np.array([max(low, T_MIN)]))[0]), 1 << 31)
        ends = [self._bound_tanh(end) for end in (n.low, n.high)]
        half = (max(ends[1], ZERO) - min(ends[0], ZERO)) / 2
        slope = bound_slope(n.low, n.high)
        fixed = n.error.scale(slope) + Error(table=self._tanh, rounding=STEP / min(slowest, HALF))
        gains = tuple(slope * gain for gain in n.gains)
        return Growth(fixed, gains, u, bound_sigmoid_table(low, high), half)

    @staticmethod
    def _bound_tanh(x: Fraction) -> Fraction:
        """Return a number as far as tanh(x), or further from 0."""
        size = 2 * bound_sigmoid(2 * abs(x)).high - 1
        return size if x > 0 else -size

    def _bound_reset(self, i: int) -> tuple[Fraction, GateArgument]:
        """Return the largest r, and how far r is off: its range is not meant."""
        a = self._bound_argument(0, i)
        slope = bound_slope(a.low / 2, a.high / 2) / 4
        error = a.error.scale(slope) + Error(table=self._tanh / 2)
        gains = tuple(slope * gain for gain in a.gains)
        most = min(bound_sigmoid(a.high).high + self._tanh / 2, Fraction(1))
        return most, GateArgument(error, gains, ZERO, most)

    def _bound_argument(self, g: int, i: int) -> GateArgument:
        """Return the argument of a sigmoid: everything is in one sum."""
        gru, unit = self._gru, self._units[i]
        count = Fraction(1, 1 << (15 + gru.shift[g]))
        constant = self._read_bias(g, i) * count - unit.bias[g]
        error = self._sum_features(g, i, count, constant)
        error += self._sum_states(g, i, count, ZERO)
        error += self._round_shift(g, Fraction(1, 1 << 15))
        return self._enclose(error, tuple(map(abs, unit.w_h[g])), self._reach(g, i))

    def _bound_candidate(self, i: int) -> GateArgument:
        gru, unit = self._gru, self._units[i]
        count = Fraction(1, 1 << (16 + gru.shift[2]))
        constant = self._read_bias(2, i) * count - unit.bias[2]
        error = self._sum_features(2, i, count, constant)
        error += self._round_shift(2, Fraction(1, 1 << 16))
        low, high = self._reach_of_features(2, i)
        most = sum(map(abs, unit.w_h[2]), ZERO)
        if self._after:
            inside = Fraction(int(gru.bias[3, i])) * count / 2 - unit.bias[3]
            product = self._sum_states(2, i, count / 2, inside)
            reset, r = self._reset[i]
            size = abs(unit.bias[3]) + most
            error += product.scale(reset) + r.error.scale(size) + Error(rounding=count / 2)
            gains = tuple(
                reset * abs(w) + size * own for w, own in zip(unit.w_h[2], r.gains, strict=True)
            )
            ends = (reset * (unit.bias[3] - most), reset * (unit.bias[3] + most))
            return self._enclose(
                error, gains, (low + min(ends[0], ZERO), high + max(ends[1], ZERO))
            )
        error += self._sum_states(2, i, count, ZERO)
        gains = self._zero
        for j, (w, (reset, r)) in enumerate(zip(unit.w_h[2], self._reset, strict=True)):
            size = abs(w)
            error += r.error.scale(size)
            own = (reset if k == j else ZERO for k in range(gru.hidden))
            both = zip(gains, own, r.gains, strict=True)
            gains = tuple(gain + size * (a + b) for gain, a, b in both)
        return self._enclose(error, gains, (low - most, high + most))

    def _read_bias(self, g: int, i: int) -> Fraction:
        """Return a bias less the rounding half that is folded in."""
        return Fraction(int(self._gru.bias[g, i]) - (1 << self._gru.shift[g] >> 1))

    def _round_shift(self, g: int, scale: Fraction) -> Error:
        return Error(rounding=scale * HALF if self._gru.shift[g] else ZERO)

    def _sum_features(self, g: int, i: int, count: Fraction, constant: Fraction) -> Error:
        terms = [
            SumTerm(gain, ("features", k), x)
            for k, (gain, x) in enumerate(zip(self._units[i].w_x[g], self._features, strict=True))
        ]
        chip = {("features", k): int(w) * count for k, w in enumerate(self._gru.w_x[g, i])}
        return bound_sum(terms, chip, constant, "weights")

    def _sum_states(self, g: int, i: int, count: Fraction, constant: Fraction) -> Error:
        """Return the error of w_h . h but for that of the states themselves."""
        gru, rounded = self._gru, ZERO
        of_row = count
        if gru.multiplier is not None:
            of_row *= Fraction(int(gru.multiplier[g, i]), 1 << gru.multiplier_shift[g])
            rounded = count / 2 if gru.multiplier_shift[g] else ZERO
        terms = [
            SumTerm(gain, ("h", j), x)
            for j, (gain, x) in enumerate(zip(self._units[i].w_h[g], self._copies, strict=True))
        ]
        chip = {("h", j): int(w) * of_row for j, w in enumerate(gru.w_h[g, i])}
        return bound_sum(terms, chip, constant, "weights") + Error(rounding=rounded)

    def _reach_of_features(self, g: int, i: int) -> tuple[Fraction, Fraction]:
        low = high = self._units[i].bias[g]
        for w, x in zip(self._units[i].w_x[g], self._features, strict=True):
            off = x.error.total
            ends = (w * (x.ends[0] - off), w * (x.ends[1] + off))
            low, high = low + min(ends), high + max(ends)
        return low, high

    def _reach(self, g: int, i: int) -> tuple[Fraction, Fraction]:
        low, high = self._reach_of_features(g, i)
        most = sum(map(abs, self._units[i].w_h[g]), ZERO)
        return low - most, high + most

    @staticmethod
    def _enclose(
        error: Error, gains: tuple[Fraction, ...], ends: tuple[Fraction, Fraction]
    ) -> GateArgument:
        """Return an argument whose range covers the chip: the same states, but for the error."""
        off = error.total
        return GateArgument(error, gains, ends[0] - off, ends[1] + off)


def _solve(growths: Sequence[Growth]) -> list[Error]:
    """Return errors e >= F(e).

    Raises:
        NoRuleError: there are none, or they are not found.
    """
    moves = [UpdateMove(ZERO, growth.table.share) for growth in growths]
    if any(move.s > QUARTER for move in moves):
        raise NoRuleError(
            "a recurrent layer's update gate comes so near to 0 that its table is off by over a"
            " quarter; [network] contracting = true trains one that stays away from it"
        )
    for _ in range(TRIES):
        proposed = _propose(growths, moves)
        errors = [error.total for error in proposed]
        moves = [growth.move(errors) for growth in growths]
        if any(move.d > QUARTER or move.s > QUARTER for move in moves):
            break
        if all(e >= growth.grow(errors) for e, growth in zip(errors, growths, strict=True)):
            return proposed
    raise NoRuleError("a recurrent layer carries errors on, and they were not shown to stay small")


def _weigh(gains: Sequence[Fraction], errors: Sequence[Fraction]) -> Fraction:
    return sum((gain * e for gain, e in zip(gains, errors, strict=True)), ZERO)


def _propose(growths: Sequence[Growth], moves: Sequence[UpdateMove]) -> list[Error]:
    """Return e = F(e) and a little more, F being straight with the given d and s, cause by cause.

    Raises:
        NoRuleError: an error grows, by the sizes of the weights.
    """
    rows, fixed = [], []
    for growth, move in zip(growths, moves, strict=True):
        of_s = growth.half * (1 + 2 * move.s)
        of_d = float(of_s * growth.factor * (1 + 2 * move.d))
        both = zip(growth.gains, growth.update.gains, strict=True)
        rows.append([float(gain) + of_d * float(own) for gain, own in both])
        table = of_s * growth.table.share
        table += 2 * growth.half * growth.table.rest * (1 + move.s) ** 2
        error = growth.fixed + Error(table=table)
        parts = zip(error.parts(), growth.update.error.parts(), strict=True)
        fixed.append([float(part) + of_d * float(own) for part, own in parts])
    radius = float(np.abs(np.linalg.eigvals(np.array(rows))).max())
    if radius >= 1.0:
        raise NoRuleError(
            "a recurrent layer carries errors on, and no contraction is shown: by the sizes of its "
            f"weights an error may grow {radius:.3g} times; [network] contracting = true trains one"
            " that forgets"
        )
    found = np.linalg.solve(np.eye(len(rows)) - np.array(rows), np.array(fixed))
    taken = (1 + SPARE) * np.maximum(found, 0.0)
    return [Error(*(shorten(Fraction(part)) for part in row)) for row in taken.tolist()]
