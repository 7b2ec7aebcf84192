"""Words of 32 bits over terms, and functions of one number piece by piece.

Sums, products and left shifts need no more. Where an instruction reads a word as a number, the
number with its sign is found from the term's range; what does not fit is written out with a shift.

Functions of one number, piece by piece, for what has no normal form of its own.

Kernels look up tanh with shifts, masks and a table. On each line of the table all of that is plain:
a sign is -1 or 0, a line's number is a number. So what follows from a number t is kept as a term
for each of its pieces, every one with a symbol that lies in that piece; all pieces together are
every t. What they are in the end is told by comparing them with a function that is known.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from zerodrift_proof.equality.kernels import TANH, compute_tanh, list_nodes
from zerodrift_proof.equality.terms import Opaque, Terms, UndecidedError, Whole

WORD = 1 << 32
DOUBLE = Opaque("2^", lambda a: (1 << a[0].low, 1 << a[0].high), lambda v: 1 << v[0])
"""As the kernels of `equality` have it."""


class WordTerms(Terms):
    """Terms whose products are multiplied out, so that products by halves are the same terms."""

    def multiply(self, a: Whole, b: Whole) -> Whole:
        """Return a b."""
        if a.exact is not None or b.exact is not None:
            return super().multiply(a, b)
        (c, left), (d, right) = self.split(a), self.split(b)
        factors: dict[int, int] = {}
        for n, f in left:
            factors[n] = factors.get(n, 0) + f * d
            for m, g in right:
                number = super().multiply(self.atom(n), self.atom(m)).number
                factors[number] = factors.get(number, 0) + f * g
        for m, g in right:
            factors[m] = factors.get(m, 0) + g * c
        total = self._sum(c * d, tuple(sorted((n, f) for n, f in factors.items() if f)))
        ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
        return self._narrow(total, 0 if a is b else min(ends), max(ends))

    def _shift(self, a: Whole, by: int) -> Whole:
        """Return floor(a / 2^by), of a = floor(b / 2^16) + c as floor((b + 2^16 c) / 2^(by + 16)).

        `Terms` knows it of a constant c. Here c is any sum, where it has no other part like b.
        """
        sums = self.split(a)[1]
        halves = [n for n, f in sums if f == 1 and self._is_half(n)]
        if by < 32 and len(halves) == 1 and len(sums) > 1:
            rest = self.subtract(a, self.atom(halves[0]))
            below = self.atom(self.atom(halves[0]).inner[0])
            return super()._shift(self.add(below, self.scale(rest, 1 << 16)), by + 16)
        return super()._shift(a, by)

    def _extremum(self, kind: str, a: Whole, b: Whole) -> Whole:
        """Return an end of a term and a number: of the term without its constant, + that."""
        if a.exact is not None:
            a, b = b, a
        if b.exact is None or a.exact is not None or (constant := self.split(a)[0]) == 0:
            return super()._extremum(kind, a, b)
        moved = self.constant(constant)
        found = super()._extremum(kind, self.subtract(a, moved), self.subtract(b, moved))
        return self.add(found, moved)

    def _is_half(self, number: int) -> bool:
        atom = self.atom(number)
        return atom.kind == "shift" and atom.inner[1] == 16


class Words:
    """What instructions make of words; each operand and each result is a term modulo 2^32."""

    def __init__(self, terms: WordTerms) -> None:
        """Make terms with these."""
        self.terms = terms
        self._pairs: dict[int, tuple[Whole, Whole]] = {}
        """Number of an exclusive or that stands for itself -> of what."""

    def number(self, value: int) -> Whole:
        """Return a constant."""
        return self.terms.constant(value)

    # --- a word as a number

    def residue(self, t: Whole, bits: int, signed: bool) -> Whole:
        """Return the number that the lowest bits of a term are."""
        terms, period = self.terms, 1 << bits
        first = -period // 2 if signed else 0
        for one in (t, self._drop(t, period)):
            turns = (one.low - first) >> bits
            if turns == (one.high - first) >> bits:
                return one if turns == 0 else terms.subtract(one, self.number(turns << bits))
        over = terms.shift(terms.subtract(one, self.number(first)), bits)
        found = terms.subtract(one, terms.scale(over, period))
        return terms._narrow(found, first, first + period - 1)

    def _drop(self, t: Whole, period: int) -> Whole:
        """Return a term without what is a multiple of the period."""
        constant, sums = self.terms.split(t)
        kept = tuple((n, f) for n, f in sums if f % period)
        if len(kept) == len(sums):
            return t
        half = period // 2
        return self.terms._sum((constant + half) % period - half, kept)

    def signed(self, t: Whole) -> Whole:
        """Return a word as a number with a sign."""
        return self.residue(t, 32, True)

    def unsigned(self, t: Whole) -> Whole:
        """Return a word as a number without a sign."""
        return self.residue(t, 32, False)

    def low_half(self, t: Whole) -> Whole:
        """Return the lower 16 bits with their sign."""
        return self.residue(t, 16, True)

    def high_half(self, t: Whole) -> Whole:
        """Return the upper 16 bits with their sign."""
        return self.residue(self.terms.shift(t, 16), 16, True)

    def bit(self, t: Whole, at: int) -> Whole:
        """Return a bit."""
        return self.residue(self.terms.shift(t, at), 1, False)

    def sign(self, t: Whole) -> Whole:
        """Return 1 of a negative word, 0 of another."""
        return self.terms.less(self.signed(t), self.number(0))

    def is_zero(self, t: Whole) -> Whole:
        """Return whether a word is 0."""
        return self.terms.equal(self.signed(t), self.number(0))

    # --- sums and shifts

    def add(self, a: Whole, b: Whole) -> Whole:
        """Return a + b."""
        return self.terms.add(a, b)

    def subtract(self, a: Whole, b: Whole) -> Whole:
        """Return a - b."""
        return self.terms.subtract(a, b)

    def carry(self, a: Whole, b: Whole, more: Whole) -> Whole:
        """Return the carry of a + b + more, where more is 0 or 1.

        With M = 2^32 and a = M q + u, b = M r + v: u + v + more is a + b + more - M (q + r).
        """
        terms = self.terms
        total = terms.add(terms.add(a, b), more)
        found = terms.subtract(
            self.floor_word(total), terms.add(self.floor_word(a), self.floor_word(b))
        )
        return terms._narrow(found, 0, 1)

    def floor_word(self, t: Whole) -> Whole:
        """Return floor(t / 2^32); of a number that fits a word by its sign alone."""
        if t.low >= -WORD and t.high < WORD and t.low < 0 <= t.high:
            return self.terms.scale(self.terms.less(t, self.number(0)), -1)
        return self.terms.shift(t, 32)

    def invert(self, a: Whole) -> Whole:
        """Return what has every bit of a inverted."""
        return self.terms.subtract(self.number(-1), a)

    def lsl(self, a: Whole, by: int) -> Whole:
        """Return a shifted left; of 32 and more it is 0."""
        return self.number(0) if by >= 32 else self.terms.scale(a, 1 << by)

    def lsr(self, a: Whole, by: int) -> Whole:
        """Return a shifted right, zeros coming in: floor((a - 2^32 q) / 2^by)."""
        if by >= 32:
            return self.number(0)
        return self.terms.shift(self.unsigned(a), by) if by else a

    def asr(self, a: Whole, by: int) -> Whole:
        """Return a shifted right, the sign coming in."""
        if by >= 31:
            if a.low >= -(WORD >> 1) and a.high < WORD >> 1:
                return self.terms.shift(a, 31)
            return self.terms.scale(self.bit(a, 31), -1)
        return self.terms.shift(self.signed(a), by)

    def ror(self, a: Whole, by: int) -> Whole:
        """Return a rotated right, of a number."""
        by %= 32
        if by == 0:
            return a
        value = self._exact(a, "ror")
        return self.number((value >> by | value << (32 - by)) % WORD)

    def shifted_out(self, a: Whole, kind: str, by: int) -> Whole:
        """Return the carry that a shift by 1 to 32 leaves.

        The bit below what is left, as a sum: floor((a + 2^(by-1)) / 2^by) - floor(a / 2^by).
        """
        if kind == "lsl":
            return self.bit(a, 32 - by)
        if kind == "ror":
            return self.bit(a, by % 32 - 1 if by % 32 else 31)
        if by >= 32:
            return self.bit(a, 31)
        terms, half = self.terms, self.number(1 << (by - 1))
        found = terms.subtract(terms.shift(terms.add(a, half), by), terms.shift(a, by))
        return terms._narrow(found, 0, 1)

    def shift_left_by(self, a: Whole, by: Whole) -> Whole:
        """Return a shifted left by a word's lowest byte, of which 0 .. 31 is known."""
        amount = self.residue(by, 8, False)
        if amount.exact is not None:
            return self.lsl(a, amount.exact)
        if a.exact != 1 or amount.high > 31:
            raise UndecidedError("a shift by what is not known")
        return self.terms.call(DOUBLE, [amount])

    # --- bits

    def _exact(self, a: Whole, what: str) -> int:
        value = self.residue(a, 32, False).exact
        if value is None:
            raise UndecidedError(f"{what} of what is not known")
        return value

    def _order(self, a: Whole, b: Whole) -> tuple[Whole, int | None]:
        """Return one operand and the other's number, if that is known."""
        if b.exact is None:
            a, b = b, a
        return a, None if b.exact is None else b.exact % WORD

    def both(self, a: Whole, b: Whole) -> Whole:
        """Return a & b."""
        if a is b:
            return a
        x, mask = self._order(a, b)
        if mask is None:
            raise UndecidedError("& of what is not known")
        if x.exact is not None:
            return self.number(x.exact & mask)
        if mask & (mask + 1) == 0:
            bits = mask.bit_length()
            return x if bits == 32 else self.residue(x, bits, False)
        raise UndecidedError(f"& {mask}")

    def either(self, a: Whole, b: Whole) -> Whole:
        """Return a | b: of numbers, or of what has no bit in common."""
        if a.exact is not None and b.exact is not None:
            return self.number((a.exact | b.exact) % WORD)
        for one, other in ((a, b), (b, a)):
            if one.exact is not None and one.exact % WORD == 0:
                return other
            low = self.unsigned(one)
            constant, sums = self.terms.split(self._drop(other, WORD))
            every = [constant, *(f for _, f in sums)]
            if any(every) and low.high < min(n & -n for n in every if n):
                return self.terms.add(low, other)
        raise UndecidedError("| of what is not known")

    def differ(self, a: Whole, b: Whole) -> Whole:
        """Return a ^ b."""
        x, mask = self._order(a, b)
        if mask is not None and x.exact is not None:
            return self.number((x.exact ^ mask) % WORD)
        if mask == 0:
            return x
        if mask == WORD - 1:
            return self.invert(x)
        for one, other in ((a, b), (b, a)):
            if one.number in self._pairs:  # (p ^ q) ^ p = q
                p, q = self._pairs[one.number]
                if other in (p, q):
                    return q if other is p else p
        if a.number > b.number:
            a, b = b, a
        limit = WORD >> 1
        made = self.terms.call(Opaque("^", lambda _: (-limit, limit - 1)), [a, b])
        self._pairs[made.number] = a, b
        return made

    # --- products

    def multiply(self, a: Whole, b: Whole) -> Whole:
        """Return a b."""
        return self.terms.multiply(a, b)

    def multiply_signed(self, a: Whole, b: Whole) -> Whole:
        """Return the product of two numbers with a sign, all of its bits."""
        return self.terms.multiply(self.signed(a), self.signed(b))

    def multiply_high(self, a: Whole, b: Whole, c: Whole, rounded: bool) -> Whole:
        """Return the upper word of 2^32 c + a b, which may be rounded."""
        total = self.terms.add(self.multiply_signed(a, b), self.terms.scale(c, WORD))
        if rounded:
            total = self.terms.add(total, self.number(WORD >> 1))
        return self.terms.shift(total, 32)

    def multiply_halves(self, a: Whole, b: Whole, c: Whole) -> Whole:
        """Return c + the products of both halves."""
        low = self.terms.multiply(self.low_half(a), self.low_half(b))
        high = self.terms.multiply(self.high_half(a), self.high_half(b))
        return self.terms.add(self.terms.add(c, low), high)

    # --- limits and parts

    def limit(self, a: Whole, bits: int, signed: bool) -> Whole:
        """Return a number limited to bits."""
        ends = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
        return self.terms.clamp(self.signed(a), self.number(ends[0]), self.number(ends[1]))

    def pack(self, low: Whole, high: Whole) -> Whole:
        """Return the word of two halves."""
        upper = self.residue(high, 16, True)
        return self.terms.add(self.residue(low, 16, False), self.terms.scale(upper, 1 << 16))

    def add_bytes(self, a: Whole, b: Whole) -> Whole:
        """Return the sums of four bytes each, limited to 255, of numbers."""
        x, y = self._exact(a, "uqadd8"), self._exact(b, "uqadd8")
        sums = [min((x >> s & 255) + (y >> s & 255), 255) << s for s in (0, 8, 16, 24)]
        return self.number(sum(sums))

    def extend_bytes(self, a: Whole) -> Whole:
        """Return the first and the third byte as halves with a sign, of a number."""
        x = self._exact(a, "sxtb16")
        parts = [((x >> s & 255) ^ 128) - 128 for s in (0, 16)]
        return self.number((parts[0] % 65536) | (parts[1] % 65536) << 16)

    def count_zeros(self, a: Whole) -> Whole:
        """Return the zeros above the highest bit: how many of 2^0 .. 2^31 are above the number."""
        x, total = self.unsigned(a), self.number(0)
        for k in range(32):
            total = self.terms.add(total, self.terms.less(x, self.number(1 << k)))
        return total

    def choose(self, truth: Whole, a: Whole, b: Whole) -> Whole:
        """Return a where the truth is 1, b where it is 0."""
        return self.terms.choose(truth, a, b)


TABLE, WIDE, LIMITED = "table", "wide", "limited"
EDGE = 1 << 19
"""Where the table of tanh ends, on either side."""


@dataclass(frozen=True, eq=False)
class Domain:
    """All that a number can be, cut into pieces."""

    kind: str
    pieces: tuple[tuple[int, int], ...]
    symbols: tuple[Whole, ...]
    """One in each piece."""
    tanh: tuple[Whole, ...]
    """tanh of each, where the pieces are the table's lines."""


@dataclass(frozen=True, eq=False)
class WordCurve:
    """A word that depends on one number alone."""

    domain: Domain
    base: Whole
    """The number."""
    values: tuple[Whole, ...]
    """The word for each of the domain's symbols."""


Word: TypeAlias = Whole | WordCurve
Operation: TypeAlias = Callable[..., Whole]


class Curves:
    """Runs operations on words, of which some may be curves; every result is kept."""

    def __init__(self, words: Words) -> None:
        """Begin with none."""
        self.words, self.terms = words, words.terms
        self._domains: dict[tuple[str, int, int], Domain] = {}
        self._known: dict[tuple[object, ...], tuple[Whole, ...]] = {}
        self._settled: dict[tuple[Domain, Whole, tuple[Whole, ...]], Word] = {}

    # --- domains

    def _domain(self, kind: str, t: Whole, bits: int = 0) -> Domain:
        """Return a domain that holds every t: its ends are powers of two."""
        least = {TABLE: 19, WIDE: 33, LIMITED: bits}[kind]
        top = max(least, max(t.high, -t.low - 1).bit_length())
        key = kind, top, bits
        if key not in self._domains:
            self._domains[key] = self._make(kind, top, bits)
        return self._domains[key]

    def _make(self, kind: str, top: int, bits: int) -> Domain:
        if kind == TABLE:
            starts = [(i << 11) - EDGE for i in range(513)]
        elif kind == WIDE:
            starts = sorted({0, *(s << k for k in (30, 31, 32) for s in (-1, 1))})
        else:
            starts = [-(1 << (bits - 1)), 1 << (bits - 1)]
        ends = -(1 << top), 1 << top
        starts = [ends[0], *(s for s in starts if ends[0] < s < ends[1]), ends[1]]
        pieces = tuple((a, b - 1) for a, b in itertools.pairwise(starts))
        name = f"{kind} {top} {bits}"
        symbols = tuple(self.terms.symbol(f"{name}: {a} .. {b}", a, b) for a, b in pieces)
        lines: list[Whole] = []
        if kind == TABLE:
            lines = [self._line(*both) for both in zip(pieces, symbols, strict=True)]
        return Domain(kind, pieces, symbols, tuple(lines))

    def _line(self, piece: tuple[int, int], t: Whole) -> Whole:
        """Return tanh on a piece, from the formula's own nodes."""
        low, high = piece
        if low >= EDGE or high < -EDGE:
            return self.words.number(compute_tanh(low))
        i, nodes = (low + EDGE) >> 11, list_nodes()
        within = self.terms.subtract(t, self.words.number(low))
        line = self.terms.scale(within, nodes[i + 1] - nodes[i])
        return self.terms.add(self.words.number(nodes[i] << 11), line)

    # --- curves

    def begin(self, kind: str, t: Whole, bits: int = 0) -> WordCurve:
        """Return a number as a curve of itself."""
        domain = self._domain(kind, t, bits)
        return WordCurve(domain, t, domain.symbols)

    def apply(self, name: tuple[object, ...], operation: Operation, *words: Word) -> Word:
        """Return what an operation makes of words; `name` tells it from others.

        Raises:
            UndecidedError: it has no rule for them.
        """
        curve = next((w for w in words if isinstance(w, WordCurve)), None)
        if curve is None:
            return operation(*words)
        rows = [self._along(curve, word) for word in words]
        known = [row for row in rows if row is not None]
        if len(known) < len(rows):
            return self.apply(name, operation, *(self.settle(word) for word in words))
        key = (name, *known)
        if key not in self._known:
            self._known[key] = tuple(operation(*one) for one in zip(*known, strict=True))
        return self._recognize(WordCurve(curve.domain, curve.base, self._known[key]))

    def _along(self, curve: WordCurve, word: Word) -> tuple[Whole, ...] | None:
        """Return a word for each piece of a curve, if it depends on the same number."""
        symbols, base = curve.domain.symbols, curve.base
        if isinstance(word, WordCurve):
            same = word.domain is curve.domain and word.base is base
            return word.values if same else None
        if word.exact is not None:
            return (word,) * len(symbols)
        if word is base:
            return symbols
        if self.words.floor_word(base) is word:
            return tuple(self.words.floor_word(s) for s in symbols)
        for by in range(1, 32):
            if self.terms.shift(base, by) is word:
                return tuple(self.terms.shift(s, by) for s in symbols)
        return None

    def _recognize(self, curve: WordCurve) -> Word:
        """Return a curve, or a term where it is constant, or tanh with an offset."""
        first = curve.values[0]
        if first.exact is not None and all(v is first for v in curve.values):
            return first
        key = curve.domain, curve.base, curve.values
        if key not in self._settled:
            self._settled[key] = self._find_tanh(curve)
        return self._settled[key]

    def _find_tanh(self, curve: WordCurve) -> Word:
        domain, terms = curve.domain, self.terms
        if not domain.tanh:
            return curve
        values = [self.words.signed(v) for v in curve.values]
        offset = terms.subtract(values[0], domain.tanh[0])
        if offset.exact is None:
            return curve
        for value, line in zip(values, domain.tanh, strict=True):
            if terms.add(line, offset) is not value:
                return curve
        return terms.add(terms.call(TANH, [curve.base]), offset)

    def overflows(self, word: WordCurve, by: int) -> bool:
        """Return whether a shift to the left leaves 32 bits on a piece, of what has a limit."""
        ends = [self.words.signed(v) for v in word.values]
        limited = any(v.exact is None for v in ends) and any(v.exact is not None for v in ends)
        most = 1 << (31 - by) if by < 32 else 0
        return limited and any(v.low < -most or v.high >= most for v in ends)

    def settle(self, word: Word) -> Whole:
        """Return a word as a term.

        Raises:
            UndecidedError: it is no function that is known: a sign, a limit.
        """
        if not isinstance(word, WordCurve):
            return word
        values = [self.words.signed(v) for v in word.values]
        below, above = 0, len(values)
        while below < above and values[below] is values[0] and values[0].exact is not None:
            below += 1
        while above > below and values[above - 1] is values[-1] and values[-1].exact is not None:
            above -= 1
        if below == len(values):
            return values[0]
        if below == above:
            return self._two_levels(word, values[0], values[-1], below)
        found = self._limited(word, values, below, above)
        if found is None:
            raise UndecidedError("a function of one number that is none of those that are known")
        return found

    def _two_levels(self, word: WordCurve, low: Whole, high: Whole, edge: int) -> Whole:
        """Return low below an edge, high from it on."""
        terms = self.terms
        is_low = terms.less(word.base, self.words.number(word.domain.pieces[edge][0]))
        return terms.add(high, terms.multiply(is_low, terms.subtract(low, high)))

    def _limited(
        self, word: WordCurve, values: list[Whole], below: int, above: int
    ) -> Whole | None:
        """Return f times the number limited, + c, where the middle pieces are f times it + c."""
        terms, pieces = self.terms, word.domain.pieces
        symbols = word.domain.symbols
        constant, sums = terms.split(values[below])
        offset = self.words.number(constant)
        values = [terms.subtract(v, offset) for v in values]
        factor = sums[0][1] if sums else 0
        if factor < 1 or any(
            values[k] is not terms.scale(symbols[k], factor) for k in range(below, above)
        ):
            return None
        found = word.base
        for limits, edge, upper in ((values[above:], above, True), (values[:below], below, False)):
            if not limits:
                continue
            end, rest = divmod(limits[0].low, factor)
            inside = pieces[above - 1][1] <= end <= pieces[edge][0] if upper else (
                pieces[edge - 1][1] <= end <= pieces[below][0]
            )  # fmt: skip
            if rest or not inside:
                return None
            limit = self.words.number(end)
            found = terms.minimum(found, limit) if upper else terms.maximum(found, limit)
        return terms.add(terms.scale(found, factor), offset)
