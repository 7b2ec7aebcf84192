"""The statements of a generated model's C, run over intervals.

Both arms of a branch are run where its condition is not known, and a loop for any index at once
where its ends are not.
"""

from collections.abc import Mapping
from dataclasses import replace

from zerodrift_proof.certificate.expressions import Expressions
from zerodrift_proof.certificate.parser import (
    CAlone,
    CAssign,
    CBinary,
    CBlock,
    CChoose,
    CDeclare,
    CFor,
    CIf,
    CIndex,
    CInteger,
    CList,
    CName,
    CNumbers,
    CReturn,
    CWhile,
    Expression,
    Program,
    Statement,
    Variable,
    is_name,
    walk,
)
from zerodrift_proof.certificate.values import (
    TYPES,
    Address,
    Block,
    Cell,
    FaultError,
    Found,
    Pointer,
    Struct,
    Value,
    anything,
    make_block,
)

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
