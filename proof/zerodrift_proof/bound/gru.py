"""Derives the error of a GRU's states again: from the C's numbers and table, and the float layer's.

docs/reference/error-bound.md states the rule. Here the chip's accumulators are taken through as
integers, and the errors are found by elimination. Shares no code with what derived them first and
needs the standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from zerodrift_proof.bound import numbers
from zerodrift_proof.bound.sums import (
    NO_CONTRACTION,
    NONE,
    ONE,
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
from zerodrift_proof.certificate.values import GruNumbers, NotUnderstoodError

SMALL = Fraction(1, 4)
ROUNDS = 60
MORE = 1.0 + 2.0**-30


@dataclass(frozen=True)
class UnitRule:
    """What bounds a unit's next error: the candidate's part, the update gate's, the rounding."""

    candidate: LinearError
    update: LinearError
    share: Fraction
    rest: Fraction
    half: Fraction
    rounding: Fraction

    def slips(self, errors: Sequence[Fraction]) -> tuple[Fraction, Fraction]:
        """Return how far the update gate's argument is off, and the share of u (1 - u) that u is.

        Raises:
            NotUnderstoodError: too far for the rule.
        """
        d = apply(self.update, errors)
        s = self.share + self.factor * d * (1 + 2 * d)
        if d > SMALL or s > SMALL:
            raise NotUnderstoodError("a state may be far off: the update gate's argument is")
        return d, s

    @property
    def factor(self) -> Fraction:
        """(1 + k + r) (1 + k)."""
        return (1 + self.share + self.rest) * (1 + self.share)

    def next(self, errors: Sequence[Fraction]) -> Fraction:
        """Return what bounds the error after a step from these errors, and at rest."""
        _, s = self.slips(errors)
        t = self.rest * (1 + s)
        of_update = 2 * self.half * (t + s * (s + t)) + s * self.half
        return apply(self.candidate, errors) + of_update + self.rounding


def bound_gru(
    c: GruNumbers,
    rows: Sequence[Sequence[Fraction]],
    features: Sequence[FeatureRange],
    lines: Lines,
) -> list[Fraction]:
    """Return how far each state can be off, however many steps were made.

    Args:
        c: what the C holds.
        rows: per unit of the float layer its biases r, u, n, n inside, then weights of the features
            for r, u, n, then those of the state.
        features: what the layer reads.
        lines: the table of tanh.

    Raises:
        NotUnderstoodError: the numbers do not fit, or no contraction is shown.
    """
    check = _GruCheck(c, rows, features, lines)
    return _close([check.unit(j) for j in range(c.hidden)])


class _GruCheck(RowSums):
    def __init__(
        self,
        c: GruNumbers,
        rows: Sequence[Sequence[Fraction]],
        features: Sequence[FeatureRange],
        lines: Lines,
    ) -> None:
        super().__init__(c, rows, features, lines, 3)
        self._gru = c
        self._resets = [self._reset(j) for j in range(c.hidden)]

    def _reset(self, j: int) -> tuple[Fraction, int, LinearError]:
        """Return the largest r of both, of the chip in 2**-31, and how far r is off."""
        a = self.argument(j, 0, 15)
        ends = ends_of(a, 15)
        slope = steepest(ends[0] / 2, ends[1] / 2) / 4
        own = slope * a.off.own + self.tanh_off / 2
        chip = (1 << 30) + self.look_up(a.chip[1])
        most = min(max(enclose_sigmoid(a.real[1])[1], Fraction(chip, 1 << 31)), ONE)
        return most, chip, LinearError(own, tuple(slope * share for share in a.off.shares))

    def _candidate(self, j: int) -> GateSum:
        c, shift = self._gru, self._gru.shifts[2]
        count = Fraction(1, 1 << (16 + shift))
        own, low, high, real = self.of_features(j, 2, count)
        own += Fraction(1, 1 << 17) if shift else NONE
        weights = self.w_h(j, 2)
        most = sum(map(abs, weights), NONE)
        if not c.after:
            of_states, size = self.of_states(j, 2, count)
            own += of_states
            shares = [NONE] * c.hidden
            for k, (weight, (r, _, off)) in enumerate(zip(weights, self._resets, strict=True)):
                own += abs(weight) * off.own
                shares[k] += abs(weight) * r
                for i, share in enumerate(off.shares):
                    shares[i] += abs(weight) * share
            chip = (low - size >> shift, high + size >> shift)
            return GateSum(LinearError(own, tuple(shares)), (real[0] - most, real[1] + most), chip)
        r, r_chip, off = self._resets[j]
        of_states, size = self.of_states(j, 2, count / 2)
        bias, real_bias = c.bias[4 * j + 3], self._rows[j][3]
        # of the bias by its own sign: the sum of the states may have either
        of_states += abs(bias * count / 2 - real_bias)
        largest = abs(real_bias) + most
        own += r * of_states + largest * off.own + count / 2
        both = zip(weights, off.shares, strict=True)
        shares_after = tuple(r * abs(weight) + largest * share for weight, share in both)
        inside = ((bias - size) * r_chip, (bias + size) * r_chip)
        half = 1 << 31
        low += min(inside[0] + half >> 32, 0)
        high += max(inside[1] + half >> 32, 0)
        ends = (
            real[0] + min(r * (real_bias - most), NONE),
            real[1] + max(r * (real_bias + most), NONE),
        )
        return GateSum(LinearError(own, shares_after), ends, (low >> shift, high >> shift))

    def unit(self, j: int) -> UnitRule:
        """Return what bounds the next error of a unit."""
        u, n = self.argument(j, 1, 15), self._candidate(j)
        ends = ends_of(n, 16)
        slope = steepest(*ends)
        real = [enclose_tanh(end) for end in n.real]
        half = (max(real[1][1], NONE) - min(real[0][0], NONE)) / 2
        reach = ends_of(u, 15)
        t_low, t_high = reach[0] * 32768 // 1, -(-reach[1] * 32768 // 1)
        share, rest = numbers.sigmoid_error(self._lines, int(t_low), int(t_high))
        slowest = Fraction((1 << 30) + self.look_up(u.chip[0]), 1 << 31)
        return UnitRule(
            LinearError(
                slope * n.off.own + self.tanh_off,
                tuple(slope * part for part in n.off.shares),
            ),
            u.off,
            share,
            rest,
            half,
            Fraction(1, 1 << 30) / min(slowest, Fraction(1, 2)),
        )


def _close(units: Sequence[UnitRule]) -> list[Fraction]:
    """Return errors that a step does not enlarge."""
    d, s = [NONE] * len(units), [unit.share for unit in units]
    for _ in range(ROUNDS):
        errors = [Fraction(x * MORE) for x in _solve(units, d, s)]
        if any(e <= 0 for e in errors):
            break
        if all(e >= unit.next(errors) for e, unit in zip(errors, units, strict=True)):
            return errors
        slips = [unit.slips(errors) for unit in units]
        d, s = [slip[0] for slip in slips], [slip[1] for slip in slips]
    raise NotUnderstoodError(NO_CONTRACTION)


def _solve(units: Sequence[UnitRule], d: Sequence[Fraction], s: Sequence[Fraction]) -> list[float]:
    """Return about what errors stay the same in a step, by elimination; without such, no matter."""
    rows: list[list[float]] = []
    for i, (unit, d_i, s_i) in enumerate(zip(units, d, s, strict=True)):
        weight = float(unit.half * (1 + 2 * s_i))
        slope = weight * float(unit.factor * (1 + 2 * d_i))
        both = zip(unit.candidate.shares, unit.update.shares, strict=True)
        row = [-float(a) - slope * float(b) for a, b in both]
        row[i] += 1.0
        rest = float(2 * unit.half * unit.rest * (1 + s_i) ** 2)
        own = float(unit.candidate.own + unit.rounding) + rest
        rows.append([*row, own + weight * float(unit.share) + slope * float(unit.update.own)])
    return eliminate(rows)
