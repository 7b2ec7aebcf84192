"""Runs C over terms: its memory holds what each variable is for any input, in normal form.

Where a condition is not known, both arms are run and what they leave is joined; where an arm
returns, each is a path of its own. What C does not define, and what has no rule, is not decided.
Shares no code with what wrote the C.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from zerodrift_proof.equality.syntax import (
    BITS,
    LIMITS,
    TYPES,
    Expression,
    Initialiser,
    PAlone,
    PAssign,
    PBinary,
    PBlock,
    PCall,
    PCast,
    PChoose,
    PDeclare,
    PField,
    PIf,
    PIndex,
    PInteger,
    PList,
    PName,
    PNode,
    PNumbers,
    PProgram,
    PReturn,
    PSizeof,
    PTyped,
    PUnary,
    PVariable,
    PWhile,
    Statement,
    is_signed,
    walk,
)
from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole

# What variables hold while C is run over terms, and the ways through its conditions.
#
# The ways through conditions that are not known, and the memory that each of them writes.


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


# Runs C over terms: every variable holds what it is for any input, in the normal form.

MOST_ROUNDS = 200_000
DEEPEST = 40
MOST_CELLS = 1_000_000
"""Of one array: no chip has room for more."""
Rule: TypeAlias = "Callable[[TermMachine, list[Found]], Found]"
"""What a function does that is not run."""


class TermMachine(PathMachine):
    """Runs functions of a program."""

    def __init__(self, program: PProgram, rules: dict[str, Rule]) -> None:
        """Read the constants.

        Args:
            program: model and runtime.
            rules: what functions do that are not run.
        """
        super().__init__()
        self.program, self.rules = program, rules
        self.globals: dict[str, Holder] = {}
        self.watch: dict[str, dict[str, Holder]] = {}
        """PFunction -> the variables that its last call ended with, of those asked for."""
        self.forking = False
        """Whether every condition that is not known is a path of its own."""
        self._at = 0
        self._returned: Found = None
        for variable in program.constants:
            self._declare(variable, self.globals)
        for claim in program.claims:
            if self.number(claim).term.low < 1:
                raise UndecidedError("a claim that does not hold, or is not known")
        for holder in self.globals.values():
            for block in [holder] if isinstance(holder, CellBlock) else holder.fields.values():
                block.constant = True

    @property
    def place(self) -> str:
        """Where in the C this stands."""
        return self.program.place(self._at)

    # --- memory

    def make_instance(self, kind: str, name: str, zero: bool = False) -> Instance:
        """Return a struct, of zeros or with nothing written."""
        made = Instance(name, kind)
        for variable in self.program.structs[kind]:
            sizes = tuple(self._exact(size) for size in variable.sizes)
            count = 1
            for size in sizes:
                count *= size
            type_ = "pointer" if variable.type.pointer else variable.type.name
            cell: Cell = self.terms.constant(0) if zero and type_ in TYPES else None
            cells = [cell] * count
            made.fields[variable.name] = CellBlock(f"{name}.{variable.name}", type_, sizes, cells)
        return made

    # --- functions

    def call(self, name: str, arguments: Sequence[Found]) -> Found:
        """Run a function."""
        function = self.program.functions.get(name)
        if function is None or self.depth >= DEEPEST:
            raise UndecidedError(f"there is no rule for {name}")
        if len(arguments) != len(function.parameters):
            raise UndecidedError(f"{name} of {len(arguments)} arguments")
        kept, returned = self.variables, self._returned
        self.variables, self._returned = {}, None
        for parameter, argument in zip(function.parameters, arguments, strict=True):
            self._bind(parameter, argument)
        self.depth += 1
        ended = self._run_all(function.body.statements)
        if not ended and function.result != "void":
            raise UndecidedError(f"{name} may end without a result")
        self.depth -= 1
        result = self._returned
        if name in self.watch:
            self.watch[name] = dict(self.variables)
        self.variables, self._returned = kept, returned
        if isinstance(result, Number):
            return self.convert(result, function.result)
        return result

    def _bind(self, parameter: PVariable, argument: Found) -> None:
        name, kind = parameter.name, parameter.type
        if name in self.variables:
            raise UndecidedError(f"two parameters {name}")
        if parameter.sizes or kind.pointer:
            if isinstance(argument, Number):
                raise UndecidedError(f"a number given for {name}")
            if isinstance(argument, Spot):
                refuse_other_type(kind.name, argument, name)
                if argument.block.constant and not kind.constant:
                    raise UndecidedError(f"something constant given for {name}")
            elif isinstance(argument, AddressOf) and argument.of.type != kind.name:
                raise UndecidedError(f"another type than {kind.name} given for {name}")
            elif not isinstance(argument, AddressOf):
                raise UndecidedError(f"nothing that a pointer holds is given for {name}")
            self.variables[name] = CellBlock(name, "pointer", (), [argument])
            return
        if not isinstance(argument, Number):
            raise UndecidedError(f"no number given for {name}")
        block = CellBlock(name, kind.name, (), [self.convert(argument, kind.name).term])
        self.variables[name] = block

    # --- statements

    def _run_all(self, statements: Sequence[Statement]) -> bool:
        return any(self.run(statement) for statement in statements)

    def run(self, node: Statement) -> bool:
        """Run a statement; tell whether it returns."""
        self._at = node.at
        self.count_statement()
        match node:
            case PBlock():
                outer = self.variables
                self.variables = dict(outer)
                ended = self._run_all(node.statements)
                if self.depth and not ended:
                    self.variables = outer
                return ended
            case PReturn():
                self._returned = None if node.value is None else self.evaluate(node.value)
                return True
            case PIf():
                return self._branch(node)
            case PWhile():
                return self._repeat(node)
            case PDeclare():
                self._declare(node.variable, self.variables)
            case PAssign():
                self._assign(node)
            case PAlone():
                self.evaluate(node.of)
        return False

    def _branch(self, node: PIf) -> bool:
        truth = self.truth(node.condition)
        if truth.exact is None and (self.forking or _returns(node)):
            way = self.fork(2) == 0
            self.suppose(truth, int(way))
            truth = self.terms.constant(int(way))
        if truth.exact is not None:
            taken = node.then if truth.exact else node.other
            return self.run(taken) if taken is not None else False
        outer, self.log = self.log, []
        self.run(node.then)
        first, self.log = self._undo(), []
        if node.other is not None:
            self.run(node.other)
        second = self._undo()
        self.log = outer
        for key in {**first, **second}:
            block, at = (first.get(key) or second[key])[:2]
            before = block.cells[at]
            a = first[key][2] if key in first else before
            b = second[key][2] if key in second else before
            if not isinstance(a, Whole) or not isinstance(b, Whole):
                if a is b:
                    self.write(block, at, a)
                    continue
                raise UndecidedError(f"{block.name} is written on one way alone")
            self.write(block, at, self.terms.choose(truth, a, b))
        return False

    def _undo(self) -> dict[tuple[int, int], tuple[CellBlock, int, Cell]]:
        """Take back what was written; return it."""
        after: dict[tuple[int, int], tuple[CellBlock, int, Cell]] = {}
        for block, at, _ in self.log:
            after[id(block), at] = block, at, block.cells[at]
        for block, at, before in reversed(self.log):
            block.cells[at] = before
        return after

    def _repeat(self, node: PWhile) -> bool:
        for _ in range(MOST_ROUNDS):
            truth = self.truth(node.condition)
            if truth.exact is None:
                raise UndecidedError("a loop of which the end is not known")
            if not truth.exact:
                return False
            if self.run(node.body):
                raise UndecidedError("a loop that returns")
        raise UndecidedError(f"a loop of more than {MOST_ROUNDS} rounds")

    def _declare(self, variable: PVariable, into: dict[str, Holder]) -> None:
        kind, name, first = variable.type, variable.name, variable.first
        if name in into and (into is self.globals or name not in self.variables):
            raise UndecidedError(f"{name} stands here twice")
        if kind.pointer:
            found = self.evaluate(first) if first is not None else None
            if not isinstance(found, Spot | AddressOf):
                raise UndecidedError(f"where {name} points to")
            if isinstance(found, Spot) and found.block.type != kind.name:
                raise UndecidedError(f"{name} points to another type")
            into[name] = CellBlock(name, "pointer", (), [found])
            return
        sizes = tuple(self._exact(size) for size in variable.sizes)
        if kind.name in self.program.structs:
            if sizes:
                raise UndecidedError(f"an array of {kind.name}")
            zero = isinstance(first, PNumbers) and first.numbers == [0]
            if isinstance(first, PNumbers | PList) and not zero:
                into[name] = self._fill_struct(kind.name, name, first)
            elif first is None or zero:
                into[name] = self.make_instance(kind.name, name, zero)
            else:
                raise UndecidedError(f"how {name} begins")
            return
        count = 1
        for size in sizes:
            count *= size
        if count > MOST_CELLS:
            raise UndecidedError(f"{name} has {count} elements")
        block = CellBlock(name, kind.name, sizes, [None] * count)
        if first is not None:
            block.cells = self._initial(first, kind.name, sizes)
        block.constant = kind.constant
        into[name] = block

    def _initial(self, first: Initialiser, kind: str, sizes: tuple[int, ...]) -> list[Cell]:
        if not sizes:
            return [self.convert(self.number(first), kind).term]
        inner = 1
        for size in sizes[1:]:
            inner *= size
        if isinstance(first, PNumbers) and len(sizes) == 1:
            found: list[Cell] = [self._fit_constant(n, kind) for n in first.numbers]
        elif isinstance(first, PNumbers) and first.numbers == [0]:
            found = [self.terms.constant(0)]
        elif isinstance(first, PList):
            found = [c for item in first.items for c in self._initial(item, kind, sizes[1:])]
        else:
            raise UndecidedError("how an array begins")
        if len(found) > inner * sizes[0]:
            raise UndecidedError(f"{len(found)} values for {inner * sizes[0]}")
        return found + [self.terms.constant(0)] * (inner * sizes[0] - len(found))

    def _fit_constant(self, value: int, kind: str) -> Whole:
        low, high = TYPES[kind]
        if not low <= value <= high:
            raise UndecidedError(f"{value} does not fit {kind}")
        return self.terms.constant(value)

    def _fill_struct(self, kind: str, name: str, first: PNumbers | PList) -> Instance:
        made = self.make_instance(kind, name)
        numbers = isinstance(first, PNumbers)
        items: Sequence[Initialiser] = (
            [PInteger(first.at, str(n), n) for n in first.numbers]
            if isinstance(first, PNumbers)
            else first.items
        )
        if len(items) != len(made.fields) or (numbers and not items):
            raise UndecidedError(f"{len(items)} values for {len(made.fields)} fields of {name}")
        fields = self.program.structs[kind]
        for variable, block, item in zip(fields, made.fields.values(), items, strict=True):
            if block.type == "pointer":
                found = self.evaluate(item)
                if isinstance(found, Spot) and found.block.type != variable.type.name:
                    raise UndecidedError(f"{block.name} points to another type")
                if isinstance(found, Number) and found.term.exact == 0:
                    block.cells = [self.terms.constant(0)]
                elif isinstance(found, Spot | AddressOf):
                    block.cells = [found]
                else:
                    raise UndecidedError(f"what {block.name} points to")
            else:
                block.cells = self._initial(item, block.type, block.sizes)
        return made

    def _assign(self, node: PAssign) -> None:
        place = self.locate(node.target)
        if isinstance(place, Instance):
            source = self.locate(node.source)
            if not isinstance(source, Instance) or source.type != place.type:
                raise UndecidedError("this cannot be assigned")
            for name, block in source.fields.items():
                for at, cell in enumerate(block.cells):
                    self.write(place.fields[name], at, cell)
            return
        if not isinstance(place, Spot) or place.sizes:
            raise UndecidedError("this cannot be assigned to")
        value: Found = self.evaluate(node.source)
        if node.operator != "=":
            before = self.load(place)
            if not isinstance(before, Number) or not isinstance(value, Number):
                raise UndecidedError("this is no number")
            value = self.operate(node.operator[:-1], before, value)
        self.store(place, value)

    # --- expressions

    def _exact(self, node: Initialiser) -> int:
        value = self.number(node).term.exact
        if value is None:
            raise UndecidedError("a number that is not known")
        return value

    def number(self, node: Initialiser) -> Number:
        """Return what an expression gives, which must be a number."""
        found = self.evaluate(node)
        if not isinstance(found, Number):
            raise UndecidedError("something that is no number")
        return found

    def truth(self, node: Expression) -> Whole:
        """Return whether an expression is not 0, as this path takes it."""
        found = self.evaluate(node)
        if not isinstance(found, Number):
            raise UndecidedError("a condition that is no number")
        if found.term.is_truth:
            return self.decide(found.term)
        zero = self.terms.equal(found.term, self.terms.constant(0))
        return self.decide(self.terms.negate(zero))

    def evaluate(self, node: Initialiser) -> Found:
        """Return what an expression gives; of an array or a struct, where it lies."""
        self._at = node.at
        match node:
            case PInteger():
                return self._literal(node)
            case PTyped():
                return self.constant(node.number, node.type)
            case PBinary():
                return self._binary(node)
            case PName() | PField() | PIndex():
                found = self.locate(node)
                if isinstance(found, Spot) and not found.sizes:
                    return self.load(found)
                return found
            case PCall():
                return self._call(node)
            case PCast():
                return self._cast(node)
            case PUnary():
                return self._unary(node)
            case PChoose():
                return self._choose(node)
            case PSizeof():
                return self._size_of(node)
        raise UndecidedError("a list where an expression is expected")

    def locate(self, node: Expression) -> Found:
        """Return where a variable, a field or an element lies."""
        match node:
            case PName():
                holder = self.variables.get(node.name) or self.globals.get(node.name)
                if holder is None:
                    limit = LIMITS.get(node.name)
                    if limit is None:
                        raise UndecidedError(f"'{node.name}' is not known")
                    kind = f"{node.name.split('_', maxsplit=1)[0].lower()}_t"
                    return self.constant(limit, self.promote(kind))
                if isinstance(holder, Instance):
                    return holder
                return Spot(holder, self.terms.constant(0), holder.sizes)
            case PField():
                of = self.evaluate(node.of) if node.operator == "->" else self.locate(node.of)
                instance = of.of if isinstance(of, AddressOf) and not of.bytes else of
                if not isinstance(instance, Instance) or node.name not in instance.fields:
                    raise UndecidedError(f"{node.operator}{node.name}")
                block = instance.fields[node.name]
                return Spot(block, self.terms.constant(0), block.sizes)
            case PIndex():
                array, index = self.evaluate(node.of), self.number(node.index).term
                if not isinstance(array, Spot):
                    raise UndecidedError("an index into something that is no array")
                return self._element(array, index)
            case PUnary() if node.operator == "*":
                found = self.evaluate(node.of)
                if isinstance(found, AddressOf):
                    return found.of
                if isinstance(found, Spot):
                    return Spot(found.block, found.at, ())
        raise UndecidedError("this is not a variable, a field or an element")

    def _element(self, array: Spot, index: Whole) -> Spot:
        size, *inner = array.sizes or (-1,)
        if size >= 0 and (index.low < 0 or index.high >= size):
            raise UndecidedError(
                f"index {index.low} .. {index.high} of {array.block.name}, of {size}"
            )
        stride = 1
        for length in inner:
            stride *= length
        at = self.terms.add(array.at, self.terms.scale(index, stride))
        return Spot(array.block, at, tuple(inner))

    def _literal(self, node: PInteger) -> Number:
        kinds = ["int32_t", "uint32_t", "int64_t", "uint64_t"]
        decimal = node.token[0] != "0" or node.number == 0
        for kind in kinds:
            signed = not kind.startswith("u")
            if (node.unsigned and signed) or (not node.unsigned and decimal and not signed):
                continue
            if node.number <= TYPES[kind][1]:
                return self.constant(node.number, kind)
        raise UndecidedError(f"{node.token} has no type")

    def _size_of(self, node: PSizeof) -> Number:
        """Return the size of a struct: a number of its own for each, which a compiler knows."""
        kind = node.of
        if not isinstance(kind, str):
            of = self.locate(kind)
            if not isinstance(of, Instance):
                raise UndecidedError("the size of something that is no struct")
            kind = of.type
        if kind not in self.program.structs:
            raise UndecidedError(f"the size of {kind}")
        return self.size_of(kind)

    def size_of(self, kind: str) -> Number:
        """Return the size of a struct."""
        return Number(self.terms.symbol(f"sizeof {kind}", 1, 2**31), "uint64_t")

    def _binary(self, node: PBinary) -> Found:
        if node.operator in ("&&", "||"):
            first = self.truth(node.left)
            if first.exact is not None and first.exact == int(node.operator == "||"):
                return Number(first, "int32_t")
            if first.exact is None and _has_effect(node.right):
                raise UndecidedError("a call that may not be made")
            both = [first, self.truth(node.right)]
            join = self.terms.either if node.operator == "||" else self.terms.both
            return Number(join(both), "int32_t")
        left, right = self.evaluate(node.left), self.evaluate(node.right)
        if isinstance(left, Number) and isinstance(right, Number):
            return self.operate(node.operator, left, right)
        if node.operator in ("==", "!=") and isinstance(right, Number) and right.term.exact == 0:
            return self.constant(int(node.operator == "!="))  # a pointer to something
        raise UndecidedError(f"{node.operator} of these")

    def _unary(self, node: PUnary) -> Found:
        if node.operator == "&":
            if isinstance(node.of, PIndex):
                array, index = self.evaluate(node.of.of), self.number(node.of.index).term
                if not isinstance(array, Spot) or len(array.sizes) > 1:
                    raise UndecidedError("an address in something that is no row")
                return Spot(array.block, self.terms.add(array.at, index), (-1,))
            found = self.locate(node.of)
            if isinstance(found, Instance):
                return AddressOf(found)
            if isinstance(found, Spot) and not found.sizes:
                return Spot(found.block, found.at, (1,))
            raise UndecidedError("an address")
        if node.operator == "*":
            place = self.locate(node)
            return self.load(place) if isinstance(place, Spot) else place
        value = self.number(node.of)
        kind = self.promote(value.type)
        x = self.convert(value, kind).term
        if node.operator == "-":
            return self.fit(self.terms.scale(x, -1), kind)
        if node.operator == "+":
            return Number(x, kind)
        if node.operator == "~":
            return self.fit(self.terms.subtract(self.terms.constant(-1), x), kind)
        return Number(self.terms.equal(x, self.terms.constant(0)), "int32_t")

    def _cast(self, node: PCast) -> Found:
        value, kind = self.evaluate(node.of), node.type
        if kind.name == "void" and not kind.pointer:
            return None
        if kind.pointer:
            if isinstance(value, AddressOf) and kind.name == "uint8_t":
                return AddressOf(value.of, True)
            raise UndecidedError("a cast of a pointer")
        if not isinstance(value, Number) or kind.name not in TYPES:
            raise UndecidedError("a cast")
        return self.convert(value, kind.name)

    def _choose(self, node: PChoose) -> Found:
        truth = self.truth(node.condition)
        if truth.exact is not None:
            other = node.second if truth.exact else node.first
            found = self.number(node.first if truth.exact else node.second)
            kind = self._type_of(other, found.type)
            return self.convert(found, self.common(found.type, kind))
        if _has_effect(node.first) or _has_effect(node.second):
            raise UndecidedError("a call that may not be made")
        a, b = self.number(node.first), self.number(node.second)
        kind = self.common(a.type, b.type)
        a, b = self.convert(a, kind), self.convert(b, kind)
        return Number(self.terms.choose(truth, a.term, b.term), kind)

    def _type_of(self, node: Expression, otherwise: str) -> str:
        """Return the type of the arm that is not taken, where it can be told without taking it."""
        if _has_effect(node):
            return otherwise
        try:
            return self.number(node).type
        except UndecidedError:
            return otherwise

    def _call(self, node: PCall) -> Found:
        name = node.name
        arguments = [self.evaluate(argument) for argument in node.arguments]
        self._at = node.at
        rule = self.rules.get(name)
        if rule is None:
            return self.call(name, arguments)
        if (function := self.program.functions.get(name)) is not None:
            for parameter, argument in zip(function.parameters, arguments, strict=True):
                if isinstance(argument, Spot):
                    refuse_other_type(parameter.type.name, argument, parameter.name)
        return rule(self, arguments)


def refuse_other_type(kind: str, given: Spot, name: str) -> None:
    """Refuse a pointer to numbers of another type than a function reads."""
    if given.block.type != kind:
        raise UndecidedError(f"another type than {kind} given for {name}")


def _returns(node: PNode) -> bool:
    return any(isinstance(part, PReturn) for part in walk(node))


def _has_effect(node: PNode) -> bool:
    """Whether it calls anything that is not known to change nothing."""
    calls = [part.name for part in walk(node) if isinstance(part, PCall)]
    return any(
        not name.startswith("zd_round_shift") and not name.endswith(("_is_sound", "_sum_up"))
        for name in calls
    )
