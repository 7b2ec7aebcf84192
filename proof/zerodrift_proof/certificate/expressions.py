"""The expressions of a generated model's C, with intervals in place of numbers.

C's own rules give every literal its type. Shares no code with the generator and
needs the standard library only.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from zerodrift_proof.certificate.arithmetic import MIRRORED, Arithmetic
from zerodrift_proof.certificate.nodes import (
    CBinary,
    CCall,
    CCast,
    CChoose,
    CField,
    CIndex,
    CInteger,
    CName,
    CNode,
    CSizeof,
    CUnary,
    Expression,
    Initialiser,
    Program,
    TypeName,
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
    Pointer,
    Struct,
    Value,
    is_signed,
)

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
