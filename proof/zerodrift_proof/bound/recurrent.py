"""Derives the errors of recurrent layers again: of a GRU's states and of an LSTM's outputs.

From the C's numbers and table, and the float layer's. docs/reference/error-bound.md states the
rules. The chip's accumulators are taken through as integers, and the errors are found by
elimination. Shares no code with what derived them first and needs the standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import exp, tanh

from zerodrift_proof.bound import numbers
from zerodrift_proof.certificate.values import (
    GruNumbers,
    LayerNumbers,
    LstmNumbers,
    NotUnderstoodError,
)

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


# Derives the error of an LSTM's outputs again: from the C's numbers and table, and the float ones.
#
# The parts of what an LSTM's features can be, over each of which its error is bounded by itself.
#
# docs/reference/error-bound.md states which part is halved next; the bound holds whatever they are,
# as long as they cover all. Shares no code with what derived the bound first and needs the standard
# library only.
#
# docs/reference/error-bound.md states the rule. Here the chip's accumulators are taken through as
# integers, the errors are found by elimination, and the way to rest is gone in integers. Shares no
# code with what derived them first and needs the standard library only.

Part = list[tuple[int, int]]
"""The first and last integer of every feature."""

CUTS = 48
FAR = 40.0


@dataclass(frozen=True)
class GateLine:
    """What a gate's argument is of, in floating point."""

    bias: float
    slopes: list[float]
    """Of each feature's integers, in real arithmetic."""
    around: float
    """What the states move it by at most, to either side."""
    wrong: float
    """By how much the chip's bias is larger."""
    wrongs: list[float]
    """By how much its slopes are."""
    apart: float
    """What else the two are apart by."""


@dataclass(frozen=True)
class Badness:
    """Of a part: what its steps lead to, roughly."""

    size: float
    added: float
    per_size: float
    top: float
    of_top: float


def list_parts(lines: Sequence[GateLine], whole: Part) -> list[Part]:
    """Return parts that together are the whole.

    Args:
        lines: of the gates i, f, g, o.
        whole: what the features can be.
    """
    found: list[tuple[Part, Badness]] = [(whole, _rate(lines, whole))]
    for cut in range(CUTS):
        turn = cut % 6
        size = max(bad.size for _, bad in found)
        if turn == 0:
            rated = [bad.size for _, bad in found]
        else:
            rated = [bad.added + bad.per_size * size for _, bad in found]
        if turn == 3:
            highest = max(rated)
            rated = [bad.top * highest + bad.of_top for _, bad in found]
        place = rated.index(max(rated))
        part, _ = found.pop(place)
        moving = lines[3:] if turn == 3 else lines[:3]
        for half in reversed(_halve(moving, part)):
            found.insert(place, (half, _rate(lines, half)))
    return [part for part, _ in found]


def _halve(lines: Sequence[GateLine], part: Part) -> list[Part]:
    """Return both halves by the feature that the arguments differ most by."""
    widths = [
        (last - first) * sum(abs(line.slopes[k]) for line in lines)
        for k, (first, last) in enumerate(part)
    ]
    k = widths.index(max(widths))
    first, last = part[k]
    if first == last:
        return [part]
    lower, upper = list(part), list(part)
    lower[k], upper[k] = (first, (first + last) // 2), ((first + last) // 2 + 1, last)
    return [lower, upper]


def _rate(lines: Sequence[GateLine], part: Part) -> Badness:
    ends, offs = [], []
    for line in lines:
        products = [sorted((w * a, w * b)) for w, (a, b) in zip(line.slopes, part, strict=True)]
        low, high = line.bias - line.around, line.bias + line.around
        ends.append((low + sum(p[0] for p in products), high + sum(p[1] for p in products)))
        gaps = [sorted((w * a, w * b)) for w, (a, b) in zip(line.wrongs, part, strict=True)]
        down, up = (line.wrong + sum(gap[k] for gap in gaps) for k in (0, 1))
        offs.append(max(abs(down), abs(up)) + line.apart)
    through = 1.0 + exp(min(ends[1][1], FAR))
    input_top, candidate_top = _sigmoid(ends[0][1]), max(abs(tanh(end)) for end in ends[2])
    input_off = _steepest(ends[0], 0.5) / 4.0 * offs[0] + 2.0**-15
    candidate_off = _steepest(ends[2], 1.0) * offs[2] + 2.0**-14
    return Badness(
        through * input_top * candidate_top,
        through * (input_top * candidate_off + candidate_top * input_off),
        offs[1] + 2.0**-14,
        _sigmoid(ends[3][1]),
        _steepest(ends[3], 0.5) / 4.0 * offs[3],
    )


def _sigmoid(x: float) -> float:
    return 1.0 / (1.0 + exp(min(-x, FAR)))


def _steepest(ends: tuple[float, float], share: float) -> float:
    nearest = max(ends[0] * share, -ends[1] * share, 0.0)
    return 1.0 - tanh(nearest) ** 2


QUARTER = Fraction(1, 4)
SETTLING = 64
"""Steps towards rest."""
NEAREST = 11
"""To which the argument of a forget gate may go: 2^-16 < 1 - F."""
UNIT = 1 << 60
"""On the way to rest distances are counted in 2^-60."""


@dataclass(frozen=True)
class LstmGate:
    """A gate: how far the chip's is off, and the most that it is in size, of both."""

    off: Fraction
    """Without errors of the outputs."""
    slope: Fraction
    """What more for each 1 that these move its argument by."""
    top: Fraction


@dataclass(frozen=True)
class LstmPartRule:
    """What bounds a unit's next error while the features lie in one part."""

    i: LstmGate
    g: LstmGate
    o: LstmGate
    forget: Fraction
    """How far its argument is off, without errors of the outputs."""
    share: Fraction
    rest: Fraction
    kept: Fraction
    """The largest f."""
    lost: Fraction
    """The smallest 1 - f."""
    rounding: Fraction
    """Of the cell state in a step."""

    @cached_property
    def cell(self) -> Fraction:
        """What |C| is drawn to at most."""
        return _up(self.i.top * self.g.top / self.lost)

    @cached_property
    def reach(self) -> Fraction:
        """What the cell states are drawn to at most, with what is rounded."""
        return (self.i.top * self.g.top + self.rounding) / self.lost

    @cached_property
    def of_slip(self) -> Fraction:
        """What a cell state of 1 is off for each exp(d) (exp(d) - 1) of a slip d."""
        k, r = self.share, self.rest
        return _up((self.kept + r) * (1 + k + r) * (1 + k))

    @cached_property
    def added(self) -> Fraction:
        """What a step adds to the cell state's error, without errors of the outputs."""
        return _up((self.i.off * self.g.top + self.g.off * self.i.top + self.rounding) / self.lost)

    @cached_property
    def pulls(self) -> tuple[Fraction, Fraction]:
        """What it adds for each 1 that these move the arguments of i and g by."""
        of_i, of_g = self.i.slope * self.g.top, self.g.slope * self.i.top
        return _up(of_i / self.lost), _up(of_g / self.lost)

    @cached_property
    def of_table(self) -> Fraction:
        """What a cell state of 1 is off by the forget gate's table."""
        return _up((self.kept + self.rest) * self.share + self.rest)

    def next_cell(self, moved: Sequence[Fraction], size: Fraction) -> Fraction:
        """Return what a cell state of up to a size is off by at most.

        Raises:
            NotUnderstoodError: too far for the rule.
        """
        d = self.forget + moved[1]
        if d > QUARTER:
            raise NotUnderstoodError("a state may be far off: the forget gate's argument is")
        added = self.added + self.pulls[0] * moved[0] + self.pulls[1] * moved[2]
        return added + size * (self.of_table + self.of_slip * d * (1 + 2 * d))

    def next(self, moved: Sequence[Fraction], cell: Fraction, bent: Fraction) -> Fraction:
        """Return what bounds the output's error for that of tanh(c), and the largest tanh(C)."""
        return self.o.top * cell + (self.o.off + self.o.slope * moved[3]) * bent


@dataclass(frozen=True)
class LstmUnitRule:
    """What bounds a unit's next error, whatever the features are."""

    parts: Sequence[LstmPartRule]
    weights: Sequence[Sequence[Fraction]]
    """[4][H] sizes of those of the outputs."""
    bend: Fraction
    """What tanh(c) is off by, but for c's own error."""

    @cached_property
    def cell(self) -> Fraction:
        """The largest |C|."""
        return max(part.cell for part in self.parts)

    @cached_property
    def bent(self) -> Fraction:
        """The largest |tanh C|."""
        return _up(enclose_tanh(self.cell)[1])

    @cached_property
    def top(self) -> Fraction:
        """The largest o."""
        return max(part.o.top for part in self.parts)

    def moved(self, errors: Sequence[Fraction]) -> list[Fraction]:
        """Return how far errors of the outputs move the arguments of i, f, g, o."""
        return [
            _up(sum((a * e for a, e in zip(row, errors, strict=True)), NONE))
            for row in self.weights
        ]

    def worst(self, moved: Sequence[Fraction]) -> tuple[LstmPartRule, LstmPartRule, Fraction]:
        """Return the parts that are worst for the cell state and the output, and its error."""
        cells = [part.next_cell(moved, self.cell) for part in self.parts]
        cell = max(cells)
        after = [part.next(moved, cell + self.bend, self.bent) for part in self.parts]
        largest = max(after)
        places = cells.index(cell), after.index(largest)
        return self.parts[places[0]], self.parts[places[1]], largest + Fraction(1, 1 << 30)

    def next(self, errors: Sequence[Fraction]) -> Fraction:
        """Return what bounds the error of the output after a step from these errors."""
        return self.worst(self.moved(errors))[2]


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
    at_rest = _close_lstm(units, without)
    ways = _go_to_rest(units, at_rest)
    starts = [2 * (unit.top * cell + h) for unit, (cell, h) in zip(units, ways, strict=True)]
    errors = _close_lstm(units, starts)
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
        parts = list_parts(
            [self._line(j, g) for g in range(4)], [(x.low, x.high) for x in self._features]
        )
        rules = []
        for part in parts:
            ends = zip(self._features, part, strict=True)
            rules.append(self._part(j, [replace(x, low=low, high=high) for x, (low, high) in ends]))
        if max(rule.reach for rule in rules) > Fraction(1 << 30, 1 << self._cell_bits):
            raise NotUnderstoodError("the cell state may be limited")
        weights = [list(map(abs, self.w_h(j, g))) for g in range(4)]
        return LstmUnitRule(rules, weights, self.tanh_off + Fraction(1, 1 << 17))

    def _line(self, j: int, g: int) -> GateLine:
        """Return a gate's argument as the choice of parts has it."""
        c, shift = self._c, self._c.shifts[g]
        count = 0.5 ** (shift + (16 if g == 2 else 15))
        row = 4 * j + g
        whole = c.w_x[row * c.inputs : (row + 1) * c.inputs]
        slopes = [
            float(w) * float(x.scale) for w, x in zip(self.w_x(j, g), self._features, strict=True)
        ]
        around = sum(abs(float(w)) for w in self.w_h(j, g))
        bias = float(self._rows[j][g])
        apart = around / 65536 + sum(
            abs(float(w)) * float(x.error)
            for w, x in zip(self.w_x(j, g), self._features, strict=True)
        )
        wrong = (c.bias[row] - (1 << shift >> 1)) * count - bias
        wrongs = [w * count - real for w, real in zip(whole, slopes, strict=True)]
        return GateLine(bias, slopes, around, wrong, wrongs, apart)

    def _part(self, j: int, features: Sequence[FeatureRange]) -> LstmPartRule:
        """Return what bounds the next error while the features are within given ones."""
        i, g, o = (
            self._gate(j, 0, features),
            self._candidate(j, features),
            self._gate(j, 3, features),
        )
        f = self.argument(j, 1, 15, features)
        if ends_of(f, 15)[1] > NEAREST:
            raise NotUnderstoodError("the forget gate comes near to 1")
        low, high = self._arguments(f)
        share, rest = numbers.sigmoid_error(self._lines, -high, -low)
        chip = Fraction((1 << 30) + self.look_up(f.chip[1]), 1 << 31)
        real = enclose_sigmoid(-f.real[1])[0]
        rounding = Fraction(2, 1 << self._cell_bits) + Fraction(1, 1 << 30)
        kept, lost = _up(max(chip, 1 - real)), 1 - _up(1 - min(1 - chip, real))
        return LstmPartRule(i, g, o, _up(f.off.own), share, rest, kept, lost, rounding)

    def _arguments(self, a: GateSum) -> tuple[int, int]:
        """Return the first and last argument of the table, of the chip and of real arithmetic."""
        ends = ends_of(a, 15)
        return int(ends[0] * 32768 // 1), int(-(-ends[1] * 32768 // 1))

    def _gate(self, j: int, g: int, features: Sequence[FeatureRange]) -> LstmGate:
        a = self.argument(j, g, 15, features)
        ends = ends_of(a, 15)
        slope = _up(steepest(ends[0] / 2, ends[1] / 2) / 4)
        chip = Fraction((1 << 30) + self.look_up(a.chip[1]), 1 << 31)
        share, rest = numbers.sigmoid_error(self._lines, *self._arguments(a))
        # table (share (1 - table) + rest), at the largest table (1 - table) there can be
        of_table = min(self.tanh_off / 2, share * min(chip, QUARTER) + rest * chip)
        top = max(chip, enclose_sigmoid(a.real[1])[1])
        return LstmGate(_up(slope * a.off.own + of_table), slope, _up(top))

    def _candidate(self, j: int, features: Sequence[FeatureRange]) -> LstmGate:
        a = self.argument(j, 2, 16, features)
        slope = _up(steepest(*ends_of(a, 16)))
        chip = Fraction(max(abs(self.look_up(t)) for t in a.chip), 1 << 30)
        real = max(abs(end) for x in a.real for end in enclose_tanh(x))
        return LstmGate(_up(slope * a.off.own + self.tanh_off), slope, _up(max(chip, real)))


def _close_lstm(units: Sequence[LstmUnitRule], starts: Sequence[Fraction]) -> list[Fraction]:
    """Return errors that a step does not enlarge, with what is added to each.

    Raises:
        NotUnderstoodError: there are none.
    """
    errors = [NONE] * len(units)
    for _ in range(ROUNDS):
        errors = [Fraction(x * MORE) for x in _solve_lstm(units, starts, errors)]
        if any(e <= 0 for e in errors):
            break
        after = [unit.next(errors) + start for unit, start in zip(units, starts, strict=True)]
        if all(e >= x for e, x in zip(errors, after, strict=True)):
            return errors
    raise NotUnderstoodError(NO_CONTRACTION)


def _solve_lstm(
    units: Sequence[LstmUnitRule], starts: Sequence[Fraction], near: Sequence[Fraction]
) -> list[float]:
    """Return about what errors stay the same in a step; without such, no matter.

    Args:
        units: their rules.
        starts: what is added to each error.
        near: errors at which the parts that are worst are taken, and slopes.
    """
    rows = []
    for j, (unit, start) in enumerate(zip(units, starts, strict=True)):
        moved = unit.moved(near)
        of_cell, of_output, after = unit.worst(moved)
        top, d = of_output.o.top, of_cell.forget + moved[1]
        gains = (
            top * of_cell.pulls[0],
            top * unit.cell * of_cell.of_slip * (1 + 4 * d),
            top * of_cell.pulls[1],
            unit.bent * of_output.o.slope,
        )
        row = [
            -float(sum(gain * w[k] for gain, w in zip(gains, unit.weights, strict=True)))
            for k in range(len(units))
        ]
        # the tangent at the errors given: after + row (e - near)
        own = float(after + start) + sum(a * float(e) for a, e in zip(row, near, strict=True))
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
    furthest = [2 * unit.top for unit in units]
    for unit in units:
        moved = unit.moved([e + far for e, far in zip(errors, furthest, strict=True)])
        d = max(part.forget for part in unit.parts) + moved[1]
        of_f = unit.cell * max(part.of_slip for part in unit.parts)
        of_f *= 2 * numbers.exp(2 * d)[1] - numbers.exp(d)[0]
        of_i, of_g = (max(part.pulls[k] for part in unit.parts) for k in (0, 1))
        i, f, g, o = unit.weights
        three = zip(i, f, g, strict=True)
        pulls.append([_count(of_i * a + of_f * b + of_g * c) for a, b, c in three])
        of_o = unit.bent * max(part.o.slope for part in unit.parts)
        outputs.append([_count(of_o * weight) for weight in o])
    tops = [_count(unit.top) for unit in units]
    cells = [_count(unit.cell) for unit in units]
    hs = [_count(unit.top * unit.bent) for unit in units]
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


def _up(x: Fraction) -> Fraction:
    """Return x or a little more, in counts of 2^-96."""
    return Fraction(-((-x.numerator << 96) // x.denominator), 1 << 96)


def _count(x: Fraction) -> int:
    """Return x >= 0 in whole units, or a little more."""
    return -int(-x * UNIT // 1)


def _product(a: Sequence[int], b: Sequence[int]) -> int:
    """Return the sum of products in units, rounded up."""
    return -(-sum(x * y for x, y in zip(a, b, strict=True)) // UNIT)
