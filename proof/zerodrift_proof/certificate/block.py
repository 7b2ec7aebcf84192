"""What a design's own test of a block (`..._is_admissible`) lets through, and that it is asked.

`check_block`, `choose_block` and the helpers of the test are known texts, held against the C token
by token: a block for which `check_block` returns 0 has passed the test. The test itself is a list
of calls, of which nothing is believed but what stands there. Shares no code with the generator and
needs the standard library only.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift_proof.certificate.expressions import Expressions
from zerodrift_proof.certificate.parser import (
    CAssign,
    CCall,
    CDeclare,
    CField,
    CNode,
    CReturn,
    CUnary,
    Expression,
    is_name,
)
from zerodrift_proof.certificate.preprocessor import TOKEN, ModelTokens, parse_integer
from zerodrift_proof.certificate.values import TYPES, FaultError, NotUnderstoodError, Struct, Value

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
