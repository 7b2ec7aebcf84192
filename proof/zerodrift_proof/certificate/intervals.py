"""Runs the C of a generated model over intervals in place of numbers.

Every function is run, every operation must fit its C type, every index its array, and nothing may
be read before it is written. What the state may hold at the start of a step is what the C itself
tests (`guard`); that each step leaves it so closes the induction. Shares no code with the
generator and needs the standard library only.

Arguments of the runtime's functions, held against the parameters that these have.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from zerodrift_proof.certificate.expressions import Statements
from zerodrift_proof.certificate.guard import FIELD as SUM
from zerodrift_proof.certificate.guard import BlockSet, Guard, LayerRows
from zerodrift_proof.certificate.parser import (
    CBinary,
    CField,
    CInteger,
    CUnary,
    Expression,
    Program,
    TypeName,
    Variable,
    is_name,
)
from zerodrift_proof.certificate.values import (
    LIMITS,
    TYPES,
    Address,
    Block,
    Cell,
    FaultError,
    Found,
    GruNumbers,
    Holder,
    LstmNumbers,
    Pointer,
    Struct,
    Value,
    anything,
    make_block,
)

TYPES |= {f"uint{n}_t": (0, 2**n - 1) for n in (8, 16, 32, 64)}
LIMITS |= {
    f"{u}INT{n}_MAX": TYPES[f"{u.lower()}int{n}_t"][1] for u in ("", "U") for n in (8, 16, 32, 64)
}
"""Macros of stdint.h."""


MOST_PATHS = 64
DEEPEST = 20
Rule: TypeAlias = Callable[..., Found]
"""(machine, *arguments) -> what a function of the runtime returns. A rule holds what it is given
against the parameters of that function (below)."""


class IntervalMachine(Statements):
    """Runs the functions of a model over intervals and notes what they reach."""

    def __init__(
        self,
        program: Program,
        prefix: str,
        known: Mapping[str, int],
        rules: Mapping[str, Rule],
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
        super().__init__(program, prefix, known, int_bits)
        self._rules = rules
        self.recurrent: set[tuple[str, tuple[Value, ...]]] = set()
        """The GRUs that were stepped, and under which features."""
        self.grus: dict[str, GruNumbers] = {}
        self.lstms: dict[str, LstmNumbers] = {}
        """Their numbers."""
        self.stepped: set[tuple[str, tuple[Value, ...]]] = set()
        """The LSTMs that were."""
        self.outputs, self.per_pair = 0, 2
        self.tables: dict[str, list[int]] = {}
        """The runtime's tables."""
        self.h_limit = self.tanh_max = self.r_max = self.lines = 0
        self.guard = Guard(0, 0, False, {})
        self._depth = 0
        self._script: list[int] = []
        self._made: list[tuple[int, int]] = []
        self._asked = False
        """Whether this path has asked if the state is sound."""
        self.has_block = False
        """Whether numbers lie in a block."""
        self.blocks = BlockSet()
        """What the test of a block lets through."""
        self._without_block = False
        """Whether this path goes on with no block."""
        self.summed = False
        """Whether the state bears a checksum over itself."""
        self._given: tuple[tuple[int, int], ...] = ()
        """The fields of the state that was given, before anything was written to it."""
        self._compared = self._refused = False
        """Whether this path has compared the checksum; whether it found the state not sound."""
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
            self._compared, self._refused = False, False
            self._without_block = False
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

    def call(self, name: str, arguments: Sequence[Found]) -> Found:
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

    def _bind(self, parameter: Variable, argument: Found) -> Holder:
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

    def _as_constant(
        self, argument: Address | Pointer, kind: TypeName, name: str
    ) -> Address | Pointer:
        constant = argument.constant or (isinstance(argument, Pointer) and argument.block.constant)
        if constant and not kind.constant:
            raise FaultError(f"something constant is given for {name}, which is not")
        return replace(argument, constant=kind.constant)

    def _on_call(self, name: str, nodes: tuple[Expression, ...]) -> Found:
        if name in ("UINT32_C", "INT64_C", "UINT64_C", "INT32_C"):
            return self._literal(name, nodes)
        at = self._at
        arguments = [self.evaluate(node) for node in nodes]
        self._at = at
        own = name.removeprefix(f"{self.prefix}_")
        if own == "check_block" and self.has_block:  # its text is known, and was cut out
            return self._ask_block(*arguments)
        if name in self.program.functions:
            if own == "state_is_sound":
                self._called.add(name)
                return self._ask_guard(*arguments)
            if own == "sum_up":
                self._called.add(name)
                return self._sum_up(*arguments)
            if self._replaying and own in ("settle", "step", "step_after"):
                return self._replay(own, arguments)
            result = self.call(name, arguments)
            if own == "is_of" and isinstance(result, Value) and result.exact is None:
                way = self.choose(2)  # both are gone
                result = Value(way, way, "uint32_t")
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

    def run_assembly(self, name: str, arguments: Sequence[Found]) -> None:
        """Step a layer by assembly that is known."""
        raise NotImplementedError

    def _literal(self, name: str, nodes: tuple[Expression, ...]) -> Value:
        """INT64_C(-5) and its kind."""
        if len(nodes) != 1:
            raise self.not_understood(name)
        kind = f"{name[:-2].lower()}_t"
        inside = nodes[0]
        while isinstance(inside, CUnary) and inside.operator == "-":
            inside = inside.of
        plain = isinstance(inside, CInteger) and inside.token.isdigit()
        value = self.number(nodes[0])
        if not plain or not TYPES[kind][0] <= value.low <= TYPES[kind][1]:
            raise self.not_understood(f"{name} of this")
        return Value(value.low, value.high, self.common(kind, kind))

    # --- the state

    def _ask_guard(self, state: Found) -> Value:
        """Go on with a state that is not sound, one that was never stepped, or any other."""
        if not isinstance(state, Address) or state.struct.type != f"{self.prefix}_state_t":
            raise self.not_understood("state_is_sound of something else")
        if self._asked:
            raise self.not_understood("state_is_sound is asked twice")
        self._asked = True
        for block in state.struct.fields.values():  # reads it
            Pointer(block, Value(0, 0), (block.count,)).values(block.count)
        way = self.choose(3)
        self._refused = way == 0
        if way:
            untouched = self._given == self._fields_of(state.struct)
            self.guard.admit(state.struct, fresh=way == 1)
            if untouched:
                self.give(state.struct)
        return Value(int(way > 0), int(way > 0), "uint32_t")

    def make_state(self, cell: str = "anything", name: str = "s") -> Struct:
        """Return a state of any bits, or of memory that was never written."""
        state = self.make_struct(f"{self.prefix}_state_t", name, cell == "anything")
        self.give(state)
        return state

    def give(self, state: Struct) -> None:
        """Take a state as it is for what was given: nothing was written to it yet."""
        self._given = self._fields_of(state)

    def _fields_of(self, state: Struct) -> tuple[tuple[int, int], ...]:
        """Return what the checksum of a state is taken over."""
        return tuple((id(b), b.version) for name, b in state.fields.items() if name != SUM)

    def _sum_up(self, state: Found) -> Value:
        """Return the checksum of what the state holds now (`guard` tells what it reads)."""
        if not isinstance(state, Address) or state.struct.type != f"{self.prefix}_state_t":
            raise self.not_understood("sum_up of something else")
        for name, block in state.struct.fields.items():
            if name != SUM:
                Pointer(block, Value(0, 0), (block.count,)).values(block.count)
        return replace(anything("uint32_t"), sum_of=self._fields_of(state.struct))

    def find_norm(self, weights: Pointer, count: int) -> int | None:
        """Return what a row of a block's weights adds up to at most; None: nothing is known."""
        norm = self.blocks.norms.get(weights.block.name.removeprefix("b->"))
        if norm is None or norm.row != count or not self._of_block(weights):
            return None
        first = weights.first
        steps = 0 if first.exact is not None else weights.step
        aligned = first.low % norm.row == steps % norm.row == 0
        return norm.most if aligned else None

    def is_of_block(self, layer: Struct) -> bool:
        """Tell whether the numbers of a layer lie in a block."""
        return any(table is not None and self._of_block(table) for table in layer.tables.values())

    def find_rows(self, stream: Pointer) -> LayerRows | None:
        """Return the sizes of a GRU of a block whose sums were tested; None: nothing is known."""
        rows = self.blocks.layers.get(stream.block.name.removeprefix("b->"))
        whole = stream.first.exact == 0 and stream.sizes == stream.block.sizes
        return rows if whole and self._of_block(stream) else None

    def _of_block(self, pointer: Pointer) -> bool:
        return pointer.block.name.startswith("b->") and pointer.block.constant

    def _ask_block(self, block: Found, length: Found) -> Value:
        """Go on with a block that is refused, or with one that passed the test."""
        if not isinstance(block, Address) or block.struct.type != f"{self.prefix}_block_t":
            raise self.not_understood("check_block of something else")
        if self.as_number(length).exact != self.size_of(f"{self.prefix}_block_t"):
            raise self.not_understood("check_block of another length")
        refused = self._without_block or self.choose(2) == 0
        return Value(1, 31, "uint32_t") if refused else Value(0, 0, "uint32_t")

    def _is_null(self, node: CBinary) -> Value | None:
        """b == NULL: known on every path, as each entry is run with a block and without."""
        if not self.has_block or not is_name(node.right, "NULL"):
            return None
        found = self.evaluate(node.left)
        if not isinstance(found, Address) or found.struct.type != f"{self.prefix}_block_t":
            raise self.not_understood("NULL beside something else than a block")
        if node.operator != "==":
            raise self.not_understood("NULL in another comparison than ==")
        return Value(int(self._without_block), int(self._without_block), self.int)

    def assume(self, node: Expression, truth: bool) -> list[tuple[Block, list[Cell]]]:
        """Narrow the variables that a condition compares; of a block's address it says nothing."""
        if self.has_block and isinstance(node, CBinary) and is_name(node.right, "NULL"):
            return []
        return super().assume(node, truth)

    def _on_binary(self, node: CBinary) -> Value:
        null = self._is_null(node)
        if null is not None:
            return null
        operator, left, right = node.operator, node.left, node.right
        if isinstance(left, CField) and left.name == SUM and operator in ("==", "!="):
            holder = self.evaluate(left.of)
            found = self.number(right)
            if self.summed and isinstance(holder, Address) and found.sum_of:
                return self._compare_sum(operator, holder.struct, found)
            return self.combine(operator, self.number(left), found)
        return super()._on_binary(node)

    def _compare_sum(self, operator: str, state: Struct, found: Value) -> Value:
        """Go on with a state that was changed, of which nothing may then be read, and with one
        that is what was summed up last."""
        if self._given != found.sum_of or self._fields_of(state) != found.sum_of:
            raise self.not_understood("a checksum of what is not, or not only, the state given")
        self._compared, differs = True, self.choose(2) == 0
        if differs:
            for block in state.fields.values():
                block.cells = [None] * block.count
                block.version += 1
        else:
            state.fields[SUM].cells = [found]
        truth = differs == (operator == "!=")
        return Value(int(truth), int(truth), self.int)

    def make_input(self) -> Struct:
        """Return an input with any codes."""
        struct = self.make_struct(f"{self.prefix}_input_t", "in", True)
        for block in struct.fields.values():
            block.constant = True
        return struct

    def require_sound(self, state: Struct, after: str) -> None:
        """Fail where a state is left that the next call would not take."""
        for what in self.guard.contradictions(state):
            self.fail(f"after {after}: {what}")
        if self.summed:
            cell = state.fields[SUM].cells[0]
            if not isinstance(cell, Value) or cell.sum_of != self._fields_of(state):
                self.fail(f"after {after}: s->{SUM} is not the checksum of the state")

    def require_asked(self) -> None:
        """Fail where a step goes on with a state of which it has not asked whether it is sound."""
        if not self._asked and not self._without_block:
            self.fail("step does not ask whether its state is sound")
        if self.summed and not (self._compared or self._refused or self._without_block):
            self.fail("step does not compare the checksum of its state")

    def _is_block(self, argument: Found) -> bool:
        return isinstance(argument, Address) and argument.struct.type == f"{self.prefix}_block_t"

    def _replay(self, name: str, arguments: Sequence[Found]) -> Value | None:
        """The self-test's calls of functions that were shown for any state and input."""
        given = [a for a in arguments if not self._is_block(a)]
        if name == "step_after" and len(given) == 4:
            self.keep(self.as_number(given.pop(2)), "uint64_t")
        state, codes, *drifts = given
        if not (isinstance(state, Address) and isinstance(codes, Address)):
            raise self.not_understood(f"{name} of something else")
        types = (state.struct.type, codes.struct.type)
        if types != (f"{self.prefix}_state_t", f"{self.prefix}_input_t"):
            raise self.not_understood(f"{name} of {types}")
        read = [codes.struct] + ([state.struct] if name != "settle" else [])
        for struct in read:
            for block in struct.fields.values():
                Pointer(block, Value(0, 0), (block.count,)).values(block.count)
        for block in state.struct.fields.values():
            block.cells = [anything(block.type)] * block.count
            block.version += 1
        if name == "settle":
            return None
        drift = drifts[0] if drifts else None
        if not isinstance(drift, Pointer) or drift.block.type != "int32_t":
            raise FaultError("drift is no array of int32_t")
        drift.fill([anything("int32_t")] * self.outputs)
        return anything("uint32_t")


Action: TypeAlias = Callable[..., Value | None]
"""(machine, *arguments) -> what the function returns. Each argument is of the kind that the types
beside it name: a Value, a Pointer to a row of numbers or a Struct."""


def typed(types: str, action: Action, result: str = "") -> Rule:
    """Return a rule that first holds the arguments against the function's parameters.

    Args:
        types: of the parameters: a number's type; `const T *` or `T *`, of which the second is
            written to; `&S`, a struct of the runtime.
        action: what it does with them.
        result: the type of what it returns.
    """
    kinds = [kind.strip() for kind in types.split(",")] if types else []

    def rule(machine: IntervalMachine, *arguments: Found) -> Value | None:
        if len(arguments) != len(kinds):
            raise FaultError(f"{len(arguments)} arguments where {len(kinds)} are expected")
        given = [check(machine, k, a) for k, a in zip(kinds, arguments, strict=True)]
        found = action(machine, *given)
        if not result:
            return None
        if found is None:
            raise TypeError(f"{action} returns nothing; {result} is expected of it")
        return replace(found, type=result, copy_of=None)

    return rule


def check(machine: IntervalMachine, kind: str, argument: Found) -> Value | Pointer | Struct:
    """Return an argument as the parameter holds it.

    Raises:
        FaultError: it is of another type.
    """
    if kind in TYPES:
        return check_number(machine, kind, argument)
    if kind[0] == "&":
        if not isinstance(argument, Address) or argument.struct.type != kind[1:] or argument.bytes:
            raise FaultError(f"another type than {kind[1:]} is given")
        return argument.struct
    return check_row(kind, argument)


def check_number(machine: IntervalMachine, kind: str, argument: Found) -> Value:
    """Return an argument that has to be a number, in the type of its parameter."""
    return machine.keep(machine.as_number(argument), kind)


def check_row(kind: str, argument: Found) -> Pointer:
    """Return an argument that has to be a row of numbers: of `const T *` or of `T *`.

    Raises:
        FaultError: it is of another type, or constant where it is written.
    """
    base = kind.removeprefix("const ").removesuffix(" *")
    if not isinstance(argument, Pointer) or argument.block.type != base:
        raise FaultError(f"another type than {kind} is given")
    if len(argument.sizes) != 1:
        raise FaultError(f"{argument.block.name} is given where a row of numbers is expected")
    constant = argument.constant or argument.block.constant
    if constant and not kind.startswith("const"):
        raise FaultError(f"{argument.block.name} is constant, and is written")
    return argument


def number(value: Value, least: int, most: int, what: str) -> int:
    """Return a parameter that must be one known number in a range.

    Raises:
        FaultError: it is not.
    """
    if value.exact is None or not least <= value.exact <= most:
        raise FaultError(f"{what} is {value.low} .. {value.high}; {least} .. {most} is allowed")
    return value.exact
