"""Bounds the distance of an integer LSTM's output from that of real arithmetic, for any run length.

c, i, f, g, o are the chip's, C, I, F, G, O those of real arithmetic, u = 1 - f and U = 1 - F. With
delta, what a step rounds, a step gives, unit by unit,

    c' - C' = f (c - C) + (U - u) C + (i - I) g + I (g - G) + delta

    h' - H' = o (tanh(c') - tanh(C')) + (o - O) tanh(C') + rounding.

C starts at 0 and moves by U towards I G / U, so that |C| <= m, the most that |I G| / U can be; the
chip's cell state likewise, and where that fits its integer it never saturates. u is an update gate
of the argument -a: as `zerodrift.operations.gru.error` derives,

    |u - U| <= u (s f + t)
    s = k + (1 + k + r) (1 + k) exp(d) (exp(d) - 1)        t = r (1 + s)

for a table off by at most u (k f + r) and arguments at most d apart. Hence |c' - C'| is at most
f |c - C| + u K, and |c - C| <= K stays so at every step, with

    K = m (s f + t) + (|i - I| |g| + I |g - G| + delta) / u

at the largest f, |g| and I and the smallest u. |i - I|, |g - G|, |o - O| and d are sums of numbers
of the model and multiples of the errors e of all outputs; so is with them

    F(e) = o K + |o - O| tanh(m) + o (the table's error, and what c is rounded by) + rounding.

e >= F(e) is wanted with F rising: found in floating point, a little larger, and shown in fractions.

On the way to rest, from 0 under constant features, the cell state moves by a quarter to a half of
its distance from i g / u, which share may be another on the chip than in real arithmetic. But both
come near to the same: to a rest C*, H* of real arithmetic, of which there is one, as H into
O tanh(I G / U) is a continuous map of a ball into itself. By the same sums, with p one's quarter to
half of the way,

    |c' - C*| <= (1 - p) |c - C*| + p K(|h - H*|),

whether it is the chip or, without errors of its own, real arithmetic. So after all steps of
`settle` each is y beyond its error, which goes through 64 such steps from the largest C* and H*
there can be; 2 y is added to what chip and real arithmetic are apart.

For the stability of LSTMs by the sizes of their weights see Bonassi, Terzi, Farina and Scattolini,
"LSTM neural networks: input to state stability and probabilistic safety verification", 2020, arXiv
1912.04377.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.enclosure import enclose_exp, shorten
from zerodrift.operations.errors import NONE, ZERO, Error, Known, require
from zerodrift.operations.gate_sums import (
    GateArgument,
    GateSums,
    RealUnit,
    propose_errors,
    weigh,
)
from zerodrift.operations.gru.cell import RELAX_STEPS
from zerodrift.operations.lstm.cell import CELL_LIMIT, IntegerLstm
from zerodrift.operations.table_error import (
    SigmoidError,
    bound_sigmoid,
    bound_sigmoid_table,
    bound_slope,
    bound_tanh,
)
from zerodrift.operations.tables import T_MAX, sigmoid_q31

ONE, QUARTER, HALF = Fraction(1), Fraction(1, 4), Fraction(1, 2)
OF_BEND = Fraction(1, 1 << 17)
"""The cell state is rounded to the table's argument, counts of 2**-16."""
OF_OUTPUT = Fraction(1, 1 << 30)
"""o tanh(c) is rounded to counts of 2**-29."""
HIGHEST = 11
"""The largest argument of a forget gate: 1 - F is then above 2**-16, as the way to rest has it."""
TRIES = 40


@dataclass(frozen=True)
class Gate:
    """How far a gate is off, how much by each state's error, and the most that it is."""

    error: Error
    gains: tuple[Fraction, ...]
    most: Fraction
    """Of its size, on the chip and in real arithmetic."""


@dataclass(frozen=True)
class Forget:
    """A forget gate: its argument, how far the table of 1 - f is off, the most and least it is."""

    argument: GateArgument
    table: SigmoidError
    most: Fraction
    left: Fraction
    """The least 1 - f, on the chip and in real arithmetic."""

    @property
    def factor(self) -> Fraction:
        """What exp(d) (exp(d) - 1) is multiplied by in s."""
        return (1 + self.table.share + self.table.rest) * (1 + self.table.share)

    @property
    def of_s(self) -> Fraction:
        """s f + t = s (f + r) + r."""
        return self.most + self.table.rest


@dataclass(frozen=True)
class LstmGrowth:
    """What a step makes of the errors e of all outputs, for one unit: F(e), K(e) within it."""

    own: Error
    """K at e = 0 without the forget gate."""
    gains: tuple[Fraction, ...]
    """[H] of K, without the forget gate."""
    forget: Forget
    size: Fraction
    """m: the largest |C|."""
    output: Gate
    bend: Fraction
    """tanh(m) or more."""
    after: Error
    """What the table of tanh and the last roundings add."""
    start: Error = NONE
    """What both may be apart at rest, beyond their error."""

    @property
    def fixed(self) -> Error:
        """F at e = 0 without the forget gate."""
        own = self.own.scale(self.output.most) + self.output.error.scale(self.bend)
        return own + self.after + self.start

    def slip(self, errors: Sequence[Fraction]) -> Fraction:
        """Return d."""
        argument = self.forget.argument
        return argument.error.total + weigh(argument.gains, errors)

    def grow(self, errors: Sequence[Fraction]) -> Fraction:
        """Return F(e); exp(d) (exp(d) - 1) <= d (1 + 2 d) to d = 1/4."""
        d, forget = self.slip(errors), self.forget
        s = forget.table.share + forget.factor * d * (1 + 2 * d)
        of_forget = self.output.most * self.size * (forget.of_s * s + forget.table.rest)
        through_cell = self.output.most * weigh(self.gains, errors)
        through_gate = self.bend * weigh(self.output.gains, errors)
        return self.fixed.total + through_cell + through_gate + of_forget


def bound_states(
    lstm: IntegerLstm, numbers: Sequence[Sequence[float]], features: Sequence[Known]
) -> list[Error]:
    """Return the error of every output.

    Args:
        lstm: the layer.
        numbers: per unit those of the float layer; see `RealUnit.of`.
        features: what is known of its int16 inputs.

    Raises:
        NoRuleError: no contraction is shown.
    """
    units = [RealUnit.of(row, lstm.inputs, lstm.hidden, 4) for row in numbers]
    rules = _LstmRules(lstm, units, features)
    growths = [rules.bound_growth(j) for j in range(lstm.hidden)]
    settled = _solve(growths)
    left = _settle(growths, [error.total for error in settled])
    started = [
        replace(growth, start=Error(rounding=2 * (growth.output.most * c + h)))
        for growth, (c, h) in zip(growths, left, strict=True)
    ]
    errors = _solve(started)
    for error, rest, (_, h) in zip(errors, settled, left, strict=True):
        require(error.total >= rest.total + 2 * h, "the way to rest of a recurrent layer")
    return errors


class _LstmRules(GateSums):
    """The error rules of one layer."""

    def __init__(
        self, lstm: IntegerLstm, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        super().__init__(lstm, units, features)
        self._lstm = lstm
        self._tanh = bound_tanh() / (1 << 30)

    def bound_growth(self, j: int) -> LstmGrowth:
        """Return what one step makes of the errors, for unit j.

        Raises:
            NoRuleError: the cell state might saturate, or a forget gate come too near to 1.
        """
        i, o, g = self._bound_gate(0, j), self._bound_gate(3, j), self._bound_candidate(j)
        forget = self._bound_forget(j)
        count = Fraction(1, 1 << self._lstm.cell_bits)
        rounded = 2 * count + Fraction(1, 1 << 30)
        added = i.error.scale(g.most) + g.error.scale(i.most) + Error(rounding=rounded)
        gains = tuple(
            shorten((g.most * of_i + i.most * of_g) / forget.left)
            for of_i, of_g in zip(i.gains, g.gains, strict=True)
        )
        reach = (i.most * g.most + rounded) / forget.left
        require(
            reach <= CELL_LIMIT * count,
            "no contraction of an LSTM is shown: its cell state may go beyond its integer, where it"
            " is limited; [network] contracting = true trains one that stays within",
        )
        size = shorten(i.most * g.most / forget.left)
        bend = min(2 * bound_sigmoid(2 * size).high - 1, ONE)
        after = Error(table=self._tanh, rounding=OF_BEND).scale(o.most) + Error(rounding=OF_OUTPUT)
        return LstmGrowth(added.scale(1 / forget.left), gains, forget, size, o, bend, after)

    def _bound_gate(self, g: int, j: int) -> Gate:
        """Return what is known of the input or output gate."""
        a = self._bound_argument(g, j)
        slope = bound_slope(a.low / 2, a.high / 2) / 4
        most = min(bound_sigmoid(a.high).high + self._tanh / 2, ONE)
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        of_line = bound_sigmoid_table(low, high)
        near_0 = of_line.share * min(most, QUARTER) + of_line.rest * most
        error = a.error.scale(slope) + Error(table=shorten(min(self._tanh / 2, near_0)))
        return Gate(error, tuple(slope * gain for gain in a.gains), most)

    def _bound_candidate(self, j: int) -> Gate:
        a = self._bound_argument(2, j, bits=16)
        slope = bound_slope(a.low, a.high)
        size = max(abs(a.low), abs(a.high))
        most = min(2 * bound_sigmoid(2 * size).high - 1 + self._tanh, ONE)
        error = a.error.scale(slope) + Error(table=self._tanh)
        return Gate(error, tuple(slope * gain for gain in a.gains), most)

    def _bound_forget(self, j: int) -> Forget:
        a = self._bound_argument(1, j)
        require(
            a.high <= HIGHEST,
            "no contraction of an LSTM is shown: its forget gate comes so near to 1 that it hardly"
            " forgets; [network] contracting = true trains one that stays away from it",
        )
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        largest = int(sigmoid_q31(np.array([min(high, T_MAX)]))[0])
        most = min(bound_sigmoid(a.high).high + self._tanh / 2, ONE)
        left = Fraction((1 << 31) - largest, 1 << 31)
        table = bound_sigmoid_table(-high, -low)
        return Forget(a, table, most, min(left, bound_sigmoid(-a.high).low))


def _solve(growths: Sequence[LstmGrowth]) -> list[Error]:
    """Return errors e >= F(e).

    Raises:
        NoRuleError: there are none, or they are not found.
    """
    slips = [ZERO] * len(growths)
    for _ in range(TRIES):
        proposed = _propose(growths, slips)
        errors = [error.total for error in proposed]
        slips = [growth.slip(errors) for growth in growths]
        if any(d > QUARTER for d in slips):
            break
        if all(e >= growth.grow(errors) for e, growth in zip(errors, growths, strict=True)):
            return proposed
    raise NoRuleError("a recurrent layer carries errors on, and they were not shown to stay small")


def _propose(growths: Sequence[LstmGrowth], slips: Sequence[Fraction]) -> list[Error]:
    """Return e = F(e) and a little more, F being straight with the given d, cause by cause."""
    rows, fixed = [], []
    for growth, d in zip(growths, slips, strict=True):
        forget, table = growth.forget, growth.forget.table
        of_cell = growth.output.most * growth.size
        of_d = float(of_cell * forget.of_s * forget.factor * (1 + 2 * d))
        through = zip(growth.gains, growth.output.gains, forget.argument.gains, strict=True)
        rows.append(
            [
                float(growth.output.most * of_c + growth.bend * of_o) + of_d * float(of_f)
                for of_c, of_o, of_f in through
            ]
        )
        error = growth.fixed + Error(table=of_cell * (forget.of_s * table.share + table.rest))
        parts = zip(error.parts(), forget.argument.error.parts(), strict=True)
        fixed.append([float(part) + of_d * float(own) for part, own in parts])
    return propose_errors(rows, fixed)


def _settle(
    growths: Sequence[LstmGrowth], errors: Sequence[Fraction]
) -> list[tuple[Fraction, Fraction]]:
    """Return how far cell state and output are from rest after `settle`, beyond their errors.

    Args:
        growths: of the units.
        errors: e >= F(e).

    K(e + y) <= K(e) + slopes y, with the slope of exp(d) (exp(d) - 1) at the largest d. No two
    outputs are further apart than twice the most that they can be.
    """
    most = [2 * growth.output.most for growth in growths]
    h = [shorten(growth.output.most * growth.bend) for growth in growths]
    c = [growth.size for growth in growths]
    slopes = []
    for growth in growths:
        d = growth.slip([e + y for e, y in zip(errors, most, strict=True)])
        steep = enclose_exp(2 * d).high * 2 - enclose_exp(d).low
        of_d = growth.size * growth.forget.of_s * growth.forget.factor * steep
        both = zip(growth.gains, growth.forget.argument.gains, strict=True)
        slopes.append([shorten(of_c + of_d * of_f) for of_c, of_f in both])
    for _ in range(RELAX_STEPS):
        aims = [weigh(row, h) for row in slopes]
        c = [
            shorten(max((3 * near + aim) / 4, (near + aim) / 2))
            for near, aim in zip(c, aims, strict=True)
        ]
        h = [
            min(
                end,
                shorten(growth.output.most * near + growth.bend * weigh(growth.output.gains, h)),
            )
            for growth, near, end in zip(growths, c, most, strict=True)
        ]
    return list(zip(c, h, strict=True))
