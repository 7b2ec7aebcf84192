"""Runs the C of a generated model over intervals in place of numbers.

Every function is run, every operation must fit its C type, every index its array, and nothing may
be read before it is written. What the state may hold at the start of a step is what the C itself
tests (`c_guard`); that each step leaves it so closes the induction. Shares no code with the
generator and needs the standard library only.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from zerodrift.verify.c_expressions import Expressions
from zerodrift.verify.c_guard import Guard
from zerodrift.verify.c_parser import Node, Program, TypeName, Variable
from zerodrift.verify.c_values import (
    TYPES,
    Address,
    Block,
    FaultError,
    Pointer,
    Struct,
    Value,
    anything,
    make_block,
)

MOST_PATHS = 64
MOST_ROUNDS = 100_000
DEEPEST = 20


class Machine(Expressions):
    """Runs the functions of a model over intervals and notes what they reach."""

    def __init__(
        self,
        program: Program,
        prefix: str,
        known: Mapping[str, int],
        rules: Mapping[str, Callable[..., Any]],
        int_bits: int = 32,
    ) -> None:
        """Stand before the first function; `run` runs them all.

        Args:
            program: what the model's files declare.
            prefix: of the model.
            known: macros of the runtime that are numbers.
            rules: what the runtime's functions do with intervals, by name.
            int_bits: of C's int, 16 or 32.
        """
        super().__init__(program, known, int_bits)
        self.prefix, self._rules = prefix, rules
        self.recurrent: set[tuple[str, tuple[Value, ...]]] = set()
        """The recurrent layers that were stepped, and under which features."""
        self.outputs, self.per_pair = 0, 2
        self.tables: dict[str, list[int]] = {}
        """The runtime's tables."""
        self.h_limit = self.tanh_max = self.r_max = self.lines = 0
        self.guard = Guard(0, 0, False, {})
        self._live: list[Block] = []
        self._inputs: list[Struct] = []
        self._returned: Any = None
        self._depth = 0
        self._script: list[int] = []
        self._made: list[tuple[int, int]] = []
        self._asked = False
        """Whether this path has asked if the state is sound."""
        self._replaying = False
        self._called: set[str] = set()

    # --- paths

    def choose(self, ways: int) -> int:
        """Return which of some ways to go; all are gone, one after the other."""
        made = len(self._made)
        way = self._script[made] if made < len(self._script) else 0
        self._made.append((way, ways))
        return way

    def explore(self, run: Callable[[], None]) -> None:
        """Go every way through something."""
        self._script = []
        for _ in range(MOST_PATHS):
            self._made, self._asked, self._live, self._depth = [], False, [], 0
            self.variables, self._inputs, self.inputs = {}, [], set()
            try:
                run()
            except FaultError as error:
                self.fail(str(error))
            made = self._made
            while made and made[-1][0] + 1 == made[-1][1]:
                made.pop()
            if not made:
                return
            self._script = [way for way, _ in made[:-1]] + [made[-1][0] + 1]
        raise self.not_understood(f"more than {MOST_PATHS} paths")

    # --- functions

    def call(self, name: str, arguments: list[Any]) -> Any:
        """Run a function of the model."""
        function = self.program.functions[name]
        if self._depth >= DEEPEST or len(arguments) != len(function.parameters):
            raise self.not_understood(f"a call of {name}")
        kept, returned = self.variables, self._returned
        self.variables, self._returned = {}, None
        live = len(self._live)
        for parameter, argument in zip(function.parameters, arguments, strict=True):
            if parameter.name in self.variables:
                raise self.not_understood(f"two parameters {parameter.name}")
            self.variables[parameter.name] = self._bind(parameter, argument)
        self._depth += 1
        self._called.add(name)
        ended = self._run_block(function.body)
        if function.result != "void" and not ended:
            self.fail(f"{name} may end without a result")
        self._depth -= 1
        result = self._returned
        self.variables, self._returned = kept, returned
        del self._live[live:]
        return result

    def _bind(self, parameter: Variable, argument: Any) -> Any:
        """Return what a parameter is of an argument, which must be of its type."""
        kind = parameter.type
        if parameter.sizes or kind.pointer:
            if isinstance(argument, Address):
                if argument.bytes or kind.name != argument.struct.type or parameter.sizes:
                    raise self.not_understood(f"a pointer given for {parameter.name}")
                return self._as_constant(argument, kind, parameter.name)
            if not isinstance(argument, Pointer) or argument.block.type != kind.name:
                raise FaultError(f"another type than {kind.name} is given for {parameter.name}")
            if len(parameter.sizes) > 1 or len(argument.sizes) != 1:
                raise self.not_understood(f"an array of arrays given for {parameter.name}")
            for size in parameter.sizes:  # it is used as if it had no more
                argument.hold(self.constant(size))
                argument = replace(argument, sizes=(self.constant(size),))
            return self._as_constant(argument, kind, parameter.name)
        block = make_block(parameter.name, kind.name, (), None, kind.constant)
        block.cells = [self.as_plain(self.keep(self.as_number(argument), kind.name))]
        self._live.append(block)
        return block

    def _as_constant(self, argument: Any, kind: TypeName, name: str) -> Any:
        constant = argument.constant or (isinstance(argument, Pointer) and argument.block.constant)
        if constant and not kind.constant:
            raise FaultError(f"something constant is given for {name}, which is not")
        return replace(argument, constant=kind.constant)

    def as_number(self, value: Any) -> Value:
        """Return a value that has to be a number."""
        if not isinstance(value, Value):
            raise self.not_understood("something that is no number")
        return value

    def as_plain(self, value: Value) -> Value:
        """Return a value as it lies in a variable: what it was computed of is forgotten."""
        return Value(value.low, value.high, value.type)

    def _on_call(self, name: str, nodes: tuple[Node, ...]) -> Any:
        if name in ("UINT32_C", "INT64_C", "UINT64_C", "INT32_C"):
            return self._literal(name, nodes)
        at = self._at
        arguments = [self.evaluate(node) for node in nodes]
        self._at = at
        own = name.removeprefix(f"{self.prefix}_")
        if name in self.program.functions:
            if own == "state_is_sound":
                self._called.add(name)
                return self._ask_guard(*arguments)
            if self._replaying and own in ("settle", "step"):
                return self._replay(own, arguments)
            result = self.call(name, arguments)
            if own.endswith("_sound") and isinstance(result, Value) and result.exact == 0:
                self.fail(f"{name}: the tables are not those whose CRC is known here")
            return result
        if name in self.program.assembly:
            self._called.add(name)
            self.run_assembly(name, arguments)
            return None
        if name in self._rules:
            return self._rules[name](self, *arguments)
        raise self.not_understood(f"there is no rule for {name}")

    def run_assembly(self, name: str, arguments: list[Any]) -> None:
        """Step a layer by assembly that is known."""
        raise NotImplementedError

    def _literal(self, name: str, nodes: tuple[Node, ...]) -> Value:
        """INT64_C(-5) and its kind."""
        if len(nodes) != 1:
            raise self.not_understood(name)
        kind = f"{name[:-2].lower()}_t"
        inside = nodes[0]
        while inside.kind == "unary" and inside.parts[0] == "-":
            inside = inside.parts[1]
        plain = inside.kind == "integer" and inside.parts[0].isdigit()
        value = self.number(nodes[0])
        if not plain or not TYPES[kind][0] <= value.low <= TYPES[kind][1]:
            raise self.not_understood(f"{name} of this")
        return Value(value.low, value.high, self.common(kind, kind))

    # --- the state

    def _ask_guard(self, state: Any) -> Value:
        """Go on with a state that is not sound, one that was never stepped, or any other."""
        if not isinstance(state, Address) or state.struct.type != f"{self.prefix}_state_t":
            raise self.not_understood("state_is_sound of something else")
        if self._asked:
            raise self.not_understood("state_is_sound is asked twice")
        self._asked = True
        for block in state.struct.fields.values():  # reads it
            Pointer(block, Value(0, 0), (block.count,)).values(block.count)
        way = self.choose(3)
        if way:
            self.guard.admit(state.struct, fresh=way == 1)
        return Value(int(way > 0), int(way > 0), "uint32_t")

    def make_state(self, cell: str = "anything", name: str = "s") -> Struct:
        """Return a state of any bits, or of memory that was never written."""
        return self._make_struct(f"{self.prefix}_state_t", name, cell == "anything")

    def _make_struct(self, kind: str, name: str, any_bits: bool, zero: bool = False) -> Struct:
        struct = Struct(name, kind)
        for variable in self.program.structs[kind]:
            sizes = [self.constant(size) for size in variable.sizes]
            type_ = variable.type.name
            any_cell = Value(0, 0, type_) if zero else anything(type_) if any_bits else None
            block = make_block(f"{name}->{variable.name}", type_, sizes, any_cell)
            struct.fields[variable.name] = block
            self._live.append(block)
        if kind == f"{self.prefix}_input_t":
            self.inputs |= {id(block) for block in struct.fields.values()}
            self._inputs.append(struct)  # an id is no other's while the block lives
        return struct

    def make_input(self) -> Struct:
        """Return an input with any codes."""
        struct = self._make_struct(f"{self.prefix}_input_t", "in", True)
        for block in struct.fields.values():
            block.constant = True
        return struct

    def require_sound(self, state: Struct, after: str) -> None:
        """Fail where a state is left that the next call would not take."""
        for what in self.guard.contradictions(state):
            self.fail(f"after {after}: {what}")

    def _replay(self, name: str, arguments: list[Any]) -> Any:
        """The self-test's calls of functions that were shown for any state and input."""
        state, codes = arguments[:2]
        if not (isinstance(state, Address) and isinstance(codes, Address)):
            raise self.not_understood(f"{name} of something else")
        types = (state.struct.type, codes.struct.type)
        if types != (f"{self.prefix}_state_t", f"{self.prefix}_input_t"):
            raise self.not_understood(f"{name} of {types}")
        read = [codes.struct] + ([state.struct] if name == "step" else [])
        for struct in read:
            for block in struct.fields.values():
                Pointer(block, Value(0, 0), (block.count,)).values(block.count)
        for block in state.struct.fields.values():
            block.cells = [anything(block.type)] * block.count
            block.version += 1
        if name == "settle":
            return None
        drift = arguments[2]
        if not isinstance(drift, Pointer) or drift.block.type != "int32_t":
            raise FaultError("drift is no array of int32_t")
        drift.fill([anything("int32_t")] * self.outputs)
        return anything("uint32_t")

    # --- statements

    def _run_block(self, block: Node) -> bool:
        """Run a block in braces; tell whether it returns. Its own variables end with it."""
        outer, live = self.variables, len(self._live)
        self.variables = dict(outer)
        returned = False
        for statement in block.parts:
            returned = self._run(statement)
            if returned:
                break
        self.variables = outer
        del self._live[live:]
        return returned

    def _run(self, node: Node) -> bool:
        """Run a statement; tell whether it returns."""
        self.stand_at(node.at)
        if node.kind == "block":
            return self._run_block(node)
        if node.kind == "return":
            value = None if node.parts[0] is None else self.evaluate(node.parts[0])
            self._returned = value
            return True
        if node.kind == "if":
            return self._run_branch(*node.parts)
        if node.kind == "for":
            self._run_loop(*node.parts)
        elif node.kind == "declare":
            self._declare(node.parts[0])
        elif node.kind == "assign":
            self._assign(*node.parts)
        else:  # a call, or (void)x
            self.evaluate(node.parts[0])
        return False

    def _run_branch(self, condition: Node, then: Node, other: Node | None) -> bool:
        test = self._as_truth(self.number(condition))
        if test.exact is not None:
            branch = then if test.exact else other
            return self._run(branch) if branch is not None else False
        if any(map(holds_return, (then, other))):
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

    def _keep(self) -> list[tuple[Block, list[Any], int]]:
        return [(block, list(block.cells), block.version) for block in self._live]

    def _restore(self, kept: list[tuple[Block, list[Any], int]]) -> None:
        for block, cells, _ in kept:
            block.cells = list(cells)

    def _join(self, kept: list[tuple[Block, list[Any], int]]) -> bool:
        """Let every cell be what it is or what it was then; tell whether any changed."""
        changed = False
        for block, cells, _ in kept:
            for at, before in enumerate(cells):
                now = block.cells[at]
                if now is before or now == before:
                    continue
                changed = True
                if now is None or before is None:
                    block.cells[at] = None
                else:
                    block.cells[at] = now.join(before)  # type: ignore[union-attr]
        return changed

    def _run_loop(
        self, kind: str, name: str, first: Node, operator: str, end: Node, body: Node
    ) -> None:
        """Run a counting loop step by step; where its ends are not known, for any index at once."""
        start, stop = self.convert(self.number(first), kind), self.number(end)
        if self.common(stop.type, kind) != kind or name in self.variables or assigns(body, name):
            raise self.not_understood("a loop that is not counted by its own variable")
        extra = int(operator == "<=")
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

    def _run_round(self, kind: str, name: str, index: Value, body: Node) -> bool:
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
        zero = (
            variable.first is not None
            and variable.first.kind == "numbers"
            and variable.first.parts[0] == [0]
        )
        if kind.name in self.program.structs:
            if variable.sizes or (variable.first is not None and not zero):
                raise self.not_understood(f"how {name} begins")
            struct = self._make_struct(kind.name, name, any_bits=False, zero=zero)
            for block in struct.fields.values():
                block.constant = kind.constant
            self.variables[name] = struct
            return
        if kind.name not in TYPES:
            raise self.not_understood(f"a variable of {kind.name}")
        noted = kind.constant and kind.name == "int32_t"
        if name == "sum" or noted:
            self.pending, self.shift = {}, None
        sizes = [self._size(size) for size in variable.sizes]
        block = make_block(name, kind.name, sizes, None)
        if variable.first is not None and variable.first.kind in ("list", "numbers"):
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

    def _size(self, node: Node) -> int:
        size = self.constant(node)
        if not 0 < size <= MOST_ROUNDS:
            raise FaultError(f"an array of {size}")
        return size

    def _fill_list(self, block: Block, items: Node) -> None:
        if items.kind == "numbers":
            found = [Value(n, n, "int64_t") for n in items.parts[0]]
        else:
            found = [self.number(n) for n in items.parts]
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

    def _assign(self, operator: str, target: Node, source: Node) -> None:
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
        if target.kind == "index" and target.parts[0].kind == "name":
            self._note_element(target.parts[0].parts[0], place, value)
        is_sum = target.kind == "name" and target.parts[0] == "sum"
        place.fill([value if is_sum else self.as_plain(value)])

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

    def _counts_up(self, operator: str, place: Pointer, source: Node) -> bool:
        """s->x += (copy < limit) ? 1 : 0; where `copy` is what the field holds."""
        if operator != "+=" or source.kind != "choose" or "->" not in place.block.name:
            return False
        condition, one, none = source.parts
        plain = [n.parts[1] for n in (one, none) if n.kind == "integer"]
        if condition.kind != "binary" or condition.parts[0] != "<" or plain != [1, 0]:
            return False
        copied = self.locate(condition.parts[1]) if condition.parts[1].kind == "name" else None
        limit = self.constant(condition.parts[2])
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

    def _assign_struct(self, operator: str, place: Address, source: Node) -> None:
        found = self.locate(source)
        same = isinstance(found, Struct) and found.type == place.struct.type
        if operator != "=" or not same or place.constant or place.bytes:
            raise self.not_understood("this cannot be assigned")
        for name, block in found.fields.items():
            values = Pointer(block, Value(0, 0), (block.count,)).values(block.count)
            target = place.struct.fields[name]
            Pointer(target, Value(0, 0), (target.count,)).fill(values)


def holds_return(node: Any) -> bool:
    """Return whether a statement returns anywhere inside."""
    return isinstance(node, Node) and (node.kind == "return" or any(map(holds_return, node.parts)))


def mentions(node: Any, name: str) -> bool:
    """Return whether a variable stands anywhere in a statement."""
    if isinstance(node, Variable):
        return any(mentions(part, name) for part in (node.first, *node.sizes))
    if isinstance(node, tuple):
        return any(mentions(part, name) for part in node)
    if not isinstance(node, Node):
        return False
    return node == Node("name", node.at, (name,)) or mentions(node.parts, name)


def assigns(node: Any, name: str) -> bool:
    """Return whether a statement changes a variable."""
    if not isinstance(node, Node):
        return False
    if node.kind == "assign" and node.parts[1].kind == "name" and node.parts[1].parts[0] == name:
        return True
    return any(assigns(part, name) for part in node.parts)
