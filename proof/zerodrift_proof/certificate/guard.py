"""A model's own test of its state, and its checksum of it.

What a model's own checksum of its state (`..._sum_up`) is taken over.

Every word of a sum changes it: the sum before is turned by one bit and the word is added. A state
of which every element is in exactly one word, alone or as one half of it, cannot change in one bit
and keep its sum.

The test is a list of comparisons, of which nothing is believed but what stands there. Shares no
code with the generator and needs the standard library only.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
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
    CUnary,
    Expression,
    Statement,
    Variable,
    is_name,
)
from zerodrift_proof.certificate.preprocessor import TOKEN, ModelTokens, parse_integer
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

# What a design's own test of a block (`..._is_admissible`) lets through, and that it is asked.
#
# `check_block`, `choose_block` and the helpers of the test are known texts, held against the C
# token by token: a block for which `check_block` returns 0 has passed the test. The test itself is
# a list of calls, of which nothing is believed but what stands there. Shares no code with the
# generator and needs the standard library only.

WITHIN = """
static uint32_t P_within_K(const T *x, uint32_t n, T low, T high) {
    uint32_t within = 1u;
    for (uint32_t k = 0; k < n; k++) {
        if ((x[k] < low) || (x[k] > high)) { within = 0u; }
    }
    return within;
}
"""
ROWS_WITHIN = """
static uint32_t P_rows_within(const int16_t *w, uint32_t n, uint32_t m, uint32_t most) {
    uint32_t within = 1u;
    for (uint32_t k = 0; k < n; k++) {
        uint32_t norm = 0;
        for (uint32_t i = 0; i < m; i++) {
            const int32_t weight = w[(k * m) + i];
            norm += (uint32_t)((weight < 0) ? -weight : weight);
        }
        if (norm > most) { within = 0u; }
    }
    return within;
}
"""
GRU_WITHIN = (
    """
static uint32_t P_size(int32_t x) {
    return (x < 0) ? (0u - (uint32_t)x) : (uint32_t)x;
}
""",
    """
static uint32_t P_sum_fits(uint32_t most, uint32_t norm) {
    return ((most <= UINT32_C(2147483647)) && (norm <= ((UINT32_C(2147483647) - most) / 32768u)))
        ? 1u : 0u;
}
""",
    """
static void P_add_norms(const int32_t *w, uint32_t pairs, uint32_t norms[3]) {
    for (uint32_t i = 0; i < pairs; i++) {
        const uint32_t wide = ((i | 1u) < pairs) ? 2u : 1u;
        for (uint32_t g = 0; g < 3u; g++) {
            const int32_t both = w[(6u * (i / 2u)) + (wide * g) + (i % 2u)];
            norms[g] += P_size(zd_asr32((int32_t)((uint32_t)both << 16), 16u));
            norms[g] += P_size(zd_asr32(both, 16u));
        }
    }
}
""",
    """
static uint32_t P_gru_within(const int32_t *stream, uint32_t units, uint32_t x, uint32_t h) {
    uint32_t within = 1u;
    const uint32_t words = 4u + (3u * (x + h));
    for (uint32_t j = 0; j < units; j++) {
        const int32_t *w = &stream[j * words];
        uint32_t of_x[3] = {0u, 0u, 0u};
        uint32_t of_h[3] = {0u, 0u, 0u};
        P_add_norms(&w[4], x, of_x);
        P_add_norms(&w[4u + (3u * x)], h, of_h);
        const uint32_t inside = P_size(w[3]);
        within &= P_sum_fits(P_size(w[0]), of_x[0] + of_h[0]);
        within &= P_sum_fits(P_size(w[1]), of_x[1] + of_h[1]);
        within &= P_sum_fits(inside, of_h[2]);
        within &= P_sum_fits(P_size(w[2]) + ((inside + (32768u * of_h[2])) / 2u) + 1u, of_x[2]);
    }
    return within;
}
""",
)
"""What shows that no sum of a layer leaves 32 bits: each has a bias of magnitude b, weights of
which the absolute values add up to a, and factors of at most 2^15, so that it is at most
b + 2^15 a. Where that fits inside, half of it and 1 is more than what r, which is below 1/2, leaves
of it. No sum of absolute values in it passes 2^32 for rows of at most MOST_WEIGHTS."""
MOST_WEIGHTS = 1 << 16
CHECK = """
uint32_t P_check_block(const void *block, size_t bytes) {
    const P_block_t *b = (const P_block_t *)block;
    if ((block == NULL) || (bytes < sizeof(P_block_t)) || (((uintptr_t)block % 8u) != 0u)) {
        return UINT32_C(1);
    }
    if ((b->magic != UINT32_C(#)) || (b->format != UINT32_C(#))) {
        return UINT32_C(2);
    }
    if ((b->design != UINT32_C(#)) || (b->design_2 != UINT32_C(#)) || (b->bytes != #)) {
        return UINT32_C(4);
    }
    if (zd_crc32(0u, (const uint8_t *)block, # - 4u) != b->crc) {
        return UINT32_C(8);
    }
    return (P_is_admissible(b) != 0u) ? 0u : UINT32_C(16);
}
"""
CHOOSE = """
const P_block_t *P_choose_block(const void *a, const void *b, size_t bytes) {
    const P_block_t *first = (const P_block_t *)a;
    const P_block_t *second = (const P_block_t *)b;
    if (P_check_block(b, bytes) != 0u) { second = NULL; }
    if (P_check_block(a, bytes) != 0u) { return second; }
    if (second == NULL) { return first; }
    if (second->sequence == first->sequence) {
        return (second->crc == first->crc) ? first : NULL;
    }
    return (second->sequence > first->sequence) ? second : first;
}
"""
DECLARED = (
    "uint32_t P_check_block(const void *block, size_t bytes);",
    "const P_block_t *P_choose_block(const void *a, const void *b, size_t bytes);",
)
KINDS = {"i64": "int64_t", "i32": "int32_t", "i16": "int16_t", "u8": "uint8_t"}
ANY = "#"
"""In a known text: any integer."""


@dataclass(frozen=True)
class Norm:
    """The largest sum of absolute values of every row of so many numbers."""

    row: int
    most: int


@dataclass(frozen=True)
class LayerRows:
    """The sizes for which no sum of a GRU leaves 32 bits."""

    units: int
    x: int
    """Words of a row of features, of two weights each."""
    h: int
    """Words of a row of the state."""

    @property
    def words(self) -> int:
        """In all."""
        return self.units * (4 + 3 * (self.x + self.h))


@dataclass
class BlockSet:
    """The blocks that the test lets through."""

    limits: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Field -> lowest and highest of each of its numbers."""
    norms: dict[str, Norm] = field(default_factory=dict)
    layers: dict[str, LayerRows] = field(default_factory=dict)

    def admit(self, block: Struct) -> None:
        """Let a block be any that passes."""
        for name, cells in block.fields.items():
            low, high = self.limits.get(name, TYPES[cells.type])
            cells.cells = [Value(low, high, cells.type)] * cells.count
            cells.constant = True


def has_block(tokens: ModelTokens, prefix: str) -> bool:
    """Return whether the C is a design's, whose numbers lie in a block."""
    return f"{prefix}_block_t" in tokens.words


def cut_known(tokens: ModelTokens, prefix: str) -> tuple[ModelTokens, int]:
    """Return the tokens without the functions that are known texts, and the length that they ask.

    Raises:
        NotUnderstoodError: one of them is missing or another.
    """
    words, spots = list(tokens.words), list(tokens.spots)
    for text in DECLARED:
        _cut(words, spots, text, prefix)
    numbers = _cut(words, spots, CHECK, prefix)
    _cut(words, spots, CHOOSE, prefix)
    for kind, of in KINDS.items():
        if f"{prefix}_within_{kind}" in words:
            _cut(words, spots, WITHIN.replace("K(", f"{kind}(").replace("T ", f"{of} "), prefix)
    if f"{prefix}_rows_within" in words:
        _cut(words, spots, ROWS_WITHIN, prefix)
    if f"{prefix}_gru_within" in words:
        for text in GRU_WITHIN:
            _cut(words, spots, text, prefix)
    *_, told, summed = numbers
    if told != summed:
        raise NotUnderstoodError(f"{prefix}_check_block: a length of {told}, a CRC over {summed}")
    return ModelTokens(words, spots, tokens.where, tokens.macros), told


def _cut(words: list[str], spots: list[int], text: str, prefix: str) -> list[int]:
    """Take a known text out of the tokens; return the integers in it that may be any."""
    wanted = TOKEN.findall(re.sub(r"\bP_", f"{prefix}_", text))
    name = next(word for word in wanted if re.fullmatch(rf"{prefix}_\w+(?<!_block_t)", word))
    ahead = wanted.index(name)
    end = wanted[-1]
    for at in range(ahead, len(words) - len(wanted) + ahead + 1):
        if words[at] != name or words[at - ahead + len(wanted) - 1] != end:
            continue
        found = words[at - ahead : at - ahead + len(wanted)]
        if all(w in (f, ANY) for w, f in zip(wanted, found, strict=True)):
            numbers = [parse_integer(f)[0] for w, f in zip(wanted, found, strict=True) if w == ANY]
            del words[at - ahead : at - ahead + len(wanted)]
            del spots[at - ahead : at - ahead + len(wanted)]
            return numbers
    raise NotUnderstoodError(f"{name} is missing, or not the text that is known here")


def read_block_set(machine: Expressions, prefix: str, size: int) -> BlockSet:
    """Read the test statement by statement.

    Args:
        machine: has read the C, known texts cut out.
        prefix: of the model.
        size: bytes that `check_block` asks for.

    Raises:
        NotUnderstoodError: a statement without a rule.
        FaultError: a row or a field is looked at beyond its end.
    """
    kind = f"{prefix}_block_t"
    if machine.size_of(kind) != size:
        raise FaultError(f"{kind} has {machine.size_of(kind)} bytes; {size} are asked for")
    return _SetReader(machine, prefix).read()


class _SetReader:
    def __init__(self, machine: Expressions, prefix: str) -> None:
        self._machine, self._prefix = machine, prefix
        function = machine.program.functions.get(f"{prefix}_is_admissible")
        if function is None or [p.type.name for p in function.parameters] != [f"{prefix}_block_t"]:
            raise NotUnderstoodError(f"{prefix}: no test of a block")
        self._function, self._block = function, function.parameters[0].name
        self._fields: Mapping[str, tuple[str, int]] = {
            f.name: (f.type.name, self._count(f.sizes))
            for f in machine.program.structs[f"{prefix}_block_t"]
        }
        self._set = BlockSet()

    def _count(self, sizes: tuple[Expression, ...]) -> int:
        count = 1
        for size in sizes:
            count *= self._machine.constant(size)
        return count

    def _error(self, node: CNode) -> NotUnderstoodError:
        place = self._machine.program.place(node.at)
        return NotUnderstoodError(f"{place}: no rule for this in a test of a block")

    def read(self) -> BlockSet:
        first, *middle = self._function.body.statements
        if not middle:
            raise self._error(first)
        last = middle.pop()
        if (
            not isinstance(first, CDeclare)
            or first.variable.name != "within"
            or first.variable.type.name != "uint32_t"
            or first.variable.first is None
            or self._machine.constant(first.variable.first) != 1
        ):
            raise self._error(first)
        if not isinstance(last, CReturn) or not is_name(last.value, "within"):
            raise self._error(last)
        for node in middle:
            if (
                not isinstance(node, CAssign)
                or node.operator != "&="
                or not is_name(node.target, "within")
                or not isinstance(node.source, CCall)
            ):
                raise self._error(node)
            self._read_call(node.source)
        return self._set

    def _read_call(self, call: CCall) -> None:
        own = call.name.removeprefix(f"{self._prefix}_")
        if not call.arguments:
            raise self._error(call)
        name = self._field(call.arguments[0])
        numbers = [self._machine.constant(a) for a in call.arguments[1:]]
        kind, count = self._fields[name]
        if own == "rows_within" and len(numbers) == 3 and kind == "int16_t":
            rows, row, most = numbers
            if rows * row != count or row < 1 or name in self._set.norms:
                raise FaultError(f"{rows} rows of {row} of b->{name}, which has {count} numbers")
            self._set.norms[name] = Norm(row, most)
            return
        if own == "gru_within" and len(numbers) == 3 and kind == "int32_t":
            self._read_layer(name, LayerRows(*numbers), count)
            return
        if own != f"within_{next((k for k, t in KINDS.items() if t == kind), '')}":
            raise self._error(call)
        if len(numbers) != 3 or numbers[0] != count or name in self._set.limits:
            raise FaultError(f"{numbers[:1]} numbers of b->{name}, which has {count}")
        low, high = numbers[1:]
        least, most = TYPES[kind]
        if not least <= low <= high <= most:
            raise FaultError(f"b->{name}: {low} .. {high} is no range of {kind}")
        self._set.limits[name] = (low, high)

    def _read_layer(self, name: str, rows: LayerRows, count: int) -> None:
        told = min(rows.units, rows.x, rows.h) >= 1 and name not in self._set.layers
        if not told or rows.words != count or 2 * (rows.x + rows.h) > MOST_WEIGHTS:
            raise FaultError(f"{rows} of b->{name}, which has {count} numbers")
        self._set.layers[name] = rows

    def _field(self, node: Expression) -> str:
        """b->x of an array, &b->x of a number."""
        of = node.of if isinstance(node, CUnary) and node.operator == "&" else node
        if not isinstance(of, CField) or of.operator != "->" or not is_name(of.of, self._block):
            raise self._error(node)
        return of.name


# A model's own test of its state, and its checksum of it.

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
        for (name, at), words in self._seen.items():
            if words != 1:
                element = name + "".join(f"[{k}]" for k in at)
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
