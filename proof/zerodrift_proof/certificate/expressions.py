"""C's operators, expressions and statements, with intervals in place of numbers.

C's own rules give every literal and every operation its type, which must hold the result. Shares no
code with the generator and needs the standard library only.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from zerodrift_proof.certificate.parser import (
    CAlone,
    CAssign,
    CBinary,
    CBlock,
    CCall,
    CCast,
    CChoose,
    CDeclare,
    CField,
    CFor,
    CIf,
    CIndex,
    CInteger,
    CList,
    CName,
    CNode,
    CNumbers,
    CReturn,
    CSizeof,
    CUnary,
    CWhile,
    Expression,
    Initialiser,
    Program,
    Statement,
    TypeName,
    Variable,
    is_name,
    walk,
)
from zerodrift_proof.certificate.values import (
    BITS,
    LIMITS,
    TYPES,
    Address,
    Block,
    Cell,
    FaultError,
    Found,
    Holder,
    NotUnderstoodError,
    Pointer,
    Struct,
    Value,
    anything,
    is_signed,
    make_block,
)

MOST_WORK = 2_000_000
"""Expressions and statements that are looked at before a model is taken to have no end."""
MIRRORED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "==", "!=": "!="}


class Arithmetic:
    """Calculates with intervals as C does, and notes what they reach."""

    def __init__(self, program: Program, int_bits: int) -> None:
        """Prepare for a program.

        Args:
            program: what the model's files declare.
            int_bits: of C's int, 16 or 32.
        """
        self.program = program
        self.int, self.unsigned = f"int{int_bits}_t", f"uint{int_bits}_t"
        self.packed = int_bits == 16
        """Whether structs are laid out without gaps."""
        self.bounds: dict[str, tuple[int, int, int]] = {}
        """Name -> lowest, highest, bits that hold them."""
        self.shifts: dict[str, int] = {}
        self.failures: list[str] = []
        self.pending: dict[str, tuple[int, int, int]] = {}
        """Bounds of the node that is being computed, by their last name."""
        self.shift: int | None = None
        """The shift of the node that is being computed."""
        self.row_of = ""
        """The node whose weights were multiplied last."""
        self._at, self._work = 0, 0

    # --- what is found

    def note(self, where: str, low: int, high: int, bits: int) -> None:
        """Note a bound that the C relies on; more than one visit widens it."""
        before = self.bounds.get(where, (low, high, bits))
        self.bounds[where] = (min(low, before[0]), max(high, before[1]), max(bits, before[2]))
        if low < -(1 << (bits - 1)) or high >= 1 << (bits - 1):
            self.fail(f"{where}: reaches {low} .. {high}; it does not fit {bits} bits")

    def note_shift(self, where: str, amount: int) -> None:
        """Note by how much something is shifted; it cannot be two amounts."""
        if self.shifts.setdefault(where, amount) != amount:
            self.fail(f"{where}: {amount} here, {self.shifts[where]} elsewhere")

    def fail(self, what: str) -> None:
        """Note what is wrong where the machine stands."""
        text = f"{self.program.place(self._at)}: {what}"
        if text not in self.failures:
            self.failures.append(text)

    def stand_at(self, at: int) -> None:
        """Remember where in the C this is; stop where there is no end to it."""
        self._at, self._work = at, self._work + 1
        if self._work > MOST_WORK:
            raise NotUnderstoodError(f"{self.program.place(at)}: no end after {MOST_WORK} steps")

    def not_understood(self, what: str) -> NotUnderstoodError:
        """Return what to raise where there is no rule."""
        return NotUnderstoodError(f"{self.program.place(self._at)}: {what}")

    # --- types

    def convert(self, value: Value, kind: str) -> Value:
        """Return a value in a C type: a signed one must hold it, an unsigned one wraps."""
        low, high = TYPES[kind]
        if low <= value.low and value.high <= high:
            if value.type == kind:
                return value
            return Value(value.low, value.high, kind, value.reach, value.copy_of)
        if is_signed(kind):
            self.fail(f"{value.low} .. {value.high} does not fit {kind}")
            return Value(low, high, kind)
        if value.exact is not None:
            wrapped = value.low % (high + 1)
            return Value(wrapped, wrapped, kind)
        return Value(low, high, kind)

    def keep(self, value: Value, kind: str) -> Value:
        """Return a value in a C type that must hold it: what stands there without a cast."""
        low, high = TYPES[kind]
        if value.low < low or value.high > high:
            self.fail(f"{value.low} .. {value.high} does not fit {kind}")
        return self.convert(value, kind)

    def promote(self, kind: str) -> str:
        """Return the type in which C calculates with one."""
        if BITS[kind] > BITS[self.int]:
            return kind
        return self.unsigned if kind == self.unsigned else self.int

    def common(self, a: str, b: str) -> str:
        """Return the type in which C calculates with two."""
        a, b = self.promote(a), self.promote(b)
        if BITS[a] != BITS[b]:
            return a if BITS[a] > BITS[b] else b
        return b if is_signed(a) else a

    def type_literal(self, node: CInteger) -> Value:
        """Return a literal in the first type of its list that holds it (C99 6.4.4.1)."""
        number, unsigned, longs = node.number, node.unsigned, node.longs
        kinds = [self.int, self.unsigned, "int32_t", "uint32_t", "int64_t", "uint64_t"]
        if longs:  # long has 32 bits or 64; a literal must not rest on which
            kinds = kinds[2:] if longs == 1 else kinds[4:]
        decimal = node.token[0] != "0" or number == 0
        for kind in kinds:
            if unsigned and is_signed(kind):
                continue
            if not unsigned and decimal and not is_signed(kind):
                continue
            if number <= TYPES[kind][1]:
                return Value(number, number, kind)
        raise self.not_understood(f"{node.token} has no type")

    # --- operators

    def combine(self, operator: str, a: Value, b: Value) -> Value:
        """Return a operator b in the type that C gives it, which must hold the result."""
        if operator in ("<<", ">>"):
            return self._shift(operator, a, b)
        kind = self.common(a.type, b.type)
        a, b = self.convert(a, kind), self.convert(b, kind)
        if operator in MIRRORED:
            return self._compare(operator, a, b)
        if operator in ("&", "|", "^"):
            return self._on_bits(operator, a, b, kind)
        if operator in ("/", "%"):
            if a.exact is None or b.exact is None or b.exact <= 0 or a.exact < 0:
                raise self.not_understood("a division")
            number = a.exact // b.exact if operator == "/" else a.exact % b.exact
            return Value(number, number, kind)
        if operator == "*":
            if "code" in self.pending:
                self.pending["code"] = (a.low, a.high, 32)
            ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
            low, high, reach = min(ends), max(ends), a.reach * b.reach
        elif operator == "+":
            low, high, reach = a.low + b.low, a.high + b.high, a.reach + b.reach
        else:
            low, high, reach = a.low - b.high, a.high - b.low, a.reach + b.reach
        return self.convert(Value(low, high, kind, reach), kind)

    def _compare(self, operator: str, a: Value, b: Value) -> Value:
        if operator in (">", ">="):
            operator, a, b = MIRRORED[operator], b, a
        if operator == "<":
            return self._truth(a.high < b.low, a.low >= b.high)
        if operator == "<=":
            return self._truth(a.high <= b.low, a.low > b.high)
        same = a.exact is not None and a.exact == b.exact
        apart = a.high < b.low or b.high < a.low
        return self._truth(same, apart) if operator == "==" else self._truth(apart, same)

    def _on_bits(self, operator: str, a: Value, b: Value, kind: str) -> Value:
        if min(a.low, b.low) < 0:
            raise self.not_understood(f"{operator} of a negative number")
        if a.exact is not None and b.exact is not None:
            both = {"&": a.exact & b.exact, "|": a.exact | b.exact, "^": a.exact ^ b.exact}
            return Value(both[operator], both[operator], kind)
        if operator == "&":
            return Value(0, min(a.high, b.high), kind)
        top = (1 << max(a.high, b.high).bit_length()) - 1
        return Value(max(a.low, b.low) if operator == "|" else 0, top, kind)

    def _shift(self, operator: str, a: Value, b: Value) -> Value:
        kind = self.promote(a.type)
        a = self.convert(a, kind)
        if b.exact is None or not 0 <= b.exact < BITS[kind]:
            raise FaultError(f"a shift of {BITS[kind]} bits by {b.low} .. {b.high}")
        if a.low < 0:
            raise self.not_understood("a shift of a negative number")
        if operator == "<<":
            return self.convert(Value(a.low << b.exact, a.high << b.exact, kind), kind)
        return Value(a.low >> b.exact, a.high >> b.exact, kind)

    def _truth(self, true: bool, false: bool) -> Value:
        return Value(int(true), int(not false), self.int)


OPPOSITE = {"<": ">=", ">": "<=", "<=": ">", ">=": "<", "==": "!=", "!=": "=="}


class Expressions(Arithmetic):
    """Evaluates expressions, and notes what they reach."""

    def __init__(self, program: Program, known: Mapping[str, int], int_bits: int) -> None:
        """Prepare for a program.

        Args:
            program: what the model's files declare.
            known: macros of the runtime that are numbers.
            int_bits: of C's int.
        """
        super().__init__(program, int_bits)
        self.known = known
        self.inputs: set[int] = set()
        """The blocks that hold codes of the inputs."""
        self.variables: dict[str, Holder] = {}
        self.constants: dict[str, Block | Struct] = {}

    def size_of(self, of: str) -> int:
        """Return a struct's or number's size: without gaps, or each field aligned to itself."""
        if of in TYPES:
            return BITS[of] // 8
        fields = self.program.structs.get(of)
        if fields is None:
            raise self.not_understood(f"the size of {of}")
        size, widest = 0, 1
        for variable in fields:
            width, count = BITS[variable.type.name] // 8, 1
            for length in variable.sizes:
                count *= self.constant(length)
            if not self.packed:
                size, widest = -(-size // width) * width, max(widest, width)
            size += width * count
        return size if self.packed else -(-size // widest) * widest

    def constant(self, node: Initialiser) -> int:
        """Return the number of an expression that has to be one."""
        value = self.evaluate(node)
        if not isinstance(value, Value) or value.exact is None:
            raise self.not_understood("a number that is not known")
        return value.exact

    # --- evaluation

    def evaluate(self, node: Initialiser) -> Found:
        """Return what an expression gives: of an array or a struct, where it lies."""
        self.stand_at(node.at)
        found = self._on(node)
        if isinstance(found, Pointer) and not found.sizes:
            return self.load(found)
        self._at = node.at
        return found

    def _on(self, node: Initialiser) -> Found:
        """Return what the rule for a kind of expression gives."""
        match node:
            case CName():
                return self._on_name(node.name)
            case CInteger():
                return self.type_literal(node)
            case CField():
                return self._on_field(node)
            case CIndex():
                return self._on_index(node)
            case CBinary():
                return self._on_binary(node)
            case CUnary():
                return self._on_unary(node.operator, node.of)
            case CCall():
                return self._on_call(node.name, node.arguments)
            case CCast():
                return self._on_cast(node.type, node.of)
            case CChoose():
                return self._on_choose(node.condition, node.first, node.second)
            case CSizeof():
                return self._on_sizeof(node.of)
        raise self.not_understood("a list where an expression is expected")

    def number(self, node: Initialiser) -> Value:
        """Return the value of an expression that has to be a number."""
        value = self.evaluate(node)
        if not isinstance(value, Value):
            raise self.not_understood("something that is no number")
        return value

    def load(self, pointer: Pointer) -> Value:
        """Return what one element can be."""
        block = pointer.block
        if pointer.first.exact is None:
            value, copy_of = pointer.values(1)[0], None
        else:
            value, copy_of = block.value(pointer.first.low), None
            if block.count == 1:
                copy_of = (id(block), block.version)
        if value.copy_of == copy_of:
            return value
        return Value(value.low, value.high, value.type, value.reach, copy_of)

    def locate(self, node: Expression) -> Found:
        """Return where a variable, field or element lies: a Pointer; or a Struct or Address."""
        self.stand_at(node.at)
        if isinstance(node, CName):
            return self._on_name(node.name)
        if isinstance(node, CField):
            return self._on_field(node)
        if isinstance(node, CIndex):
            return self._on_index(node)
        if isinstance(node, CUnary) and node.operator == "*":
            found = self.evaluate(node.of)
            if isinstance(found, Address):
                return found
        raise self.not_understood("this is not a variable, a field or an element")

    def _on_name(self, name: str) -> Found:
        found: Holder | None = self.variables.get(name)
        if found is None:
            found = self.constants.get(name)
        if isinstance(found, Block):
            zero = Value(0, 0)
            return Pointer(found, zero, found.sizes, found.constant)
        if found is not None:
            return found
        number = self.known.get(name, LIMITS.get(name))
        if number is None:
            raise self.not_understood(f"'{name}' is not known")
        if name in LIMITS:
            kind = self.promote(f"{name.split('_', maxsplit=1)[0].lower()}_t")
        else:
            kind = self.type_literal(CInteger(self._at, str(number), number)).type
        return Value(number, number, kind)

    def _on_field(self, node: CField) -> Pointer:
        of, operator, name = node.of, node.operator, node.name
        holder = self.evaluate(of) if operator == "->" else self.locate(of)
        if isinstance(holder, Address) and operator == "->" and not holder.bytes:
            struct, constant = holder.struct, holder.constant
        elif isinstance(holder, Struct) and operator == ".":
            struct, constant = holder, False
        else:
            raise self.not_understood(f"{operator}{name}")
        if (table := struct.tables.get(name)) is not None:
            return table
        if name not in struct.fields:
            raise self.not_understood(f"{struct.type} has no {name}")
        block = struct.fields[name]
        return Pointer(block, Value(0, 0), block.sizes, constant or block.constant)

    def _on_index(self, node: CIndex) -> Pointer:
        array, index = self.evaluate(node.of), self.number(node.index)
        if not isinstance(array, Pointer):
            raise self.not_understood("an index into something that is no array")
        size, *inner = array.sizes
        if index.low < 0 or index.high >= size:
            raise FaultError(
                f"index {index.low} .. {index.high} of {array.block.name}, which has {size} there"
            )
        stride = 1
        for length in inner:
            stride *= length
        first = Value(array.first.low + index.low * stride, array.first.high + index.high * stride)
        step = (
            array.step
            if index.exact is not None
            else math.gcd(stride, array.first.width and array.step)
        )
        return replace(array, first=first, sizes=tuple(inner), step=step)

    def _on_unary(self, operator: str, of: Expression) -> Found:
        if operator == "&":
            return self._address(of)
        if operator == "*":
            raise self.not_understood("a * outside of an assignment")
        value = self.number(of)
        kind = self.promote(value.type)
        value = self.convert(value, kind)
        if operator == "+":
            return value
        if operator == "-":
            return self.convert(Value(-value.high, -value.low, kind, value.reach), kind)
        if operator == "~":
            ends = (-value.high - 1, -value.low - 1)
            return self.convert(Value(*ends, kind), kind)
        return self._truth(value.high == value.low == 0, not value.low <= 0 <= value.high)

    def _address(self, of: Expression) -> Pointer | Address:
        if isinstance(of, CIndex):
            array, index = self.evaluate(of.of), self.number(of.index)
            if not isinstance(array, Pointer) or len(array.sizes) != 1:
                raise self.not_understood("an address in something that is no row of numbers")
            if index.low < 0 or index.high >= array.sizes[0]:
                raise FaultError(
                    f"the address of element {index.low} .. {index.high} of {array.block.name},"
                    f" which has {array.sizes[0]} there"
                )
            first = Value(array.first.low + index.low, array.first.high + index.high)
            return replace(array, first=first, sizes=(array.sizes[0] - index.high,), step=1)
        found = self.locate(of)
        if isinstance(found, Struct):
            return Address(found)
        if isinstance(found, Pointer) and not found.sizes:
            return replace(found, sizes=(1,))
        raise self.not_understood("an address")

    def _on_sizeof(self, of: str | Expression) -> Value:
        if not isinstance(of, str):
            found = self.locate(of)
            if not isinstance(found, Address | Struct):
                raise self.not_understood("a size")
            of = found.struct.type if isinstance(found, Address) else found.type
        size = self.size_of(of)
        return Value(size, size, "uint64_t" if not self.packed else self.unsigned)

    def _on_cast(self, kind: TypeName, of: Expression) -> Value | Address:
        value = self.evaluate(of)
        if kind.pointer:
            if isinstance(value, Address) and kind.name == "uint8_t":
                if value.constant and not kind.constant:
                    raise FaultError("a cast that takes const away")
                return Address(value.struct, kind.constant, True)
            raise self.not_understood("a cast of a pointer")
        if not isinstance(value, Value) or kind.name not in TYPES:
            raise self.not_understood("a cast")
        if kind.name == "int32_t" and value.type == "int64_t":
            self.note_plain_sum(value)
        return self.convert(value, kind.name)

    def note_plain_sum(self, value: Value) -> None:
        """A node's 64-bit value that went through no shift is a sum."""
        if self.shift is None and not self.pending:
            self.pending["sum"] = (-value.reach, value.reach, 64)

    def _on_binary(self, node: CBinary) -> Value:
        if node.operator in ("&&", "||"):
            return self._both(node.operator, node.left, node.right)
        return self.combine(node.operator, self.number(node.left), self.number(node.right))

    def _both(self, operator: str, left: Expression, right: Expression) -> Value:
        """&& and ||: the second is looked at only where the first does not decide."""
        value = self.number(left)
        decided = Value(int(operator == "||"), int(operator == "||"), self.int)
        open_, zero = value.low <= 0 <= value.high, value.exact == 0
        if not open_ or zero:
            if zero == (operator == "&&"):
                return decided
            return self._as_truth(self.number(right))
        if holds_call(right):
            if self.choose(2) == 0:
                return decided
            return self._as_truth(self.number(right))
        return self._as_truth(self.number(right)).join(decided)

    def _as_truth(self, value: Value) -> Value:
        return self._truth(not value.low <= 0 <= value.high, value.exact == 0)

    def _on_choose(self, condition: Expression, first: Expression, second: Expression) -> Value:
        extremum = self._find_extremum(condition, first, second)
        if extremum is not None:
            return extremum
        test = self._as_truth(self.number(condition))
        results = []
        for truth, branch in ((True, first), (False, second)):
            if test.exact == int(not truth):
                continue
            kept = self.assume(condition, truth)
            results.append(self.number(branch))
            for block, cells in kept:
                block.cells = cells
        kind = self.common(results[0].type, results[-1].type)
        if len(results) == 1:
            return self.convert(results[0], kind)
        return self.convert(results[0], kind).join(self.convert(results[1], kind))

    def _find_extremum(
        self, condition: Expression, first: Expression, second: Expression
    ) -> Value | None:
        """a > b ? a : b and its like: each end of it is the larger, or smaller, of two ends."""
        if not isinstance(condition, CBinary) or condition.operator not in ("<", "<=", ">", ">="):
            return None
        compared = (condition.left, condition.right)
        names = [node.name for node in (*compared, first, second) if isinstance(node, CName)]
        if len(names) < 4 or names[0] == names[1] or {*names[:2]} != {*names[2:]}:
            return None
        a, b = map(self.number, compared)
        if a.type != b.type or b.type != "int32_t":
            return None
        choose = max if condition.operator.startswith(">") == (names[0] == names[2]) else min
        return Value(choose(a.low, b.low), choose(a.high, b.high), a.type)

    # --- what a condition says of variables

    def assume(self, node: Expression, truth: bool) -> list[tuple[Block, list[Cell]]]:
        """Narrow the variables that a condition compares; return what they were."""
        if not isinstance(node, CBinary):
            return []
        operator, left, right = node.operator, node.left, node.right
        if operator in ("&&", "||"):
            if truth != (operator == "&&"):
                return []
            return self.assume(left, truth) + self.assume(right, truth)
        if operator not in MIRRORED:
            return []
        operator = operator if truth else OPPOSITE[operator]
        return self._narrow(left, operator, right) + self._narrow(right, MIRRORED[operator], left)

    def _narrow(
        self, node: Expression, operator: str, other: Expression
    ) -> list[tuple[Block, list[Cell]]]:
        if not isinstance(node, CName | CField) or holds_call(other):
            return []
        place = self.locate(node)
        if not isinstance(place, Pointer) or place.sizes or place.block.constant:
            return []
        value, limit = place.block.value(0), self.number(other)
        if min(value.low, limit.low) < 0 and not is_signed(self.common(value.type, limit.type)):
            return []
        low, high = value.low, value.high
        if operator in ("<", "<="):
            high = min(high, limit.high - (operator == "<"))
        elif operator in (">", ">="):
            low = max(low, limit.low + (operator == ">"))
        elif operator == "==":
            low, high = max(low, limit.low), min(high, limit.high)
        elif limit.exact is not None:
            low, high = low + (low == limit.exact), high - (high == limit.exact)
        if low > high:
            return []
        kept = [(place.block, place.block.cells)]
        place.block.cells = [Value(low, high, value.type)]
        return kept

    # --- what a model adds

    def choose(self, ways: int) -> int:
        """Return which of some ways to go; all are gone, one after the other."""
        raise NotImplementedError

    def _on_call(self, name: str, nodes: tuple[Expression, ...]) -> Found:
        raise NotImplementedError


def holds_call(node: CNode) -> bool:
    """Return whether an expression calls anything."""
    return any(isinstance(part, CCall) for part in walk(node))


# The statements of a generated model's C, run over intervals.
#
# Both arms of a branch are run where its condition is not known, and a loop for any index at once
# where its ends are not.

MOST_ROUNDS = 100_000


class Statements(Expressions):
    """Runs statements, in the variables of one function at a time."""

    def __init__(
        self, program: Program, prefix: str, known: Mapping[str, int], int_bits: int
    ) -> None:
        """Prepare for a program.

        Args:
            program: what the model's files declare.
            prefix: of the model.
            known: macros of the runtime that are numbers.
            int_bits: of C's int.
        """
        super().__init__(program, known, int_bits)
        self.prefix = prefix
        self._live: list[Block] = []
        self._inputs: list[Struct] = []
        self._returned: Found = None

    def as_number(self, value: Found) -> Value:
        """Return a value that has to be a number."""
        if not isinstance(value, Value):
            raise self.not_understood("something that is no number")
        return value

    def as_plain(self, value: Value) -> Value:
        """Return a value as it lies in a variable: what it was computed of is forgotten."""
        return Value(value.low, value.high, value.type, sum_of=value.sum_of)

    def make_struct(self, kind: str, name: str, any_bits: bool, zero: bool = False) -> Struct:
        """Return a variable of a struct: of any bits, of zeros, or never written."""
        struct = Struct(name, kind)
        for variable in self.program.structs[kind]:
            sizes = [self.constant(size) for size in variable.sizes]
            type_ = variable.type.name
            any_cell = Value(0, 0, type_) if zero else anything(type_) if any_bits else None
            block = make_block(f"{name}->{variable.name}", type_, sizes, any_cell)
            struct.fields[variable.name] = block
            self._live.append(block)
        if kind in (f"{self.prefix}_input_t", f"{self.prefix}_codes_t"):
            self.inputs |= {id(block) for block in struct.fields.values()}
            self._inputs.append(struct)  # an id is no other's while the block lives
        return struct

    def _run_block(self, block: CBlock) -> bool:
        """Run a block in braces; tell whether it returns. Its own variables end with it."""
        outer, live = self.variables, len(self._live)
        self.variables = dict(outer)
        returned = False
        for statement in block.statements:
            returned = self._run(statement)
            if returned:
                break
        self.variables = outer
        del self._live[live:]
        return returned

    def _run(self, node: Statement) -> bool:
        """Run a statement; tell whether it returns."""
        self.stand_at(node.at)
        match node:
            case CBlock():
                return self._run_block(node)
            case CReturn():
                self._returned = None if node.value is None else self.evaluate(node.value)
                return True
            case CIf():
                return self._run_branch(node.condition, node.then, node.other)
            case CFor():
                self._run_loop(node)
            case CDeclare():
                self._declare(node.variable)
            case CAssign():
                self._assign(node.operator, node.target, node.source)
            case CAlone():
                self.evaluate(node.of)
            case CWhile():
                raise self.not_understood("a loop that is not counted by its own variable")
        return False

    def _run_branch(self, condition: Expression, then: CBlock, other: CBlock | CIf | None) -> bool:
        test = self._as_truth(self.number(condition))
        if test.exact is not None:
            branch = then if test.exact else other
            return self._run(branch) if branch is not None else False
        if holds_return(then) or (other is not None and holds_return(other)):
            truth = self.choose(2) == 0
            self.assume(condition, truth)
            branch = then if truth else other
            return self._run(branch) if branch is not None else False
        before = self._keep()
        self.assume(condition, True)
        self._run(then)
        after = self._keep()
        self._restore(before)
        self.assume(condition, False)
        if other is not None:
            self._run(other)
        self._join(after)
        return False

    def _keep(self) -> list[tuple[Block, list[Cell], int]]:
        return [(block, list(block.cells), block.version) for block in self._live]

    def _restore(self, kept: list[tuple[Block, list[Cell], int]]) -> None:
        for block, cells, _ in kept:
            block.cells = list(cells)

    def _join(self, kept: list[tuple[Block, list[Cell], int]]) -> bool:
        """Let every cell be what it is or what it was then; tell whether any changed."""
        changed = False
        for block, cells, _ in kept:
            for at, before in enumerate(cells):
                now = block.cells[at]
                if now is before or now == before:
                    continue
                changed = True
                if isinstance(now, Value) and isinstance(before, Value):
                    block.cells[at] = now.join(before)
                else:
                    block.cells[at] = None
        return changed

    def _run_loop(self, loop: CFor) -> None:
        """Run a counting loop step by step; where its ends are not known, for any index at once."""
        kind, name, body = loop.type, loop.name, loop.body
        start, stop = self.convert(self.number(loop.first), kind), self.number(loop.end)
        if self.common(stop.type, kind) != kind or name in self.variables or assigns(body, name):
            raise self.not_understood("a loop that is not counted by its own variable")
        extra = int(loop.operator == "<=")
        if start.exact is not None and stop.exact is not None:
            rounds = stop.exact + extra - start.exact
            if rounds > MOST_ROUNDS:
                raise self.not_understood(f"a loop of {rounds} rounds")
            alike = not mentions(body, name)
            for index in range(start.exact, start.exact + rounds):
                before = self._keep() if alike else []
                if self._run_round(kind, name, Value(index, index, kind), body):
                    raise self.not_understood("a loop that returns")
                if alike and all(block.cells == cells for block, cells, _ in before):
                    return  # every further round does the same
            return
        last = max(stop.high + extra - 1, start.low)
        any_index = Value(start.low, last, kind)
        for _ in range(4):
            before = self._keep()
            self._run_round(kind, name, any_index, body)
            if not self._join(before):
                return
        raise self.not_understood("a loop that goes on growing")

    def _run_round(self, kind: str, name: str, index: Value, body: CBlock) -> bool:
        self.variables[name] = Block(name, kind, (), [index], constant=True)
        returned = self._run_block(body)
        del self.variables[name]
        return returned

    def _declare(self, variable: Variable) -> None:
        kind, name = variable.type, variable.name
        if name in self.variables:
            raise self.not_understood(f"{name} hides another")
        if kind.pointer:
            self._declare_pointer(variable)
            return
        zero = isinstance(variable.first, CNumbers) and variable.first.numbers == [0]
        if kind.name in self.program.structs:
            if variable.sizes or (variable.first is not None and not zero):
                raise self.not_understood(f"how {name} begins")
            struct = self.make_struct(kind.name, name, any_bits=False, zero=zero)
            for block in struct.fields.values():
                block.constant = kind.constant
            self.variables[name] = struct
            return
        if kind.name not in TYPES:
            if not isinstance(variable.first, CList) or not kind.constant or variable.sizes:
                raise self.not_understood(f"a variable of {kind.name}")
            self.variables[name] = self.make_layer(name, kind.name, variable.first)
            return
        noted = kind.constant and kind.name == "int32_t"
        if name == "sum" or noted:
            self.pending, self.shift = {}, None
        sizes = [self._size(size) for size in variable.sizes]
        block = make_block(name, kind.name, sizes, None)
        if isinstance(variable.first, CList | CNumbers):
            self._fill_list(block, variable.first)
        elif variable.first is not None:
            if sizes:
                raise self.not_understood(f"how {name} begins")
            found = self.number(variable.first)
            value = self.keep(found, kind.name)
            if name != "sum":
                value = replace(self.as_plain(value), copy_of=found.copy_of)
                if noted:
                    self.note(name, value.low, value.high, 32)
                    self._note_pending(name)
            block.cells = [value]
        block.constant = kind.constant
        self.variables[name] = block
        self._live.append(block)

    def make_layer(self, name: str, kind: str, first: CList) -> Struct:
        """Return a variable of a struct of the runtime."""
        raise NotImplementedError

    def _size(self, node: Expression) -> int:
        size = self.constant(node)
        if not 0 < size <= MOST_ROUNDS:
            raise FaultError(f"an array of {size}")
        return size

    def _fill_list(self, block: Block, first: CList | CNumbers) -> None:
        if isinstance(first, CNumbers):
            found = [Value(n, n, "int64_t") for n in first.numbers]
        else:
            found = [self.number(n) for n in first.items]
        if len(block.sizes) != 1 or len(found) > block.count or not found:
            raise FaultError(f"{len(found)} values for {block.name} of {block.sizes}")
        cells = [self.as_plain(self.keep(v, block.type)) for v in found]
        block.cells = [*cells, *[Value(0, 0, block.type)] * (block.count - len(cells))]

    def _declare_pointer(self, variable: Variable) -> None:
        """A pointer to constants is all that a model has."""
        if variable.first is None or variable.sizes or not variable.type.constant:
            raise self.not_understood(f"the pointer {variable.name}")
        found = self.evaluate(variable.first)
        if not isinstance(found, Pointer) or found.block.type != variable.type.name:
            raise FaultError(f"{variable.name} points to another type")
        self.variables[variable.name] = replace(found, constant=True)

    def _note_pending(self, name: str) -> None:
        """Note what was computed on the way to a node's value."""
        for last, (low, high, bits) in self.pending.items():
            self.note(f"{name}.{last}", low, high, bits)
        if self.shift is not None:
            self.note_shift(f"{name}.shift", self.shift)
        self.pending, self.shift = {}, None

    def _assign(self, operator: str, target: Expression, source: Expression) -> None:
        """x = e; x op= e; where x is a variable, a field, an element, or a whole struct."""
        place = self.locate(target)
        if isinstance(place, Address):
            self._assign_struct(operator, place, source)
            return
        if not isinstance(place, Pointer) or place.sizes:
            raise self.not_understood("this cannot be assigned to")
        if self._counts_up(operator, place, source):
            return
        if operator == "=":
            found = self.number(source)
        else:
            found = self.combine(operator[:-1], self.load(place), self.number(source))
        self.stand_at(target.at)
        kind = place.block.type
        value = self.keep(found, kind)
        if isinstance(target, CIndex) and isinstance(target.of, CName):
            self._note_element(target.of.name, place, value)
        place.fill([value if is_name(target, "sum") else self.as_plain(value)])

    def _note_element(self, name: str, place: Pointer, value: Value) -> None:
        """Note what is stored in an element of a local array: a row of a node."""
        at = place.first.exact
        if at is None or value.type.startswith("u"):
            return
        own = self.variables.get("sum")
        found = own.value(0) if isinstance(own, Block) else value
        where = f"{self.row_of if name == 'result' else name}[{at}]"
        self.note(where, -found.reach, found.reach, 64 if found.type == "int64_t" else 32)
        if name == "result" and "limits" in self.pending:
            self.note(f"{where}.limit", *self.pending["limits"][:2], 16)
        self.pending.clear()
        self._note_pending(where)

    def _counts_up(self, operator: str, place: Pointer, source: Expression) -> bool:
        """s->x += (copy < limit) ? 1 : 0; where `copy` is what the field holds."""
        if operator != "+=" or not isinstance(source, CChoose) or "->" not in place.block.name:
            return False
        condition, ends = source.condition, (source.first, source.second)
        plain = [n.number for n in ends if isinstance(n, CInteger)]
        if not isinstance(condition, CBinary) or condition.operator != "<" or plain != [1, 0]:
            return False
        copied = self.locate(condition.left) if isinstance(condition.left, CName) else None
        limit = self.constant(condition.right)
        before = place.block.value(0)
        held = copied.block.value(0) if isinstance(copied, Pointer) and not copied.sizes else None
        if held is None or held.copy_of != (id(place.block), place.block.version):
            return False
        self.note(self.name_of(place.block), before.low, before.high + 1, 32)
        high = max(min(before.high + 1, limit), before.high)
        place.fill([self.convert(Value(before.low, high, place.block.type), place.block.type)])
        return True

    def table_of(self, struct: Struct, name: str) -> list[int]:
        """Return the constants that a field points to; none where it points nowhere."""
        table = struct.tables[name]
        return [] if table is None else [v.low for v in table.values(table.count)]

    def name_of(self, block: Block) -> str:
        """Return the node and signal that a field of the state is named after."""
        stem, _, last = block.name.rpartition("->")[2].rpartition("_")
        return f"{stem}.{last}"

    def _assign_struct(self, operator: str, place: Address, source: Expression) -> None:
        found = self.locate(source)
        free = operator == "=" and not place.constant and not place.bytes
        if not free or not isinstance(found, Struct) or found.type != place.struct.type:
            raise self.not_understood("this cannot be assigned")
        for name, block in found.fields.items():
            values = Pointer(block, Value(0, 0), (block.count,)).values(block.count)
            target = place.struct.fields[name]
            Pointer(target, Value(0, 0), (target.count,)).fill(values)


def holds_return(node: Statement) -> bool:
    """Return whether a statement returns anywhere inside."""
    return any(isinstance(part, CReturn) for part in walk(node))


def mentions(node: Statement, name: str) -> bool:
    """Return whether a variable stands anywhere in a statement."""
    return any(is_name(part, name) for part in walk(node))


def assigns(node: Statement, name: str) -> bool:
    """Return whether a statement changes a variable."""
    return any(isinstance(part, CAssign) and is_name(part.target, name) for part in walk(node))
