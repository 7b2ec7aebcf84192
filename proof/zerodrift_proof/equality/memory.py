"""What variables hold while C is run over terms, and the ways through its conditions.

The ways through conditions that are not known, and the memory that each of them writes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from zerodrift_proof.equality.syntax import BITS, TYPES, is_signed
from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole


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


MOST_PATHS = 64
MOST_STATEMENTS = 2_000_000
"""On one path: golden models need 60,000 at most, and a loop within a loop may have no end."""


@dataclass
class CPath:
    """One way through the conditions that were not known."""

    script: list[int]
    made: list[tuple[int, int]] = field(default_factory=list)
    assumed: dict[int, int] = field(default_factory=dict)
    """Number of a truth -> what it is taken to be here."""


class PathMachine(Numbers):
    """Goes every path, and keeps what each has written."""

    def __init__(self) -> None:
        """Begin with nothing known."""
        super().__init__()
        self.variables: dict[str, Holder] = {}
        self.path = CPath([])
        self.log: list[tuple[CellBlock, int, Cell]] = []
        """What was overwritten, the last one last."""
        self.depth = 0
        """Of calls."""
        self.statements = 0
        """That were run on this path."""

    # --- paths

    def explore(self, run: Callable[[], None]) -> Iterator[CPath]:
        """Go every way through something; yield after each."""
        script: list[int] = []
        for _ in range(MOST_PATHS):
            self.path, self.depth, self.log, self.variables = CPath(script), 0, [], {}
            self.statements = 0
            run()
            yield self.path
            made = self.path.made
            while made and made[-1][0] + 1 == made[-1][1]:
                made.pop()
            if not made:
                return
            script = [way for way, _ in made[:-1]] + [made[-1][0] + 1]
        raise UndecidedError(f"more than {MOST_PATHS} paths")

    def count_statement(self) -> None:
        """Count one more statement of this path.

        Raises:
            UndecidedError: they are more than the C of a model has.
        """
        self.statements += 1
        if self.statements > MOST_STATEMENTS:
            raise UndecidedError(f"more than {MOST_STATEMENTS} statements on one path")

    def fork(self, ways: int) -> int:
        """Return which way to go; all are gone, one after the other."""
        made = self.path.made
        way = self.path.script[len(made)] if len(made) < len(self.path.script) else 0
        made.append((way, ways))
        return way

    def decide(self, truth: Whole) -> Whole:
        """Return a truth as this path takes it."""
        if truth.exact is not None or not self.path.assumed:
            return truth
        assumed = self.path.assumed
        if truth.number in assumed:
            return self.terms.constant(assumed[truth.number])
        opposite = self.terms.negate(truth)
        if opposite.number in assumed:
            return self.terms.constant(1 - assumed[opposite.number])
        for one, sign in ((truth, 0), (opposite, 1)):
            if one.kind == "or":
                members = [self.decide(self.terms.atom(n)) for n in one.inner]
                found = self.terms.either(members)
                if found is not one:
                    found = self.decide(found) if found.exact is None else found
                    return self.terms.negate(found) if sign else found
        return truth

    def suppose(self, truth: Whole, value: int) -> None:
        """Take a truth to be 0 or 1 on this path."""
        self.path.assumed[truth.number] = value
        if truth.kind == "or" and value == 0:
            for number in truth.inner:
                self.suppose(self.terms.atom(number), 0)
        opposite = self.terms.negate(truth)
        if opposite.kind == "or" and value == 1:
            self.suppose(opposite, 0)

    # --- memory

    def write(self, block: CellBlock, at: int, cell: Cell) -> None:
        """Write a cell."""
        if block.constant:
            raise UndecidedError(f"{block.name} is constant, and is written")
        self.log.append((block, at, block.cells[at]))
        block.cells[at] = cell

    def load(self, place: Spot) -> Found:
        """Return what a cell holds."""
        cells = place.block.cells
        at = place.at.exact
        if at is not None:
            if not 0 <= at < len(cells):
                raise UndecidedError(f"element {at} of {place.block.name}, which has {len(cells)}")
            return self.as_found(place.block, cells[at])
        found: dict[int, Whole] = {}
        for n in list_positions(place.at, self.terms, len(cells)):
            cell = cells[n]
            if not isinstance(cell, Whole):
                raise UndecidedError(f"{place.block.name} is read before it is written")
            found[n] = cell
        return Number(self.terms.select(place.at, found), place.block.type)

    def as_found(self, block: CellBlock, cell: Cell) -> Found:
        """Return what a cell of a block holds, as a value of the C."""
        if cell is None:
            raise UndecidedError(f"{block.name} is read before it is written")
        if isinstance(cell, Whole) and block.type == "pointer":  # to nothing
            return Number(cell, "int32_t")
        return Number(cell, block.type) if isinstance(cell, Whole) else cell

    def store(self, place: Spot, value: Found) -> None:
        """Write a cell, wherever it may be."""
        block = place.block
        if isinstance(value, Spot | AddressOf):
            cell: Cell = value
        elif isinstance(value, Number) and block.type in TYPES:
            cell = self.convert(value, block.type).term
        else:
            raise UndecidedError(f"{block.name} is given something else")
        at = place.at.exact
        if at is not None:
            if not 0 <= at < len(block.cells):
                raise UndecidedError(f"element {at} of {block.name}, which has {len(block.cells)}")
            self.write(block, at, cell)
            return
        for n in list_positions(place.at, self.terms, len(block.cells)):
            here, before = self.terms.equal(place.at, self.terms.constant(n)), block.cells[n]
            if not isinstance(before, Whole) or not isinstance(cell, Whole):
                raise UndecidedError(f"{block.name} is written in part")
            self.write(block, n, self.terms.choose(here, cell, before))

    def cells(self, place: Spot, count: int) -> list[Whole]:
        """Return the numbers from a place on."""
        first, found = place.at.exact, []
        for k in range(count):
            at = self.terms.add(place.at, self.terms.constant(k))
            value = self.load(Spot(place.block, at, ())) if first is None else None
            if first is not None:
                if first + k >= len(place.block.cells) or first < 0:
                    raise UndecidedError(f"{count} elements of {place.block.name} from {first} on")
                value = self.as_found(place.block, place.block.cells[first + k])
            if not isinstance(value, Number):
                raise UndecidedError(f"{place.block.name} is no row of numbers")
            found.append(value.term)
        return found
