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

at the largest f, |g| and I and the smallest u.

The features are the same in both but for an error that is known, and all gates of a step are of the
same ones. So what they can be is halved again and again (`zerodrift.operations.lstm.error`), and
what a step adds is bounded for each part by itself: m is the largest of |I G| / U over the parts, K
and F(e) the largest of what follows for each. At every step the features lie in one of them, and
what is said above of a step needs no more.

|i - I|, |g - G|, |o - O| and d are sums of numbers of the model and multiples of the errors e of
all outputs; so is with them

    F(e) = o K + |o - O| tanh(m) + o (the table's error, and what c is rounded by) + rounding.

e >= F(e) is wanted with F, the largest over the parts, rising: found in floating point, a little
larger, and shown in fractions.

On the way to rest, from 0 under constant features, the cell state moves by a quarter to a half of
its distance from i g / u, which share may be another on the chip than in real arithmetic. But both
come near to the same: to a rest C*, H* of real arithmetic, of which there is one, as H into
O tanh(I G / U) is a continuous map of a ball into itself. By the same sums, with p one's quarter to
half of the way,

    |c' - C*| <= (1 - p) |c - C*| + p K(|h - H*|),

whether it is the chip or, without errors of its own, real arithmetic. K(e + y) is at most K(e) and
y by the largest slopes that any part has. So after all steps of `settle` each is y beyond its
error, which goes through 64 such steps from the largest C* and H* there can be; 2 y is added to
what chip and real arithmetic are apart.

For the stability of LSTMs by the sizes of their weights see Bonassi, Terzi, Farina and Scattolini,
"LSTM neural networks: input to state stability and probabilistic safety verification", 2020, arXiv
1912.04377.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.errors import NONE, ZERO, Error, Known, require
from zerodrift.operations.gate_sums import GateArgument, GateSums, RealUnit, propose_errors, weigh
from zerodrift.operations.intervals import enclose_exp, shorten
from zerodrift.operations.lstm.cell import CELL_LIMIT, IntegerLstm
from zerodrift.operations.recurrent import RELAX_STEPS
from zerodrift.operations.tables import (
    T_MAX,
    SigmoidError,
    bound_sigmoid,
    bound_sigmoid_table,
    bound_slope,
    bound_tanh,
    sigmoid_q31,
)

# Halves what an LSTM's features can be, so that its gates are taken at their worst together.
#
# Any way to halve is sound: at each step the features lie in one of the parts. Which part is halved
# next is chosen in floating point, as docs/reference/error-bound.md states it, so that whoever
# derives the bound again comes to the same parts.

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


# How far a step of one unit of an integer LSTM is from that of real arithmetic.
#
# For the derivation see `zerodrift.operations.lstm.error`.

Moved = Sequence[Fraction]
"""By how much the arguments of i, f, g, o are moved by errors of the outputs."""
ONE, QUARTER = Fraction(1), Fraction(1, 4)
OF_BEND = Fraction(1, 1 << 17)
"""The cell state is rounded to the table's argument, counts of 2**-16."""
OF_OUTPUT = Fraction(1, 1 << 30)
"""o tanh(c) is rounded to counts of 2**-29."""
HIGHEST = 11
"""The largest argument of a forget gate: 1 - F is then above 2**-16, as the way to rest has it."""


@dataclass(frozen=True)
class Gate:
    """How far a gate is off, how much by what its argument is, and the most that it is."""

    error: Error
    slope: Fraction
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
class LstmStepError:
    """What a step of one unit adds to errors while the features lie in one part.

    The errors e of the outputs move the arguments of i, f, g, o by four numbers, which are given.
    """

    own: Error
    """K at e = 0 without the forget gate."""
    of_input: Fraction
    """By how much K grows with what the input gate's argument is moved by."""
    of_candidate: Fraction
    forget: Forget
    size: Fraction
    """The largest |I G| / U."""
    reach: Fraction
    """The largest |C| and |c| that steps within the part lead to, with what is rounded."""
    output: Gate
    after: Error
    """What the table of tanh and the last roundings add."""

    def slip(self, moved: Moved) -> Fraction:
        """Return d."""
        return self.forget.argument.error.total + moved[1]

    def of_forget(self, d: Fraction) -> Fraction:
        """Return s f + t; exp(d) (exp(d) - 1) <= d (1 + 2 d) to d = 1/4."""
        table = self.forget.table
        s = table.share + self.forget.factor * d * (1 + 2 * d)
        return self.forget.of_s * s + table.rest

    def grow_cell(self, moved: Moved, size: Fraction) -> Fraction:
        """Return K(e) for cell states of up to a size."""
        added = self.own.total + self.of_input * moved[0] + self.of_candidate * moved[2]
        return added + size * self.of_forget(self.slip(moved))

    def grow_output(self, moved: Moved, cell: Fraction, bend: Fraction) -> Fraction:
        """Return F(e) for a K(e) and the largest tanh(m)."""
        gate = self.output.error.total + self.output.slope * moved[3]
        return self.output.most * cell + bend * gate + self.after.total


class StepRules(GateSums):
    """The error rules of one layer."""

    def __init__(
        self, lstm: IntegerLstm, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        super().__init__(lstm, units, features)
        self._lstm = lstm
        self._tanh = bound_tanh() / (1 << 30)

    @property
    def most(self) -> Fraction:
        """The largest cell state that its integer holds."""
        return Fraction(CELL_LIMIT, 1 << self._lstm.cell_bits)

    def list_gains(self, j: int) -> tuple[tuple[Fraction, ...], ...]:
        """Return [4][H] how much the argument of i, f, g, o is moved by each output's error."""
        return tuple(tuple(map(abs, row)) for row in self._units[j].w_h)

    def bound_step(self, j: int, features: Sequence[Known]) -> LstmStepError:
        """Return what one step makes of the errors, for unit j and features within a part.

        Raises:
            NoRuleError: a forget gate might come too near to 1.
        """
        i, o = self._bound_gate(0, j, features), self._bound_gate(3, j, features)
        g, forget = self._bound_candidate(j, features), self._bound_forget(j, features)
        rounded = Fraction(2, 1 << self._lstm.cell_bits) + Fraction(1, 1 << 30)
        added = i.error.scale(g.most) + g.error.scale(i.most) + Error(rounding=rounded)
        of_input = shorten(g.most * i.slope / forget.left)
        of_candidate = shorten(i.most * g.slope / forget.left)
        size = shorten(i.most * g.most / forget.left)
        reach = (i.most * g.most + rounded) / forget.left
        after = Error(table=self._tanh, rounding=OF_BEND).scale(o.most) + Error(rounding=OF_OUTPUT)
        own = added.scale(1 / forget.left)
        return LstmStepError(own, of_input, of_candidate, forget, size, reach, o, after)

    def _bound_gate(self, g: int, j: int, features: Sequence[Known]) -> Gate:
        """Return what is known of the input or output gate."""
        a = self._bound_argument(g, j, features=features)
        slope = shorten(bound_slope(a.low / 2, a.high / 2)) / 4
        most = min(shorten(bound_sigmoid(a.high).high + self._tanh / 2), ONE)
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        of_line = bound_sigmoid_table(low, high)
        near_0 = of_line.share * min(most, QUARTER) + of_line.rest * most
        error = a.error.scale(slope) + Error(table=shorten(min(self._tanh / 2, near_0)))
        return Gate(error, slope, most)

    def _bound_candidate(self, j: int, features: Sequence[Known]) -> Gate:
        a = self._bound_argument(2, j, 16, features)
        slope = shorten(bound_slope(a.low, a.high))
        size = max(abs(a.low), abs(a.high))
        most = min(shorten(2 * bound_sigmoid(2 * size).high - 1 + self._tanh), ONE)
        error = a.error.scale(slope) + Error(table=self._tanh)
        return Gate(error, slope, most)

    def _bound_forget(self, j: int, features: Sequence[Known]) -> Forget:
        a = self._bound_argument(1, j, features=features)
        require(
            a.high <= HIGHEST,
            "no contraction of an LSTM is shown: its forget gate comes so near to 1 that it hardly"
            " forgets; [network] contracting = true trains one that stays away from it",
        )
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        largest = int(sigmoid_q31(np.array([min(high, T_MAX)]))[0])
        most = min(shorten(bound_sigmoid(a.high).high + self._tanh / 2), ONE)
        left = Fraction((1 << 31) - largest, 1 << 31)
        table = bound_sigmoid_table(-high, -low)
        return Forget(a, table, most, min(left, bound_sigmoid(-a.high).low))


# Bounds the distance of an integer LSTM's output from that of real arithmetic, for any run length.

TRIES = 40


@dataclass(frozen=True)
class LstmGrowth:
    """What a step makes of the errors e of all outputs, for one unit: F(e), K(e) within it."""

    parts: tuple[LstmStepError, ...]
    """One for each part of what the features can be."""
    gains: tuple[tuple[Fraction, ...], ...]
    """[4][H] how much the argument of i, f, g, o is moved by each error."""
    start: Error = NONE
    """What both may be apart at rest, beyond their error."""

    @cached_property
    def size(self) -> Fraction:
        """m: the largest |C|."""
        return max(part.size for part in self.parts)

    @cached_property
    def bend(self) -> Fraction:
        """tanh(m) or more."""
        return min(2 * bound_sigmoid(2 * self.size).high - 1, ONE)

    @cached_property
    def most(self) -> Fraction:
        """The largest o."""
        return max(part.output.most for part in self.parts)

    def move(self, errors: Sequence[Fraction]) -> Moved:
        """Return by how much errors move the arguments."""
        return [shorten(weigh(row, errors)) for row in self.gains]

    def slip(self, errors: Sequence[Fraction]) -> Fraction:
        """Return the largest d."""
        moved = self.move(errors)
        return max(part.slip(moved) for part in self.parts)

    def grow(self, errors: Sequence[Fraction]) -> Fraction:
        """Return F(e), to d = 1/4."""
        moved = self.move(errors)
        of_cell, of_output = self.find_worst(moved)
        cell = of_cell.grow_cell(moved, self.size)
        return of_output.grow_output(moved, cell, self.bend) + self.start.total

    def find_worst(self, moved: Moved) -> tuple[LstmStepError, LstmStepError]:
        """Return the part with the largest K(e), and that with the largest F(e)."""
        cells = [part.grow_cell(moved, self.size) for part in self.parts]
        cell = max(cells)
        outputs = [part.grow_output(moved, cell, self.bend) for part in self.parts]
        return self.parts[cells.index(cell)], self.parts[outputs.index(max(outputs))]


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
    rules = StepRules(lstm, units, features)
    growths = [
        bound_growth(rules, j, list_parts(lstm, unit, j, features)) for j, unit in enumerate(units)
    ]
    settled = _solve(growths)
    left = _settle(growths, [error.total for error in settled])
    started = [
        replace(growth, start=Error(rounding=2 * (growth.most * c + h)))
        for growth, (c, h) in zip(growths, left, strict=True)
    ]
    errors = _solve(started)
    for error, rest, (_, h) in zip(errors, settled, left, strict=True):
        require(error.total >= rest.total + 2 * h, "the way to rest of a recurrent layer")
    return errors


def bound_growth(rules: StepRules, j: int, parts: Iterable[Sequence[Known]]) -> LstmGrowth:
    """Return what one step makes of the errors, for unit j.

    Args:
        rules: of the layer's steps.
        j: the unit.
        parts: of what the features can be, which cover it.

    Raises:
        NoRuleError: the cell state might saturate, or a forget gate come too near to 1.
    """
    growth = LstmGrowth(tuple(rules.bound_step(j, part) for part in parts), rules.list_gains(j))
    require(
        max(part.reach for part in growth.parts) <= rules.most,
        "no contraction of an LSTM is shown: its cell state may go beyond its integer, where it"
        " is limited; [network] contracting = true trains one that stays within",
    )
    return growth


def list_parts(
    lstm: IntegerLstm, unit: RealUnit, j: int, features: Sequence[Known]
) -> list[list[Known]]:
    """Return the features once for each part of what they can be."""
    gates = []
    for g in range(4):
        count = 2.0 ** -(lstm.shift[g] + (16 if g == 2 else 15))
        weights = [float(w) for w in unit.w_x[g]]
        of_counts = [w * float(x.scale) for w, x in zip(weights, features, strict=True)]
        gaps = [int(w) * count - real for w, real in zip(lstm.w_x[g, j], of_counts, strict=True)]
        bias = float(unit.bias[g])
        states = math.fsum(abs(float(w)) for w in unit.w_h[g])
        off = math.fsum(
            abs(w) * float(x.error.total) for w, x in zip(weights, features, strict=True)
        )
        gap = (int(lstm.bias[g, j]) - (1 << lstm.shift[g] >> 1)) * count - bias
        gates.append(
            FloatGate(bias, tuple(of_counts), states, gap, tuple(gaps), off + states * 2.0**-16)
        )
    boxes = halve(gates, tuple((x.low, x.high) for x in features))
    return [
        [replace(x, low=low, high=high) for x, (low, high) in zip(features, box, strict=True)]
        for box in boxes
    ]


def _solve(growths: Sequence[LstmGrowth]) -> list[Error]:
    """Return errors e >= F(e).

    Raises:
        NoRuleError: there are none, or they are not found.
    """
    errors = [ZERO] * len(growths)
    for _ in range(TRIES):
        proposed = _propose(growths, errors)
        errors = [error.total for error in proposed]
        if any(growth.slip(errors) > QUARTER for growth in growths):
            break
        if all(e >= growth.grow(errors) for e, growth in zip(errors, growths, strict=True)):
            return proposed
    raise NoRuleError("a recurrent layer carries errors on, and they were not shown to stay small")


def _propose(growths: Sequence[LstmGrowth], errors: Sequence[Fraction]) -> list[Error]:
    """Return e = F(e) and a little more, cause by cause.

    F is taken to be straight with the slips d, and of the parts, that given errors have.
    """
    rows, fixed = [], []
    for growth in growths:
        moved = growth.move(errors)
        of_cell, of_output = growth.find_worst(moved)
        forget, output = of_cell.forget, of_output.output
        by_size = output.most * growth.size
        of_d = by_size * forget.of_s * forget.factor * (1 + 2 * of_cell.slip(moved))
        by_gate = (
            output.most * of_cell.of_input,
            of_d,
            output.most * of_cell.of_candidate,
            growth.bend * output.slope,
        )
        rows.append(
            [
                math.fsum(float(by) * float(gain) for by, gain in zip(by_gate, gains, strict=True))
                for gains in zip(*growth.gains, strict=True)
            ]
        )
        table = by_size * (forget.of_s * forget.table.share + forget.table.rest)
        error = of_cell.own.scale(output.most) + output.error.scale(growth.bend)
        error += of_output.after + growth.start + Error(table=table)
        parts = zip(error.parts(), forget.argument.error.parts(), strict=True)
        fixed.append([float(part) + float(of_d) * float(own) for part, own in parts])
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
    most = [2 * growth.most for growth in growths]
    h = [shorten(growth.most * growth.bend) for growth in growths]
    c = [growth.size for growth in growths]
    slopes, gates = [], []
    for growth in growths:
        d = growth.slip([e + y for e, y in zip(errors, most, strict=True)])
        steep = enclose_exp(2 * d).high * 2 - enclose_exp(d).low
        of_f = max(part.forget.of_s * part.forget.factor for part in growth.parts)
        of_f *= growth.size * steep
        of_i = max(part.of_input for part in growth.parts)
        of_g = max(part.of_candidate for part in growth.parts)
        i, f, g, o = growth.gains
        slopes.append(
            [shorten(of_i * a + of_f * b + of_g * c) for a, b, c in zip(i, f, g, strict=True)]
        )
        of_o = max(part.output.slope for part in growth.parts)
        gates.append([of_o * gain for gain in o])
    for _ in range(RELAX_STEPS):
        aims = [weigh(row, h) for row in slopes]
        c = [
            shorten(max((3 * near + aim) / 4, (near + aim) / 2))
            for near, aim in zip(c, aims, strict=True)
        ]
        h = [
            min(end, shorten(growth.most * near + growth.bend * weigh(gate, h)))
            for growth, near, end, gate in zip(growths, c, most, gates, strict=True)
        ]
    return list(zip(c, h, strict=True))
