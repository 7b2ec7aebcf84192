"""Instructions that set no flags of their own: products, halves, bytes, limits."""

from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.curves import LIMITED, TABLE, Curves, Word
from zerodrift_proof.object.instruction import Instruction
from zerodrift_proof.object.words import Words


class Parts:
    """What they make of words."""

    def __init__(self, words: Words, curves: Curves) -> None:
        """Make words with these."""
        self.words, self.curves, self.terms = words, curves, words.terms

    def shift(self, word: Word, kind: str, by: int) -> Word:
        """Return a word shifted by 0 to 32."""
        if by == 0:
            return word
        ways = {"lsl": self.words.lsl, "lsr": self.words.lsr, "asr": self.words.asr}
        way = ways.get(kind, self.words.ror)
        return self.curves.apply((kind, by), lambda a: way(a, by), word)

    def limit(self, word: Word, bits: int, signed: bool) -> Word:
        """Return a word limited to bits; to 20 it is what the table of tanh is read with."""
        words = self.words
        if isinstance(word, Whole) and signed and word.exact is None:
            t, edge = words.signed(word), 1 << (bits - 1)
            if bits == 20:
                word = self.curves.begin(TABLE, t)
            elif t.low < -edge or t.high >= edge:
                word = self._begin_limit(t, bits)
        return self.curves.apply(
            ("limit", bits, signed), lambda a: words.limit(a, bits, signed), word
        )

    def begin_lines(self, word: Word) -> Word:
        """Return a word whose line of tanh's table is asked for: a curve over these lines."""
        if isinstance(word, Whole) and word.exact is None:
            return self.curves.begin(TABLE, self.words.signed(word))
        return word

    def _begin_limit(self, t: Whole, bits: int) -> Word:
        """Return a number that is to be limited as a curve, of its half where it is even."""
        constant, sums = self.terms.split(t)
        every = [abs(n) for n in (constant, *(f for _, f in sums)) if n]
        twos = min((n & -n).bit_length() - 1 for n in every)
        twos = min(twos, bits - 1)
        base = self.curves.begin(LIMITED, self.terms.shift(t, twos), bits - twos)
        return self.shift(base, "lsl", twos)

    def make(self, one: Instruction, n: Word, m: Word, a: Word) -> Word:
        """Return what an instruction gives of its operands; one that it lacks is 0.

        Raises:
            UndecidedError: it has no rule.
        """
        words, terms, apply, name = self.words, self.terms, self.curves.apply, one.name
        if name in ("mul", "mla"):
            return apply(
                ("mla",), lambda x, y, z: terms.add(words.multiply(x, y), z), n, m, a
            )  # fmt: skip
        if name in ("smlad", "smuad"):
            return apply(("smlad",), words.multiply_halves, n, m, a)
        if name.startswith("smm"):
            rounded = name.endswith("r")
            way = words.multiply_high
            return apply((name,), lambda x, y, z: way(x, y, z, rounded), n, m, a)
        if name in ("pkhbt", "pkhtb"):
            m = self.shift(m, one.shift, one.by)
            if name == "pkhbt":
                return apply((name,), lambda x, y: words.pack(x, words.high_half(y)), n, m)
            return apply((name,), lambda x, y: words.pack(y, words.high_half(x)), n, m)
        if name in ("sxth", "uxth", "sxtb", "uxtb"):
            m, bits = self.shift(m, one.shift, one.by), 16 if name.endswith("h") else 8
            signed = name.startswith("s")
            return apply((name,), lambda x: words.residue(x, bits, signed), m)
        if name == "sxtb16":
            return apply((name,), words.extend_bytes, self.shift(m, "ror", one.by))
        if name == "uqadd8":
            return apply((name,), words.add_bytes, n, m)
        if name == "clz":
            return apply((name,), words.count_zeros, m)
        if name == "movt":
            return apply((name,), lambda x: words.pack(x, words.number(one.value)), n)
        raise UndecidedError(f"{name} has no rule")
