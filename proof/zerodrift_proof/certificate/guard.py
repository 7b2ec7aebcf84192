"""A model's own test of its state, and its checksum of it.

What a model's own checksum of its state (`..._sum_up`) is taken over.

Every word of a sum changes it: the sum before is turned by one bit and the word is added. A state
of which every element is in exactly one word, alone or as one half of it, cannot change in one bit
and keep its sum.

The test is a list of comparisons, of which nothing is believed but what stands there. Shares no
code with the generator and needs the standard library only.
"""

from dataclasses import dataclass
from itertools import product
from typing import TypeGuard

from zerodrift_proof.certificate.expressions import Expressions
from zerodrift_proof.certificate.parser import (
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
    CNode,
    CReturn,
    Expression,
    Statement,
    Variable,
    is_name,
)
from zerodrift_proof.certificate.values import (
    BITS,
    TYPES,
    FaultError,
    NotUnderstoodError,
    Struct,
    Value,
    anything,
    is_signed,
)

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


Limits = dict[str, list[tuple[int, int]]]


@dataclass(frozen=True)
class Guard:
    """The states that the test lets through."""

    identity: int
    most_steps: int
    early: bool
    """Whether a state of 0 steps passes with anything in its other fields."""
    limits: Limits
    """Field -> lowest and highest of each of its elements."""

    def admit(self, state: Struct, fresh: bool) -> None:
        """Let a state be any that passes: with steps = 0 if `fresh`, otherwise from 1 on."""
        for name, block in state.fields.items():
            block.version += 1
            limits = self.limits.get(name)
            if limits is None or (fresh and self.early):
                block.cells = [anything(block.type)] * block.count
            else:
                block.cells = [Value(low, high, block.type) for low, high in limits]
        steps = (0, 0) if fresh else (1, self.most_steps)
        state.fields["steps"].cells = [Value(*steps, state.fields["steps"].type)]
        kind = state.fields["identity"].type
        state.fields["identity"].cells = [Value(self.identity, self.identity, kind)]

    def contradictions(self, state: Struct) -> list[str]:
        """Return why a state might not pass."""
        found = []
        for name, block in state.fields.items():
            found += [
                f"s->{name}[{at}] holds nothing" for at, c in enumerate(block.cells) if c is None
            ]
        if found:
            return found
        identity, steps = (state.fields[n].value(0) for n in ("identity", "steps"))
        if identity.exact != self.identity:
            found.append("s->identity is not the model's")
        if steps.high > self.most_steps:
            found.append(f"s->steps reaches {steps.high}; the state check admits {self.most_steps}")
        if self.early and steps.high == 0:
            return found
        for name, limits in self.limits.items():
            for at, (low, high) in enumerate(limits):
                value = state.fields[name].value(at)
                if value.low < low or value.high > high:
                    found.append(
                        f"s->{name} becomes {value.low} .. {value.high}; the state check admits"
                        f" {low} .. {high}"
                    )
                    break
        return found


def read_guard(machine: Expressions, prefix: str) -> Guard:
    """Read the test statement by statement, and note the bounds that it sets.

    Raises:
        NotUnderstoodError: a statement without a rule.
    """
    return _GuardReader(machine, prefix).read()


class _GuardReader:
    def __init__(self, machine: Expressions, prefix: str) -> None:
        self._machine = machine
        function = machine.program.functions.get(f"{prefix}_state_is_sound")
        if (
            function is None
            or len(function.parameters) != 1
            or function.result != "uint32_t"
            or function.parameters[0].type.name != f"{prefix}_state_t"
            or not function.parameters[0].type.pointer
        ):
            raise NotUnderstoodError(f"{prefix}: no test of its state")
        self._body, self._state = function.body, function.parameters[0].name
        fields = machine.program.structs[f"{prefix}_state_t"]
        self._types = {f.name: f.type.name for f in fields}
        self._sizes = {f.name: [machine.constant(s) for s in f.sizes] for f in fields}
        for needed in ("identity", "steps"):
            if self._types.get(needed) != "uint32_t" or self._sizes[needed]:
                raise NotUnderstoodError(f"{prefix}_state_t has no {needed}")
        self._limits: Limits = {}
        self._early = False

    def _error(self, node: CNode) -> NotUnderstoodError:
        place = self._machine.program.place(node.at)
        return NotUnderstoodError(f"{place}: no rule for this in a test of the state")

    def read(self) -> Guard:
        first, *middle = self._body.statements
        last = middle.pop() if middle else first
        identity = self._read_identity(first)
        if not isinstance(last, CReturn) or not is_name(last.value, "sound"):
            raise self._error(last)
        most_steps = None
        for node in middle:
            if isinstance(node, CIf):
                if node.then.statements and isinstance(node.then.statements[0], CReturn):
                    self._read_early(node)
                    most_steps = self._steps()
                else:
                    self._read_limit(node)
            elif isinstance(node, CFor):
                self._read_loop(node)
            elif isinstance(node, CAssign):
                self._read_recurrent(node)
            else:
                raise self._error(node)
        most_steps = self._steps() if most_steps is None else most_steps
        self._note_bounds()
        del self._limits["steps"]
        return Guard(identity, most_steps, self._early, self._limits)

    def _steps(self) -> int:
        if "steps" not in self._limits:
            raise NotUnderstoodError("the state check does not look at s->steps")
        return self._limits["steps"][0][1]

    def _read_identity(self, node: Statement) -> int:
        """uint32_t sound = (s->identity == N) ? 1u : 0u;"""
        variable = node.variable if isinstance(node, CDeclare) else None
        if variable is None or variable.name != "sound" or variable.sizes:
            raise self._error(node)
        first = variable.first
        if variable.type.name != "uint32_t" or not isinstance(first, CChoose):
            raise self._error(node)
        condition = first.condition
        ends = [self._number(n) for n in (first.first, first.second)]
        if ends != [1, 0] or not isinstance(condition, CBinary):
            raise self._error(node)
        if condition.operator != "==" or self._field(condition.left)[:2] != ("identity", None):
            raise self._error(node)
        return self._number(condition.right)

    def _number(self, node: Expression) -> int:
        return self._machine.constant(node)

    def _field(self, node: Expression) -> tuple[str, Expression | None]:
        """Return the field of s that is read, and at which index."""
        index = None
        if isinstance(node, CIndex):
            index = node.index
            node = node.of
        if (
            not isinstance(node, CField)
            or node.operator != "->"
            or not is_name(node.of, self._state)
        ):
            raise self._error(node)
        name = node.name
        if name not in self._types or len(self._sizes[name]) != int(index is not None):
            raise self._error(node)
        return name, index

    def _read_early(self, node: CIf) -> None:
        """if (s->steps == 0u) { return sound; }"""
        condition, then = node.condition, node.then.statements
        if not isinstance(condition, CBinary) or condition.operator != "==" or node.other:
            raise self._error(node)
        returned = then[0].value if isinstance(then[0], CReturn) else None
        if len(then) != 1 or not is_name(returned, "sound"):
            raise self._error(node)
        if self._field(condition.left) != ("steps", None) or self._number(condition.right):
            raise self._error(node)
        if self._early or set(self._limits) - {"steps"}:
            raise self._error(node)
        self._early = True

    def _read_limit(self, node: CIf, count: int = 0, index: str = "") -> None:
        """if (s->x < a || s->x > b) { sound = 0u; }, of one element or of `count` of them."""
        if node.other is not None or len(node.then.statements) != 1:
            raise self._error(node)
        assign = node.then.statements[0]
        if not isinstance(assign, CAssign) or assign.operator != "=":
            raise self._error(node)
        if self._number(assign.source) != 0 or not is_name(assign.target, "sound"):
            raise self._error(node)
        self._forbid(node.condition, count, index)

    def _forbid(self, node: Expression, count: int, index: str) -> None:
        if not isinstance(node, CBinary):
            raise self._error(node)
        operator, left, right = node.operator, node.left, node.right
        if operator == "||":
            self._forbid(left, count, index)
            self._forbid(right, count, index)
            return
        name, at = self._field(left)
        limit = self._machine.number(right)
        kind = self._types[name]
        mixed = is_signed(kind) and not is_signed(self._machine.common(kind, limit.type))
        if limit.exact is None or mixed or operator not in ("<", ">", ">=", "<="):
            raise self._error(node)
        if name == "identity" or (name == "steps" and operator not in (">", ">=")):
            raise self._error(node)
        low, high = TYPES[kind]
        if operator in ("<", "<="):
            low = limit.exact + (operator == "<=")
        else:
            high = limit.exact - (operator == ">=")
        for element in self._elements(name, at, count, index):
            self._admit(name, element, low, high)

    def _elements(self, name: str, at: Expression | None, count: int, index: str) -> range:
        if at is None:
            return range(1)
        size = self._sizes[name][0]
        if index and is_name(at, index):
            if count > size:
                raise FaultError(f"{count} elements of s->{name}, which has {size}")
            return range(count)
        element = self._number(at)
        if not 0 <= element < size:
            raise FaultError(f"element {element} of s->{name}, which has {size}")
        return range(element, element + 1)

    def _admit(self, name: str, element: int, low: int, high: int) -> None:
        kind = self._types[name]
        if low > high:
            raise FaultError(f"the state check admits nothing in s->{name}")
        count = self._sizes[name][0] if self._sizes[name] else 1
        limits = self._limits.setdefault(name, [TYPES[kind]] * count)
        before = limits[element]
        limits[element] = (max(low, before[0]), min(high, before[1]))

    def _read_loop(self, node: CFor) -> None:
        """for (uint32_t k = 0; k < N; k++) { if (...) { sound = 0u; } }"""
        body = node.body.statements
        if self._number(node.first) != 0 or node.operator != "<" or len(body) != 1:
            raise self._error(node)
        if not isinstance(body[0], CIf):
            raise self._error(node)
        self._read_limit(body[0], self._number(node.end), node.name)

    def _read_recurrent(self, node: CAssign) -> None:
        """sound &= zd_gru_state_is_sound(s->x, N);"""
        call = node.source
        if node.operator != "&=" or not is_name(node.target, "sound"):
            raise self._error(node)
        if not isinstance(call, CCall) or call.name != "zd_gru_state_is_sound":
            raise self._error(node)
        field = call.arguments[0] if len(call.arguments) == 2 else None
        if not isinstance(field, CField) or not is_name(field.of, self._state):
            raise self._error(node)
        of, count = field.name, self._number(call.arguments[1])
        if self._types.get(of) != "int32_t" or len(self._sizes[of]) != 1:
            raise self._error(node)
        if count > self._sizes[of][0]:
            raise FaultError(f"{count} elements of s->{of}, which has {self._sizes[of][0]}")
        limit = self._machine.known["ZD_GRU_H_LIMIT_Q30"]
        for element in range(count):
            self._admit(of, element, -limit, limit)

    def _note_bounds(self) -> None:
        """Each field with limits of its own is a bound of the certificate."""
        for name, kind in self._types.items():
            stem, _, last = name.rpartition("_")
            limits = self._limits.get(name)
            if limits and last not in ("steps", "oldest", "q30", "drift") and stem:
                bits = 64 if BITS[kind] == 64 else 32
                low, high = min(low for low, _ in limits), max(high for _, high in limits)
                self._machine.note(f"{stem}.{last}", low, high, bits)
            if last in ("line", "window") and self._sizes[name]:  # an input may be called so
                where = f"{stem}.{'steps' if last == 'line' else last}"
                self._machine.note(where, 1, self._sizes[name][0], 16)
