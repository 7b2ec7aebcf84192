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

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.errors import HALF, ZERO, Error, Known
from zerodrift.operations.gate_sums import GateArgument, GateSums, RealUnit, propose_errors, weigh
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.tables import (
    T_MIN,
    SigmoidError,
    bound_sigmoid,
    bound_sigmoid_table,
    bound_slope,
    bound_tanh,
    sigmoid_q31,
)

STEP = Fraction(1, 1 << 30)
"""A step's rounding: half a count of the move, doubled."""
QUARTER = Fraction(1, 4)
TRIES = 40


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
        d = self.update.error.total + weigh(self.update.gains, errors)
        return UpdateMove(d, self.table.share + self.factor * d * (1 + 2 * d))

    def grow(self, errors: Sequence[Fraction]) -> Fraction:
        """Return F(e)."""
        s = self.move(errors).s
        of_update = s * (1 + 2 * s) + 2 * self.table.rest * (1 + s) ** 2
        return self.fixed.total + weigh(self.gains, errors) + self.half * of_update


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
    units = [RealUnit.of(row, gru.inputs, gru.hidden, 3) for row in numbers]
    rules = _Rules(gru, units, features)
    return _solve([rules.bound_growth(i) for i in range(gru.hidden)])


class _Rules(GateSums):
    """The error rules of one layer."""

    def __init__(
        self, gru: IntegerGru, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        super().__init__(gru, units, features)
        self._gru = gru
        self._zero = (ZERO,) * gru.hidden
        self._after = gru.reset == "after"
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
    return propose_errors(rows, fixed)
