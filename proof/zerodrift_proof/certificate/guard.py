"""What a model's own test of its state (`..._state_is_sound`) lets through.

The test is a list of comparisons, of which nothing is believed but what stands there. Shares no
code with the generator and needs the standard library only.
"""

from dataclasses import dataclass

from zerodrift_proof.certificate.expressions import Expressions
from zerodrift_proof.certificate.nodes import (
    CAssign,
    CBinary,
    CCall,
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
