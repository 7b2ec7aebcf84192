"""Derives the error of a GRU's states again: from the C's numbers and table, and the float layer's.

How far the sums of a recurrent layer's gates are off, for the second derivation of its error.

The chip's accumulators are taken through as integers. Shares no code with what derived them first
and needs the standard library only.

docs/reference/error-bound.md states the rule. Here the chip's accumulators are taken through as
integers, and the errors are found by elimination. Shares no code with what derived them first and
needs the standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from zerodrift_proof.bound import numbers
from zerodrift_proof.certificate.values import GruNumbers, LayerNumbers, NotUnderstoodError

NONE, ONE = Fraction(0), Fraction(1)
COPY_MOST = 32767
T_LOWEST, T_HIGHEST = -(1 << 19), (1 << 19) - 1
NO_CONTRACTION = "no contraction of the recurrent layer is shown"
Lines = tuple[tuple[int, int], ...]
Ends = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class FeatureRange:
    """A feature: its integers, what one counts, how far it is off."""

    low: int
    high: int
    scale: Fraction
    error: Fraction


@dataclass(frozen=True)
class LinearError:
    """own + sum of share times the states' errors."""

    own: Fraction
    shares: tuple[Fraction, ...]


@dataclass(frozen=True)
class GateSum:
    """A gate's argument: how far the chip's is off, and where both are."""

    off: LinearError
    real: Ends
    chip: tuple[int, int]
    """The table's argument t."""


class RowSums:
    """The sums of one layer."""

    def __init__(
        self,
        c: LayerNumbers,
        rows: Sequence[Sequence[Fraction]],
        features: Sequence[FeatureRange],
        lines: Lines,
        gates: int,
    ) -> None:
        """Take what is summed.

        Args:
            c: what the C holds.
            rows: per unit of the float layer four biases, weights of the features gate by gate,
                then those of the state.
            features: what the layer reads.
            lines: the table of tanh.
            gates: of a unit.

        Raises:
            NotUnderstoodError: the numbers do not fit.
        """
        width = 4 + gates * (c.inputs + c.hidden)
        if len(features) != c.inputs or [len(row) for row in rows] != [width] * c.hidden:
            raise NotUnderstoodError("the float layer has another size than the C's")
        self._c, self._rows, self._features, self._gates = c, rows, features, gates
        self._lines = lines
        self._of_states: dict[tuple[int, int], tuple[Fraction, int]] = {}
        self.tanh_off = numbers.cached_tanh_error(lines) / (1 << 30)

    def w_x(self, j: int, g: int) -> Sequence[Fraction]:
        """Return the float layer's weights of the features."""
        first = 4 + g * self._c.inputs
        return self._rows[j][first : first + self._c.inputs]

    def w_h(self, j: int, g: int) -> Sequence[Fraction]:
        """Return those of the states."""
        first = 4 + self._gates * self._c.inputs + g * self._c.hidden
        return self._rows[j][first : first + self._c.hidden]

    def look_up(self, t: int) -> int:
        """Return 2**30 tanh as the table has it."""
        place = min(max(t, T_LOWEST), T_HIGHEST) - T_LOWEST
        first, last = self._lines[place >> 11]
        return first + (last - first) // 2047 * (place & 2047)

    def of_features(
        self, j: int, g: int, count: Fraction, features: Sequence[FeatureRange] | None = None
    ) -> tuple[Fraction, int, int, Ends]:
        """Return what the features' sum and the bias are off by, their integers, and real ends."""
        c, shift = self._c, self._c.shifts[g]
        row = self._gates * j + g
        whole = c.w_x[row * c.inputs : (row + 1) * c.inputs]
        bias = c.bias[4 * j + g]
        low = high = bias
        gap_low = gap_high = (bias - (1 << shift >> 1)) * count - self._rows[j][g]
        off, real = NONE, [self._rows[j][g]] * 2
        for w, real_w, x in zip(whole, self.w_x(j, g), features or self._features, strict=True):
            ends = sorted((w * x.low, w * x.high))
            low, high = low + ends[0], high + ends[1]
            gap = w * count - real_w * x.scale
            gaps = sorted((gap * x.low, gap * x.high))
            gap_low, gap_high = gap_low + gaps[0], gap_high + gaps[1]
            off += abs(real_w) * x.error
            around = (x.low * x.scale - x.error, x.high * x.scale + x.error)
            products = sorted(real_w * end for end in around)
            real = [real[0] + products[0], real[1] + products[1]]
        return off + max(abs(gap_low), abs(gap_high)), low, high, (real[0], real[1])

    def of_states(self, j: int, g: int, count: Fraction) -> tuple[Fraction, int]:
        """Return what the states' sum is off by but for their own errors, and its largest size."""
        c, row = self._c, self._gates * j + g
        whole = c.w_h[row * c.hidden : (row + 1) * c.hidden]
        size = sum(map(abs, whole)) * COPY_MOST
        each, off = count, NONE
        if c.multipliers:
            multiplier, shift = c.multipliers[row], c.multiplier_shifts[g]
            each = count * multiplier / (1 << shift)
            size = (size * abs(multiplier) + (1 << shift >> 1) >> shift) + 1
            off = count / 2 if shift else NONE
        for w, real_w in zip(whole, self.w_h(j, g), strict=True):
            off += abs(w * each - real_w / 32768) * COPY_MOST + abs(real_w) / 65536
        return off, size

    def argument(
        self, j: int, g: int, bits: int, features: Sequence[FeatureRange] | None = None
    ) -> GateSum:
        """Return the argument of a gate that is one sum, the table's t counting 2**-bits.

        Args:
            j: the unit.
            g: its gate.
            bits: of the table's argument.
            features: a part of what they can be, or else all.
        """
        shift = self._c.shifts[g]
        count = Fraction(1, 1 << (bits + shift))
        own, low, high, real = self.of_features(j, g, count, features)
        if (j, g) not in self._of_states:
            self._of_states[j, g] = self.of_states(j, g, count)
        of_states, size = self._of_states[j, g]
        own += of_states + (Fraction(1, 1 << (bits + 1)) if shift else NONE)
        shares = tuple(map(abs, self.w_h(j, g)))
        most = sum(shares, NONE)
        chip = (low - size >> shift, high + size >> shift)
        return GateSum(LinearError(own, shares), (real[0] - most, real[1] + most), chip)


def apply(off: LinearError, errors: Sequence[Fraction]) -> Fraction:
    """Return how far off it is with these errors of the states."""
    return off.own + sum((a * e for a, e in zip(off.shares, errors, strict=True)), NONE)


def ends_of(a: GateSum, bits: int) -> Ends:
    """Return where both arguments are, the table's t counting 2**-bits."""
    chip = [Fraction(t, 1 << bits) for t in a.chip]
    return min(a.real[0], chip[0]), max(a.real[1], chip[1])


def enclose_sigmoid(x: Fraction) -> Ends:
    """Return numbers below and above the sigmoid."""
    e = numbers.exp(-min(max(x, Fraction(-100)), Fraction(100)))
    if abs(x) > 100:
        return (NONE, 1 / (1 + e[0])) if x < 0 else (1 / (1 + e[1]), ONE)
    return 1 / (1 + e[1]), 1 / (1 + e[0])


def enclose_tanh(x: Fraction) -> Ends:
    """Return numbers below and above tanh."""
    low, high = enclose_sigmoid(2 * x)
    return 2 * low - 1, 2 * high - 1


def steepest(low: Fraction, high: Fraction) -> Fraction:
    """Return the largest slope of tanh from low to high."""
    nearest = NONE if low <= 0 <= high else min(abs(low), abs(high), Fraction(32))
    e = numbers.exp(2 * nearest)[0] if nearest else ONE
    return 4 * e / (1 + e) ** 2


def eliminate(rows: list[list[float]]) -> list[float]:
    """Return the solution of equations [A | b], the diagonal of A outweighing its rows.

    Raises:
        NotUnderstoodError: it does not, as errors may grow.
    """
    for i, pivot in enumerate(rows):  # no exchange needed
        if pivot[i] <= 0.0:
            raise NotUnderstoodError(NO_CONTRACTION)
        for row in rows:
            if row is not pivot and row[i]:
                factor = row[i] / pivot[i]
                for k in range(i, len(row)):
                    row[k] -= factor * pivot[k]
    return [row[-1] / row[i] for i, row in enumerate(rows)]


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
