"""Integers that depend on symbols, in one normal form: equal terms are the same object.

A term is a whole number for every value of the symbols that lies in their ranges; nothing wraps.
Sums of terms with constant factors are multiplied out and sorted; a shift takes out what it divides
exactly. Two terms that are the same object are equal for every value of their symbols; of two that
are not, nothing is known.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import gcd
from typing import TypeAlias

Sums: TypeAlias = tuple[tuple[int, int], ...]
"""(number of an atom, its factor), sorted; no factor is 0."""


class UndecidedError(Exception):
    """There is no rule for this; nothing is shown of it."""


@dataclass(eq=False, slots=True)
class Whole:
    """A whole number that depends on symbols."""

    number: int
    """Its own, for sorting."""
    kind: str
    """sum | symbol | product | shift | max | min | le | eq | or | choose | of | row | select."""
    inner: tuple[int, ...]
    """Numbers of the terms that it is made of, and amounts."""
    low: int
    high: int
    constant: int = 0
    """Of a sum."""
    sums: "Sums" = ()
    """Of a sum: atoms and their factors."""

    @property
    def exact(self) -> int | None:
        """The number, where it can be but one."""
        return self.low if self.low == self.high else None

    @property
    def is_truth(self) -> bool:
        """Whether it is 0 or 1."""
        return self.low >= 0 and self.high <= 1


@dataclass(frozen=True)
class Opaque:
    """A function whose results stand for themselves; its range, its value where all is known."""

    name: str
    bound: Callable[[Sequence[Whole]], tuple[int, int]]
    compute: Callable[[Sequence[int]], int] | None = None


class Terms:
    """Makes terms; each once."""

    def __init__(self) -> None:
        """Hold none."""
        self._made: dict[tuple[str, str, tuple[int, ...]], Whole] = {}
        self._sums: dict[tuple[int, Sums], Whole] = {}
        self._all: list[Whole] = []

    def _make(
        self, kind: str, inner: tuple[int, ...], low: int, high: int, name: str = ""
    ) -> Whole:
        """Return the term of this form; its range is the narrowest that was ever shown."""
        key = (kind, name, inner)
        found = self._made.get(key)
        if found is None:
            found = Whole(len(self._all), kind, inner, low, high)
            self._made[key] = found
            self._all.append(found)
        elif low > found.low or high < found.high:
            found.low, found.high = max(low, found.low), min(high, found.high)
        return found

    def _make_sum(self, constant: int, sums: Sums, low: int, high: int) -> Whole:
        key = (constant, sums)
        found = self._sums.get(key)
        if found is None:
            found = Whole(len(self._all), "sum", (), low, high, constant, sums)
            self._sums[key] = found
            self._all.append(found)
        elif low > found.low or high < found.high:
            found.low, found.high = max(low, found.low), min(high, found.high)
        return found

    # --- the plain ones

    def constant(self, value: int) -> Whole:
        """Return a number."""
        return self._make_sum(value, (), value, value)

    def symbol(self, name: str, low: int, high: int) -> Whole:
        """Return any number from low to high; another name is another number."""
        if low == high:
            return self.constant(low)
        return self._make("symbol", (low, high), low, high, name)

    def split(self, term: Whole) -> tuple[int, Sums]:
        """Return a term as a constant and a sum of atoms."""
        if term.kind == "sum":
            return term.constant, term.sums
        return 0, ((term.number, 1),)

    def atom(self, number: int) -> Whole:
        """Return the atom of a number."""
        return self._all[number]

    def _sum(self, constant: int, sums: Sums) -> Whole:
        if not sums:
            return self.constant(constant)
        if constant == 0 and len(sums) == 1 and sums[0][1] == 1:
            return self._all[sums[0][0]]
        low = high = constant
        for number, factor in sums:
            atom = self._all[number]
            if factor > 0:
                low += factor * atom.low
                high += factor * atom.high
            else:
                low += factor * atom.high
                high += factor * atom.low
        if low == high:
            return self.constant(low)
        return self._make_sum(constant, sums, low, high)

    def scale(self, a: Whole, factor: int) -> Whole:
        """Return factor a."""
        if factor == 1:
            return a
        constant, sums = self.split(a)
        if factor == 0:
            return self.constant(0)
        found = self._sum(constant * factor, tuple((n, c * factor) for n, c in sums))
        ends = factor * a.low, factor * a.high
        return self._narrow(found, min(ends), max(ends))

    def _narrow(self, term: Whole, low: int, high: int) -> Whole:
        """Return a term that was shown to lie within low .. high."""
        if low > term.low or high < term.high:
            term.low, term.high = max(low, term.low), min(high, term.high)
            if term.low == term.high:
                return self.constant(term.low)
        return term

    def add(self, a: Whole, b: Whole) -> Whole:
        """Return a + b."""
        return self._combine(a, b, 1)

    def subtract(self, a: Whole, b: Whole) -> Whole:
        """Return a - b."""
        return self._combine(a, b, -1)

    def _combine(self, a: Whole, b: Whole, sign: int) -> Whole:
        (c, left), (d, right) = self.split(a), self.split(b)
        if not right:
            total = self._sum(c + sign * d, left)
        else:
            factors = dict(left)
            for number, factor in right:
                factors[number] = factors.get(number, 0) + sign * factor
            sums = tuple(sorted((n, f) for n, f in factors.items() if f))
            total = self._sum(c + sign * d, sums)
        if sign > 0:
            self._narrow_move(a, b, total)
            total = self._narrow_mix(a, b, self._narrow_mix(b, a, total))
            return self._narrow(total, a.low + b.low, a.high + b.high)
        return self._narrow(total, a.low - b.high, a.high - b.low)

    def _narrow_move(self, h: Whole, moved: Whole, total: Whole) -> None:
        """h + 2 round((n - h) u / 2^32) with 0 <= u < 2^31 lies between h and n, within 1.

        With d = n - h and s = u / 2^31 < 1: d s lies between 0 and d, and twice the rounded half
        of it is within 1 of it.
        """
        constant, sums = self.split(moved)
        if constant or len(sums) != 1 or sums[0][1] != 2:
            return
        shift = self._all[sums[0][0]]
        if shift.kind != "shift":
            return
        inside, by = self._all[shift.inner[0]], shift.inner[1]
        constant, sums = self.split(inside)
        if constant != 1 << (by - 1):
            return
        own, factors = self.split(h), dict(sums)
        if own[0] == 0 and len(own[1]) == 1 and own[1][0][1] == 1 and own[1][0][0] in factors:
            f = -factors[own[1][0][0]]  # of f (n - h) + half, with 0 <= 2 f <= 2^by
            if 0 < 2 * f <= 1 << by and all(c % f == 0 for c in factors.values()):
                rest = tuple((k, c // f) for k, c in sums if k != own[1][0][0])
                self._limit_move(h, self._sum(0, rest), total)
            return
        if by != 32 or len(sums) != 1 or sums[0][1] != 1:
            return
        product = self._all[sums[0][0]]
        if product.kind != "product":
            return
        a, b = (self._all[n] for n in product.inner)
        for d, u in ((a, b), (b, a)):
            if u.low >= 0 and u.high < 1 << 31:
                self._limit_move(h, self.subtract(d, self.scale(h, -1)), total)

    def _narrow_mix(self, a: Whole, moved: Whole, total: Whole) -> Whole:
        """a + floor(x / 2^s) = floor((2^s a + x) / 2^s), where an atom of both counts once.

        So older + round((newer - older) q) is seen to lie between older and newer.
        """
        constant, sums = self.split(moved)
        if len(sums) != 1 or sums[0][1] != 1 or total.kind != "sum":
            return total
        shift = self._all[sums[0][0]]
        if shift.kind != "shift":
            return total
        by = shift.inner[1]
        (c, left), (d, right) = self.split(self._all[shift.inner[0]]), self.split(a)
        factors = dict(left)
        if not any(number in factors for number, _ in right):
            return total
        for number, factor in right:
            factors[number] = factors.get(number, 0) + (factor << by)
        low = high = c + (d + constant << by)
        for number, factor in factors.items():
            atom = self._all[number]
            ends = factor * atom.low, factor * atom.high
            low, high = low + min(ends), high + max(ends)
        return self._narrow(total, low >> by, high >> by)

    def _limit_move(self, h: Whole, n: Whole, total: Whole) -> None:
        total.low = max(total.low, min(h.low, n.low) - 1)
        total.high = min(total.high, max(h.high, n.high) + 1)

    def multiply(self, a: Whole, b: Whole) -> Whole:
        """Return a b."""
        if a.exact is not None:
            return self.scale(b, a.exact)
        if b.exact is not None:
            return self.scale(a, b.exact)
        if a.number > b.number:
            a, b = b, a
        ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
        low, high = min(ends), max(ends)
        if a is b:
            low = max(low, 0)
        return self._make("product", (a.number, b.number), low, high)

    def shift(self, a: Whole, by: int) -> Whole:
        """Return floor(a / 2^by)."""
        if by == 0:
            return a
        if a.exact is not None:
            return self.constant(a.exact >> by)
        return self._narrow(self._shift(a, by), a.low >> by, a.high >> by)

    def _shift(self, a: Whole, by: int) -> Whole:
        one = 1 << by
        constant, sums = self.split(a)
        whole = tuple((n, f >> by) for n, f in sums if f % one == 0)
        rest = tuple((n, f) for n, f in sums if f % one)
        out = self._sum(constant >> by, whole)
        constant %= one
        if not rest:
            return out
        # floor((2^k b + c) / 2^s) = floor((b + floor(c / 2^k)) / 2^(s - k))
        common = by
        for _, factor in rest:
            common = min(common, (factor & -factor).bit_length() - 1)
        if common:
            rest = tuple((n, f >> common) for n, f in rest)
            constant, by = constant >> common, by - common
        if len(rest) == 1 and rest[0][1] == 1 and self._all[rest[0][0]].kind == "shift":
            # floor((floor(b / 2^r) + c) / 2^s) = floor((b + c 2^r) / 2^(r + s))
            inner = self._all[rest[0][0]]
            below, first = self._all[inner.inner[0]], inner.inner[1]
            merged = self.add(below, self.constant(constant << first))
            return self.add(out, self.shift(merged, first + by))
        inside = self._sum(constant, rest)
        low, high = inside.low >> by, inside.high >> by
        if low == high:
            return self.add(out, self.constant(low))
        return self.add(out, self._make("shift", (inside.number, by), low, high))

    def modulo(self, a: Whole, bits: int) -> Whole:
        """Return a modulo 2^bits, from 0 to 2^bits - 1."""
        found = self.subtract(a, self.scale(self.shift(a, bits), 1 << bits))
        return self._narrow(found, 0, (1 << bits) - 1)

    # --- limits

    def maximum(self, a: Whole, b: Whole) -> Whole:
        """Return the larger one."""
        return self._extremum("max", a, b)

    def minimum(self, a: Whole, b: Whole) -> Whole:
        """Return the smaller one."""
        return self._extremum("min", a, b)

    def _extremum(self, kind: str, a: Whole, b: Whole) -> Whole:
        difference = self.subtract(a, b)
        if difference.low >= 0:
            return a if kind == "max" else b
        if difference.high <= 0:
            return b if kind == "max" else a
        if a.number > b.number:
            a, b = b, a
        take = max if kind == "max" else min
        low, high = take(a.low, b.low), take(a.high, b.high)
        if low == high:
            return self.constant(low)
        return self._make(kind, (a.number, b.number), low, high)

    def clamp(self, x: Whole, low: Whole, high: Whole) -> Whole:
        """Return x limited to low .. high, of which low <= high has to be plain to see."""
        if self.subtract(high, low).low < 0:
            raise UndecidedError("limits of which the lower one may be the larger one")
        return self.maximum(low, self.minimum(x, high))

    # --- truths, which are 0 or 1

    def at_most_zero(self, d: Whole) -> Whole:
        """Return whether d <= 0."""
        if d.high <= 0:
            return self.constant(1)
        if d.low > 0:
            return self.constant(0)
        constant, sums = self.split(d)
        if (found := self._at_most_around(d, sums)) is not None:
            return found
        common = 0
        for _, factor in sums:
            common = gcd(common, factor)
        # g b + c <= 0 as b <= -c / g, which is b <= floor(-c / g)
        constant = -((-constant) // common)
        sums = tuple((n, f // common) for n, f in sums)
        if sums[0][1] < 0:  # not (1 - d <= 0)
            sums = tuple((n, -f) for n, f in sums)
            return self.negate(self._le(1 - constant, sums))
        return self._le(constant, sums)

    def _at_most_around(self, d: Whole, sums: Sums) -> Whole | None:
        """Return whether d <= 0 of a d that holds an x modulo 2^32, if the side of x decides it.

        x modulo 2^32 is x - 2^32 floor(x / 2^32), of which the floor is one of two numbers here: so
        one comparison without a sign tells whether a number lies between two ends.
        """
        for number, factor in sums:
            atom = self._all[number]
            two = atom.kind == "shift" and atom.inner[1] == 32 and atom.high == atom.low + 1
            if not two or abs(factor) != 1 << 32:
                continue
            x, edge, sign = self._all[atom.inner[0]], atom.high << 32, -1 if factor > 0 else 1
            rest = self.subtract(d, self.scale(atom, factor))
            apart = self.subtract(rest, self.scale(x, sign))
            if apart.exact is None:
                continue
            sides = []  # d below the edge, and from it on; the ends of each
            for floor, low, high in ((atom.low, x.low, edge - 1), (atom.high, edge, x.high)):
                ends = [sign * end + apart.exact + factor * floor for end in (low, high)]
                told = 1 if max(ends) <= 0 else 0 if min(ends) > 0 else None
                sides.append((self.add(rest, self.constant(factor * floor)), told))
            below = self.less(x, self.constant(edge))
            for (_, told), (other, _), here in zip(
                sides, reversed(sides), (below, self.negate(below)), strict=True
            ):
                if told is None:
                    continue
                if told:
                    return self.either([here, self.at_most_zero(other)])
                return self.both([self.negate(here), self.at_most_zero(other)])
        return None

    def _le(self, constant: int, sums: Sums) -> Whole:
        d = self._sum(constant, sums)
        if d.high <= 0 or d.low > 0:
            return self.constant(int(d.high <= 0))
        atom = self._all[sums[0][0]]
        if len(sums) == 1 and atom.is_truth and sums[0][1] == 1 and constant == 0:
            return self.negate(atom)
        return self._make("le", (d.number,), 0, 1)

    def less(self, a: Whole, b: Whole) -> Whole:
        """Return whether a < b."""
        return self.at_most_zero(self.add(self.subtract(a, b), self.constant(1)))

    def at_most(self, a: Whole, b: Whole) -> Whole:
        """Return whether a <= b."""
        return self.at_most_zero(self.subtract(a, b))

    def equal(self, a: Whole, b: Whole) -> Whole:
        """Return whether a = b."""
        d = self.subtract(a, b)
        if d.exact is not None:
            return self.constant(int(d.exact == 0))
        if d.low > 0 or d.high < 0:
            return self.constant(0)
        constant, sums = self.split(d)
        if len(sums) == 1 and self._all[sums[0][0]].is_truth:  # f b + c = 0
            truth, factor = self._all[sums[0][0]], sums[0][1]
            if constant == 0:
                return self.negate(truth)
            return truth if constant == -factor else self.constant(0)
        if sums[0][1] < 0:
            d = self.scale(d, -1)
        return self._make("eq", (d.number,), 0, 1)

    def negate(self, truth: Whole) -> Whole:
        """Return 1 - truth."""
        return self.subtract(self.constant(1), truth)

    def either(self, truths: Sequence[Whole]) -> Whole:
        """Return whether any of them holds."""
        found: set[int] = set()
        for truth in truths:
            if not truth.is_truth:
                raise UndecidedError("something that is neither 0 nor 1")
            if truth.exact == 1:
                return truth
            if truth.exact == 0:
                continue
            if truth.kind == "or":
                found |= {*truth.inner}
            else:
                found.add(truth.number)
        if any(self.negate(self._all[n]).number in found for n in found):
            return self.constant(1)
        if len(found) < 2:
            return self._all[found.pop()] if found else self.constant(0)
        return self._make("or", tuple(sorted(found)), 0, 1)

    def both(self, truths: Sequence[Whole]) -> Whole:
        """Return whether all of them hold."""
        return self.negate(self.either([self.negate(truth) for truth in truths]))

    def choose(self, truth: Whole, a: Whole, b: Whole) -> Whole:
        """Return a where the truth is 1, b where it is 0."""
        if truth.exact is not None:
            return a if truth.exact else b
        if a is b:
            return a
        if (sums := self.split(truth))[0] == 1 and len(sums[1]) == 1 and sums[1][0][1] == -1:
            truth, a, b = self.negate(truth), b, a
        a, b = self._put(truth, 1, a), self._put(truth, 0, b)
        difference = self.subtract(a, b)
        if difference.exact is not None:
            return self.add(b, self.scale(truth, difference.exact))
        limited = self._find_limit(truth, a, b, difference)
        if limited is not None:
            return limited
        if a.is_truth and b.is_truth and (a.exact is not None or b.exact is not None):
            if a.exact is not None:
                join = self.either if a.exact else self.both
                return join([truth if a.exact else self.negate(truth), b])
            join = self.either if b.exact else self.both
            return join([self.negate(truth) if b.exact else truth, a])
        if (bits := self._choose_bits(truth, a, b, difference)) is not None:
            return bits
        low, high = min(a.low, b.low), max(a.high, self._high_unless(truth, b))
        return self._make("choose", (truth.number, a.number, b.number), low, high)

    def _put(self, truth: Whole, value: int, term: Whole) -> Whole:
        """Return a term for a truth of that value: a counter of two values is a truth, too."""
        for atom, factor in self.split(term)[1]:
            if atom == truth.number:
                term = self.subtract(term, self.scale(truth, factor))
                return self.add(term, self.constant(value * factor))
        return term

    def _choose_bits(self, truth: Whole, a: Whole, b: Whole, difference: Whole) -> Whole | None:
        """(c) ? (x | k) : x, where x may have the bit k already, or may have it here alone."""
        constant, sums = self.split(difference)
        if len(sums) != 1 or not self._all[sums[0][0]].is_truth:
            return None
        factor, atom = sums[0][1], self._all[sums[0][0]]
        if constant not in (0, -factor):
            return None
        if (constant or factor) < 0:
            truth, a, b, constant, factor = self.negate(truth), b, a, -constant, -factor
        bit = constant or factor
        other = atom if constant else self.negate(atom)  # a - b = bit (1 - other)
        if atom.number in [n for n, _ in self.split(b)[1]] or constant:
            more = self.subtract(self.either([truth, other]), other)
            return self.add(b, self.scale(more, bit))
        return self.add(b, self.scale(self.both([truth, atom]), bit))

    def _high_unless(self, truth: Whole, b: Whole) -> int:
        """Return the highest b where x = c does not hold: with c at the end of x, it is less."""
        if truth.kind == "eq":
            constant, sums = self.split(self._all[truth.inner[0]])
            others = self.split(b)[1]
            plain = len(sums) == 1 and sums == others and sums[0][1] == 1
            if plain and self._all[sums[0][0]].high == -constant:
                return b.high - 1
        return b.high

    def _find_limit(self, truth: Whole, a: Whole, b: Whole, difference: Whole) -> Whole | None:
        """(x < low) ? low : x and its like."""
        if truth.kind != "le":
            return None
        d = self._all[truth.inner[0]]
        kind = self._compare(d, difference)
        if kind:
            return self._extremum(kind, a, b)
        for one, other in ((a, b), (b, a)):
            for inner, outer in (("min", "max"), ("max", "min")):
                if other.kind != inner:
                    continue
                p, q = (self._all[n] for n in other.inner)
                for x, limit in ((p, q), (q, p)):
                    sign = self.subtract(a, x) if one is a else self.subtract(x, b)
                    if self._compare(d, sign) != outer:
                        continue
                    gap = self.subtract(limit, one)
                    if gap.low >= 0 if outer == "max" else gap.high <= 0:
                        return self._extremum(outer, one, other)
        return None

    def _compare(self, d: Whole, difference: Whole) -> str:
        """Tell whether (d <= 0) ? a : b is the larger or the smaller one, by a - b."""
        (c, sums), (k, others) = self.split(d), self.split(difference)
        if len(sums) != len(others) or sums[0][0] != others[0][0] or others[0][1] % sums[0][1]:
            return ""
        factor = others[0][1] // sums[0][1]
        if tuple((n, f * factor) for n, f in sums) != others:
            return ""
        rest = k - factor * c  # a - b = factor d + rest
        if factor < 0 and 0 <= rest <= -factor:
            return "max"
        if factor > 0 and -factor <= rest <= 0:
            return "min"
        return ""

    # --- what stands for itself

    def row(self, terms: Sequence[Whole]) -> Whole:
        """Return several terms as one, to be given to a function."""
        return self._make("row", tuple(t.number for t in terms), 0, 0)

    def call(self, function: Opaque, arguments: Sequence[Whole], row: Whole | None = None) -> Whole:
        """Return what a function gives; `row` stands for the arguments where there are many."""
        values = [t.exact for t in arguments]
        if function.compute is not None and all(v is not None for v in values):
            return self.constant(function.compute([v for v in values if v is not None]))
        low, high = function.bound(arguments)
        given = (row.number,) if row is not None else tuple(t.number for t in arguments)
        return self._make("of", given, low, high, function.name)

    def select(self, at: Whole, cells: dict[int, Whole]) -> Whole:
        """Return the element of an array at a position that is one of the cells'."""
        if at.exact is not None:
            return cells[at.exact]
        every = list(cells.values())
        if all(cell is every[0] for cell in every):
            return every[0]
        listed = tuple(part for n, cell in cells.items() for part in (n, cell.number))
        low, high = min(c.low for c in every), max(c.high for c in every)
        return self._make("select", (at.number, *listed), low, high)
