"""Words of 32 bits over terms: a word is any term that is equal to it modulo 2^32.

Sums, products and left shifts need no more. Where an instruction reads a word as a number, the
number with its sign is found from the term's range; what does not fit is written out with a shift.
"""

from zerodrift_proof.equality.terms import Opaque, Terms, UndecidedError, Whole

WORD = 1 << 32
DOUBLE = Opaque("2^", lambda a: (1 << a[0].low, 1 << a[0].high), lambda v: 1 << v[0])
"""As `prove_kernels` has it."""


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
