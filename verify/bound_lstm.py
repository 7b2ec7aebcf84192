"""Derives the error of an LSTM's outputs again: from the C's numbers and table, and the float ones.

docs/reference/error-bound.md states the rule. Here the chip's accumulators are taken through as
integers, the errors are found by elimination, and the way to rest is gone in integers. Shares no
code with what derived them first and needs the standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

from zerodrift.verify import bound_numbers as numbers
from zerodrift.verify.bound_sums import (
    NO_CONTRACTION,
    NONE,
    FeatureRange,
    GateSum,
    LinearError,
    Lines,
    RowSums,
    apply,
    eliminate,
    enclose_sigmoid,
    enclose_tanh,
    ends_of,
    steepest,
)
from zerodrift.verify.c_values import LstmNumbers, NotUnderstoodError

QUARTER = Fraction(1, 4)
ROUNDS = 60
MORE = 1.0 + 2.0**-30
SETTLING = 64
"""Steps towards rest."""
NEAREST = 11
"""To which the argument of a forget gate may go: 2^-16 < 1 - F."""
UNIT = 1 << 60
"""On the way to rest distances are counted in 2^-60."""


@dataclass(frozen=True)
class LstmGate:
    """A gate: how far the chip's is off, and the most that it is in size, of both."""

    off: LinearError
    top: Fraction


@dataclass(frozen=True)
class LstmUnitRule:
    """What bounds a unit's next error."""

    i: LstmGate
    g: LstmGate
    o: LstmGate
    forget: LinearError
    """Of the argument."""
    share: Fraction
    rest: Fraction
    kept: Fraction
    """The largest f."""
    lost: Fraction
    """The smallest 1 - f."""
    rounding: Fraction
    """Of the cell state in a step."""
    bend: Fraction
    """What tanh(c) is off by, but for c's own error."""

    @cached_property
    def cell(self) -> Fraction:
        """The largest |C|."""
        return self.i.top * self.g.top / self.lost

    @cached_property
    def bent(self) -> Fraction:
        """The largest |tanh C|."""
        return enclose_tanh(self.cell)[1]

    def slip(self, errors: Sequence[Fraction]) -> Fraction:
        """Return how far the forget gate's argument is off."""
        return apply(self.forget, errors)

    @cached_property
    def of_slip(self) -> Fraction:
        """What the cell state is off for each exp(d) (exp(d) - 1) of a slip d."""
        k, r = self.share, self.rest
        return self.cell * (self.kept + r) * (1 + k + r) * (1 + k)

    def next_cell(self, errors: Sequence[Fraction]) -> Fraction:
        """Return what the cell state is off by at most, however many steps were made.

        Raises:
            NotUnderstoodError: too far for the rule.
        """
        d = self.slip(errors)
        if d > QUARTER:
            raise NotUnderstoodError("a state may be far off: the forget gate's argument is")
        added = apply(self.i.off, errors) * self.g.top + apply(self.g.off, errors) * self.i.top
        of_table = self.cell * ((self.kept + self.rest) * self.share + self.rest)
        return (added + self.rounding) / self.lost + of_table + self.of_slip * d * (1 + 2 * d)

    def next(self, errors: Sequence[Fraction]) -> Fraction:
        """Return what bounds the error of the output after a step from these errors."""
        of_output = apply(self.o.off, errors) * self.bent
        return self.o.top * (self.next_cell(errors) + self.bend) + of_output + Fraction(1, 1 << 30)


def bound_lstm(
    c: LstmNumbers,
    rows: Sequence[Sequence[Fraction]],
    features: Sequence[FeatureRange],
    lines: Lines,
) -> list[Fraction]:
    """Return how far each output can be off, however many steps were made.

    Args:
        c: what the C holds.
        rows: per unit of the float layer its biases i, f, g, o, then weights of the features for
            these, then those of the output.
        features: what the layer reads.
        lines: the table of tanh.

    Raises:
        NotUnderstoodError: the numbers do not fit, or no contraction is shown.
    """
    check = _LstmCheck(c, rows, features, lines)
    units = [check.unit(j) for j in range(c.hidden)]
    without = [NONE] * c.hidden
    at_rest = _close(units, without)
    ways = _go_to_rest(units, at_rest)
    starts = [2 * (unit.o.top * cell + h) for unit, (cell, h) in zip(units, ways, strict=True)]
    errors = _close(units, starts)
    for e, rest, (_, h) in zip(errors, at_rest, ways, strict=True):
        if e < rest + 2 * h:
            raise NotUnderstoodError("the recurrent layer's way to rest")
    return errors


class _LstmCheck(RowSums):
    def __init__(
        self,
        c: LstmNumbers,
        rows: Sequence[Sequence[Fraction]],
        features: Sequence[FeatureRange],
        lines: Lines,
    ) -> None:
        super().__init__(c, rows, features, lines, 4)
        self._cell_bits = c.cell_bits

    def unit(self, j: int) -> LstmUnitRule:
        """Return what bounds the next error of a unit.

        Raises:
            NotUnderstoodError: a rule does not hold.
        """
        i, g, o = self._gate(j, 0), self._candidate(j), self._gate(j, 3)
        f = self.argument(j, 1, 15)
        if ends_of(f, 15)[1] > NEAREST:
            raise NotUnderstoodError("the forget gate comes near to 1")
        low, high = self._arguments(f)
        share, rest = numbers.sigmoid_error(self._lines, -high, -low)
        chip = Fraction((1 << 30) + self.look_up(f.chip[1]), 1 << 31)
        real = enclose_sigmoid(-f.real[1])[0]
        rounding = Fraction(2, 1 << self._cell_bits) + Fraction(1, 1 << 30)
        rule = LstmUnitRule(
            i,
            g,
            o,
            f.off,
            share,
            rest,
            max(chip, 1 - real),
            min(1 - chip, real),
            rounding,
            self.tanh_off + Fraction(1, 1 << 17),
        )
        if rule.cell + rounding / rule.lost > Fraction(1 << 30, 1 << self._cell_bits):
            raise NotUnderstoodError("the cell state may be limited")
        return rule

    def _arguments(self, a: GateSum) -> tuple[int, int]:
        """Return the first and last argument of the table, of the chip and of real arithmetic."""
        ends = ends_of(a, 15)
        return int(ends[0] * 32768 // 1), int(-(-ends[1] * 32768 // 1))

    def _gate(self, j: int, g: int) -> LstmGate:
        a = self.argument(j, g, 15)
        ends = ends_of(a, 15)
        slope = steepest(ends[0] / 2, ends[1] / 2) / 4
        chip = Fraction((1 << 30) + self.look_up(a.chip[1]), 1 << 31)
        share, rest = numbers.sigmoid_error(self._lines, *self._arguments(a))
        # table (share (1 - table) + rest), at the largest table (1 - table) there can be
        of_table = min(self.tanh_off / 2, share * min(chip, QUARTER) + rest * chip)
        off = LinearError(slope * a.off.own + of_table, tuple(slope * x for x in a.off.shares))
        return LstmGate(off, max(chip, enclose_sigmoid(a.real[1])[1]))

    def _candidate(self, j: int) -> LstmGate:
        a = self.argument(j, 2, 16)
        slope = steepest(*ends_of(a, 16))
        chip = Fraction(max(abs(self.look_up(t)) for t in a.chip), 1 << 30)
        real = max(abs(end) for x in a.real for end in enclose_tanh(x))
        shares = tuple(slope * x for x in a.off.shares)
        return LstmGate(LinearError(slope * a.off.own + self.tanh_off, shares), max(chip, real))


def _close(units: Sequence[LstmUnitRule], starts: Sequence[Fraction]) -> list[Fraction]:
    """Return errors that a step does not enlarge, with what is added to each.

    Raises:
        NotUnderstoodError: there are none.
    """
    d = [NONE] * len(units)
    for _ in range(ROUNDS):
        errors = [Fraction(x * MORE) for x in _solve(units, starts, d)]
        if any(e <= 0 for e in errors):
            break
        after = [unit.next(errors) + start for unit, start in zip(units, starts, strict=True)]
        if all(e >= x for e, x in zip(errors, after, strict=True)):
            return errors
        d = [unit.slip(errors) for unit in units]
    raise NotUnderstoodError(NO_CONTRACTION)


def _solve(
    units: Sequence[LstmUnitRule], starts: Sequence[Fraction], slips: Sequence[Fraction]
) -> list[float]:
    """Return about what errors stay the same in a step; without such, no matter."""
    rows, still = [], [NONE] * len(units)
    for j, (unit, start, d) in enumerate(zip(units, starts, slips, strict=True)):
        own = float(unit.next(still) + start)
        of_i = unit.o.top * unit.g.top / unit.lost
        of_g = unit.o.top * unit.i.top / unit.lost
        of_f = unit.o.top * unit.of_slip
        alone = unit.slip(still)
        own += float(of_f * alone * 2 * (d - alone))
        shares = (unit.i.off, unit.g.off, unit.o.off, unit.forget)
        gains = tuple(map(float, (of_i, of_g, unit.bent, of_f * (1 + 2 * d))))
        row = [
            -sum(gain * float(off.shares[k]) for gain, off in zip(gains, shares, strict=True))
            for k in range(len(units))
        ]
        row[j] += 1.0
        rows.append([*row, own])
    return eliminate(rows)


def _go_to_rest(
    units: Sequence[LstmUnitRule], errors: Sequence[Fraction]
) -> list[tuple[Fraction, Fraction]]:
    """Return how far a unit's cell state and output are from rest at last, beyond their errors.

    A step takes the cell state by a quarter to a half to where the outputs draw it. The slope of
    exp(d) (exp(d) - 1), 2 exp(2 d) - exp(d), is that of outputs as far apart as they can be.
    """
    pulls, outputs = list[list[int]](), list[list[int]]()
    furthest = [2 * unit.o.top for unit in units]
    for unit in units:
        d = unit.slip([e + far for e, far in zip(errors, furthest, strict=True)])
        of_f = unit.of_slip * (2 * numbers.exp(2 * d)[1] - numbers.exp(d)[0])
        of_i, of_g = unit.g.top / unit.lost, unit.i.top / unit.lost
        three = zip(unit.i.off.shares, unit.g.off.shares, unit.forget.shares, strict=True)
        pulls.append([_count(of_i * a + of_g * b + of_f * c) for a, b, c in three])
        outputs.append([_count(unit.bent * share) for share in unit.o.off.shares])
    tops = [_count(unit.o.top) for unit in units]
    cells = [_count(unit.cell) for unit in units]
    hs = [_count(unit.o.top * unit.bent) for unit in units]
    for _ in range(SETTLING):
        drawn = [_product(row, hs) for row in pulls]
        cells = [
            max(-(-(3 * cell + to) // 4), -(-(cell + to) // 2))
            for cell, to in zip(cells, drawn, strict=True)
        ]
        hs = [
            min(2 * top, _product([top], [cell]) + _product(row, hs))
            for top, cell, row in zip(tops, cells, outputs, strict=True)
        ]
    return [(Fraction(cell, UNIT), Fraction(h, UNIT)) for cell, h in zip(cells, hs, strict=True)]


def _count(x: Fraction) -> int:
    """Return x >= 0 in whole units, or a little more."""
    return -int(-x * UNIT // 1)


def _product(a: Sequence[int], b: Sequence[int]) -> int:
    """Return the sum of products in units, rounded up."""
    return -(-sum(x * y for x, y in zip(a, b, strict=True)) // UNIT)
