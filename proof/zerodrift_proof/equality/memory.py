"""What the variables of a C program hold while it is run over terms."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole
from zerodrift_proof.equality.types import BITS, TYPES, is_signed


@dataclass(frozen=True, slots=True)
class Number:
    """A term of a C type."""

    term: Whole
    type: str


@dataclass(eq=False, slots=True)
class CellBlock:
    """A variable: one cell or an array of them, rows one after the other."""

    name: str
    type: str
    sizes: tuple[int, ...]
    cells: "list[Cell]"
    constant: bool = False


@dataclass(eq=False, slots=True)
class Instance:
    """A variable of a struct type."""

    name: str
    type: str
    fields: "dict[str, CellBlock]" = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Spot:
    """From a cell of a block on: `sizes` of what lies there; () is a single cell."""

    block: CellBlock
    at: Whole
    sizes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class AddressOf:
    """Of a struct, or of its bytes where it was cast."""

    of: Instance
    bytes: bool = False


Cell: TypeAlias = Whole | Spot | AddressOf | None
"""A number, what a pointer points to, or nothing written yet."""
Found: TypeAlias = Number | Spot | AddressOf | Instance | None
Holder: TypeAlias = CellBlock | Instance


class Numbers:
    """C's types over terms: what does not fit is not decided."""

    def __init__(self) -> None:
        """Begin with no terms."""
        self.terms = Terms()

    def constant(self, value: int, kind: str = "int32_t") -> Number:
        """Return a number."""
        return Number(self.terms.constant(value), kind)

    def convert(self, value: Number, kind: str) -> Number:
        """Return a number in a type: a signed one must hold it, an unsigned one wraps."""
        if value.type == kind:
            return value
        return self.fit(value.term, kind)

    def fit(self, term: Whole, kind: str) -> Number:
        """Return a term in a type: a signed one must hold it, an unsigned one wraps."""
        low, high = TYPES[kind]
        if low <= term.low and term.high <= high:
            return Number(term, kind)
        if is_signed(kind):
            raise UndecidedError(f"{term.low} .. {term.high} may not fit {kind}")
        return Number(self.terms.modulo(term, BITS[kind]), kind)

    def promote(self, kind: str) -> str:
        """Return the type in which C calculates with one; int has 32 bits."""
        return kind if BITS[kind] >= 32 else "int32_t"

    def common(self, a: str, b: str) -> str:
        """Return the type in which C calculates with two."""
        a, b = self.promote(a), self.promote(b)
        if BITS[a] != BITS[b]:
            return a if BITS[a] > BITS[b] else b
        return b if is_signed(a) else a

    def operate(self, operator: str, a: Number, b: Number) -> Number:
        """Return a operator b as C gives it."""
        terms = self.terms
        if operator in ("<<", ">>"):
            return self._shift(operator, a, b)
        kind = self.common(a.type, b.type)
        x, y = self.convert(a, kind).term, self.convert(b, kind).term
        match operator:
            case "+":
                return self.fit(terms.add(x, y), kind)
            case "-":
                return self.fit(terms.subtract(x, y), kind)
            case "*":
                return self.fit(terms.multiply(x, y), kind)
            case "<":
                return Number(terms.less(x, y), "int32_t")
            case ">":
                return Number(terms.less(y, x), "int32_t")
            case "<=":
                return Number(terms.at_most(x, y), "int32_t")
            case ">=":
                return Number(terms.at_most(y, x), "int32_t")
            case "==":
                return Number(terms.equal(x, y), "int32_t")
            case "!=":
                return Number(terms.negate(terms.equal(x, y)), "int32_t")
            case "&" | "|" | "^":
                return self.fit(self._on_bits(operator, x, y), kind)
            case "/" | "%":
                if x.exact is not None and y.exact is not None and x.exact >= 0 < y.exact:
                    whole, rest = divmod(x.exact, y.exact)
                    return self.constant(whole if operator == "/" else rest, kind)
        raise UndecidedError(f"{operator} of these")

    def _shift(self, operator: str, a: Number, b: Number) -> Number:
        kind, terms = self.promote(a.type), self.terms
        x, by = self.convert(a, kind).term, b.term.exact
        if operator == "<<" and by is None and x.exact == 1 and b.term.low >= 0:
            if b.term.high >= BITS[kind] - 1:
                raise UndecidedError("a shift beyond the type")
            return self.fit(self.double(b.term), kind)
        if by is None or not 0 <= by < BITS[kind]:
            raise UndecidedError(f"a shift by {b.term.low} .. {b.term.high}")
        if operator == ">>":
            return self.fit(terms.shift(x, by), kind)
        if x.low < 0:
            raise UndecidedError("a left shift of what may be negative")
        return self.fit(terms.scale(x, 1 << by), kind)

    def double(self, by: Whole) -> Whole:
        """Return 2^by."""
        from zerodrift_proof.equality.terms import Opaque

        power = Opaque(
            "2^", lambda a: (1 << a[0].low, 1 << a[0].high), lambda values: 1 << values[0]
        )
        return self.terms.call(power, [by])

    def _on_bits(self, operator: str, x: Whole, y: Whole) -> Whole:
        terms = self.terms
        if x.exact is not None and y.exact is not None:
            a, b = x.exact, y.exact
            return terms.constant({"&": a & b, "|": a | b, "^": a ^ b}[operator])
        if y.exact is None and x.exact is not None:
            x, y = y, x
        mask = y.exact
        if operator == "&":
            if mask is not None and mask >= 0 and mask & (mask + 1) == 0:
                return terms.modulo(x, mask.bit_length())
            if mask == -1:
                return x
            if x.is_truth and y.is_truth:
                return terms.both([x, y])
        if operator == "^" and mask in (0, -1):
            return x if mask == 0 else terms.subtract(terms.constant(-1), x)
        if operator == "|" and x.is_truth and y.is_truth:
            return terms.either([x, y])
        if operator == "|" and mask is not None and mask > 0 and mask & (mask - 1) == 0:
            return self._set_bit(x, mask)
        if operator == "|" and x.low >= 0 and y.low >= 0:
            for one, other in ((x, y), (y, x)):
                constant, sums = terms.split(other)
                every = [constant, *(f for _, f in sums)]
                common = min((n & -n) for n in every if n)
                if one.high < common:
                    return terms.add(one, other)
        raise UndecidedError(f"{operator} of these")

    def _set_bit(self, x: Whole, bit: int) -> Whole:
        """x | bit, of an x that is a sum of different bits, each set by a truth."""
        terms = self.terms
        constant, sums = terms.split(x)
        bits = [abs(f) for _, f in sums]
        rest = constant + sum(f for _, f in sums if f < 0)  # f (1 - t) for each f < 0
        plain = all(f & (f - 1) == 0 and not rest & f for f in bits) and rest >= 0
        plain = plain and len(set(bits)) == len(bits)
        if not plain or not all(terms.atom(n).is_truth for n, _ in sums):
            raise UndecidedError("| of something that is no sum of bits")
        if bit not in bits:
            return x if rest & bit else terms.add(x, terms.constant(bit))
        number, factor = sums[bits.index(bit)]
        own = terms.atom(number) if factor > 0 else terms.negate(terms.atom(number))
        return terms.add(x, terms.scale(terms.negate(own), bit))


def list_positions(at: Whole, terms: Terms, count: int) -> Sequence[int]:
    """Return where in an array a position can be.

    Raises:
        UndecidedError: beyond its ends.
    """
    if at.low < 0 or at.high >= count:
        raise UndecidedError(f"position {at.low} .. {at.high} of an array of {count}")
    constant, sums = terms.split(at)
    step = 0
    for _, factor in sums:
        step = abs(factor) if step == 0 else _common(step, abs(factor))
    if step <= 1:
        return range(at.low, at.high + 1)
    first = at.low + (constant - at.low) % step
    return range(first, at.high + 1, step)


def _common(a: int, b: int) -> int:
    while b:
        a, b = b, a % b
    return a
