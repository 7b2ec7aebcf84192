"""What a model's own checksum of its state (`..._sum_up`) is taken over.

Every word of a sum changes it: the sum before is turned by one bit and the word is added. A state
of which every element is in exactly one word, alone or as one half of it, cannot change in one bit
and keep its sum. Shares no code with the generator and needs the standard library only.
"""

from itertools import product
from typing import TypeGuard

from zerodrift_proof.certificate.expressions import Expressions
from zerodrift_proof.certificate.nodes import (
    CAssign,
    CBinary,
    CBlock,
    CCall,
    CCast,
    CDeclare,
    CField,
    CFor,
    CIndex,
    CNode,
    CReturn,
    Expression,
    Statement,
    Variable,
    is_name,
)
from zerodrift_proof.certificate.values import FaultError, NotUnderstoodError

FIELD = "check"
"""Where a state holds its sum."""
NUMBERS = {
    "zd_check_word": ("uint8_t", "uint16_t", "uint32_t"),
    "zd_check_number": ("int8_t", "uint8_t", "int16_t", "uint16_t", "int32_t"),
    "zd_check_i64": ("int64_t",),
}
"""Function -> types of which it loses no bit."""
HALVES = ("int16_t", "uint16_t")
"""Types of which two are one word."""
ROWS = {"zd_check_i32": "int32_t", "zd_check_i16": "int16_t"}


def is_summed(machine: Expressions, prefix: str) -> bool:
    """Tell whether a model has a checksum of its state, of which every field but its own is part.

    Raises:
        NotUnderstoodError: a statement without a rule.
        FaultError: an element of the state is not in the sum, or is there twice.
    """
    fields = machine.program.structs[f"{prefix}_state_t"]
    function = machine.program.functions.get(f"{prefix}_sum_up")
    own = [f for f in fields if f.name == FIELD]
    if function is None and not own:
        return False
    if function is None or len(own) != 1 or own[0].type.name != "uint32_t" or own[0].sizes:
        raise NotUnderstoodError(f"{prefix}_state_t: a checksum without {prefix}_sum_up, or beside")
    parameters = function.parameters
    kind = parameters[0].type if len(parameters) == 1 else None
    if kind is None or not kind.pointer or kind.name != f"{prefix}_state_t":
        raise NotUnderstoodError(f"{prefix}_sum_up is not given a state")
    if function.result != "uint32_t":
        raise NotUnderstoodError(f"{prefix}_sum_up returns no uint32_t")
    reader = _ChecksumReader(machine, parameters[0].name, [f for f in fields if f.name != FIELD])
    reader.read(function.body)
    return True


class _ChecksumReader:
    def __init__(self, machine: Expressions, state: str, fields: list[Variable]) -> None:
        self._machine, self._state = machine, state
        self._types = {f.name: f.type.name for f in fields}
        self._sizes = {f.name: [machine.constant(size) for size in f.sizes] for f in fields}
        self._seen = {
            (f, at): 0 for f, sizes in self._sizes.items() for at in product(*map(range, sizes))
        }
        """(field, indices of an element, none for a number) -> in how many words it is."""

    def _error(self, node: CNode) -> NotUnderstoodError:
        place = self._machine.program.place(node.at)
        return NotUnderstoodError(f"{place}: no rule for this in a checksum of the state")

    def read(self, body: CBlock) -> None:
        if len(body.statements) < 2:
            raise self._error(body)
        first, *middle, last = body.statements
        declared = first.variable if isinstance(first, CDeclare) else None
        if declared is None or declared.name != "check" or declared.type.name != "uint32_t":
            raise self._error(first)
        begun = declared.first
        if not isinstance(begun, CCall):
            raise self._error(first)
        if begun.name != "zd_check_word" or len(begun.arguments) != 2:
            raise self._error(first)
        for argument in begun.arguments:  # the first word is turned, the second added
            self._take_number(begun.name, argument)
        for node in middle:
            if isinstance(node, CFor):
                self._read_rows(node)
            else:
                self._take(node)
        if not isinstance(last, CReturn) or not is_name(last.value, "check"):
            raise self._error(last)
        for (field, at), words in self._seen.items():
            if words != 1:
                element = field + "".join(f"[{k}]" for k in at)
                raise FaultError(f"s->{element} is in {words} words of its sum")

    def _take(self, node: Statement, index: str = "", rounds: int = 0) -> None:
        """check = zd_check_...(check, s->x), or s->x[2], or of two halves; of rows (check, s->x, N)
        and (check, s->x[k], N)."""
        if (
            not isinstance(node, CAssign)
            or node.operator != "="
            or not is_name(node.target, "check")
        ):
            raise self._error(node)
        call = node.source
        if not isinstance(call, CCall) or not call.arguments:
            raise self._error(node)
        name, (check, *arguments) = call.name, call.arguments
        if not is_name(check, "check"):
            raise self._error(node)
        if name in NUMBERS and len(arguments) == 1 and not index:
            if not isinstance(arguments[0], CBinary | CCast):
                self._take_number(name, arguments[0])
            elif name == "zd_check_word":
                self._take_halves(name, arguments[0])
            else:
                raise self._error(node)
            return
        if name not in ROWS or len(arguments) != 2:
            raise self._error(node)
        of, count = arguments
        if index:
            if not isinstance(of, CIndex) or not is_name(of.index, index):
                raise self._error(node)
            of = of.of
        field = self._name_of(of)
        sizes = (
            [rounds, self._machine.constant(count)] if index else [self._machine.constant(count)]
        )
        if self._types[field] != ROWS[name] or self._sizes[field] != sizes:
            raise FaultError(f"s->{field} of {self._sizes[field]} is summed as {name} of {sizes}")
        for at in product(*map(range, sizes)):
            self._seen[field, at] += 1

    def _take_number(self, name: str, node: Expression) -> None:
        self._count(node, NUMBERS[name], name)

    def _take_halves(self, name: str, node: Expression) -> None:
        """(uint16_t)a, or (uint16_t)a | ((uint32_t)(uint16_t)b << 16)."""
        if isinstance(node, CBinary):
            high = node.right
            if node.operator != "|" or not isinstance(high, CBinary) or high.operator != "<<":
                raise self._error(node)
            wide = high.left
            if self._machine.constant(high.right) != 16 or not _is_cast(wide, "uint32_t"):
                raise self._error(high)
            self._take_half(name, wide.of)
            node = node.left
        self._take_half(name, node)

    def _take_half(self, name: str, node: Expression) -> None:
        if not _is_cast(node, "uint16_t"):
            raise self._error(node)
        self._count(node.of, HALVES, f"half of {name}")

    def _count(self, node: Expression, types: tuple[str, ...], summed_as: str) -> None:
        """Note that s->x, s->x[2] or s->x[1][2] is in a word."""
        indices: tuple[int, ...] = ()
        while isinstance(node, CIndex):
            indices = (self._machine.constant(node.index), *indices)
            node = node.of
        field = self._name_of(node)
        if self._types[field] not in types or (field, indices) not in self._seen:
            raise FaultError(
                f"s->{field}, {self._types[field]} of {self._sizes[field]}, at {list(indices)},"
                f" is summed as {summed_as}"
            )
        self._seen[field, indices] += 1

    def _name_of(self, node: Expression) -> str:
        if not isinstance(node, CField) or node.operator != "->":
            raise self._error(node)
        if not is_name(node.of, self._state) or node.name not in self._types:
            raise self._error(node)
        return node.name

    def _read_rows(self, node: CFor) -> None:
        """for (uint32_t k = 0; k < N; k++) { check = zd_check_i16(check, s->x[k], I); }"""
        body = node.body.statements
        if self._machine.constant(node.first) != 0 or node.operator != "<" or len(body) != 1:
            raise self._error(node)
        self._take(body[0], node.name, self._machine.constant(node.end))


def _is_cast(node: Expression, type_: str) -> TypeGuard[CCast]:
    return isinstance(node, CCast) and node.type.name == type_ and not node.type.pointer
