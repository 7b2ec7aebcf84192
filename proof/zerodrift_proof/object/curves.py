"""Functions of one number, piece by piece, for what has no normal form of its own.

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
from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.words import Words

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
