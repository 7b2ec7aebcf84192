"""C's integer types, and what the proof's parser makes of C.

C's integer types as the proof has them: fixed widths, and an int of 32 bits.

`PNode.at` counts tokens, so that whatever is found can be told with its place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

BITS = {f"{sign}int{n}_t": n for n in (8, 16, 32, 64) for sign in ("", "u")}


def is_signed(kind: str) -> bool:
    """Return whether an integer type has a sign."""
    return kind[0] == "i"


def _find_range(kind: str) -> tuple[int, int]:
    half = 1 << (BITS[kind] - 1)
    return (-half, half - 1) if is_signed(kind) else (0, 2 * half - 1)


TYPES = {kind: _find_range(kind) for kind in BITS}
"""Type -> its least and its largest number."""
LIMITS = {
    f"{kind.removesuffix('_t').upper()}_{end}": value
    for kind, ends in TYPES.items()
    for end, value in zip(("MIN", "MAX"), ends, strict=True)
    if end == "MAX" or is_signed(kind)
}
"""Names of stdint.h that stand for these."""


@dataclass
class PTokens:
    """The words of a file and all that it includes, macros replaced."""

    words: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    """file:line:column of each; of what a macro became, that of the macro's use."""
    macros: dict[str, list[str]] = field(default_factory=dict)
    """Macros without parameters -> the words that they stand for."""


@dataclass(frozen=True)
class PNode:
    """An expression, an initialiser or a statement."""

    at: int
    """The token with which it begins."""


@dataclass(frozen=True)
class PTypeName:
    """A type as it is written before a name."""

    name: str
    constant: bool = False
    pointer: bool = False
    volatile: bool = False


@dataclass(frozen=True)
class PVariable:
    """A declared variable, parameter or field; sizes and initialiser as expressions."""

    type: PTypeName
    name: str
    sizes: "tuple[Expression, ...]"
    at: int
    first: "Initialiser | None" = None


@dataclass(frozen=True)
class PInteger(PNode):
    """A literal, as it is written and its number."""

    token: str
    number: int
    unsigned: bool = False


@dataclass(frozen=True)
class PTyped(PNode):
    """A literal with its type, as INT64_C(-3) and UINT32_C(3) are."""

    number: int
    type: str


@dataclass(frozen=True)
class PName(PNode):
    """A variable, a constant or a limit of stdint.h."""

    name: str


@dataclass(frozen=True)
class PField(PNode):
    """of->name or of.name."""

    of: "Expression"
    operator: str
    name: str


@dataclass(frozen=True)
class PIndex(PNode):
    """of[index]."""

    of: "Expression"
    index: "Expression"


@dataclass(frozen=True)
class PCall(PNode):
    """name(arguments)."""

    name: str
    arguments: "tuple[Expression, ...]"


@dataclass(frozen=True)
class PUnary(PNode):
    """One of - + ~ ! & * before an expression."""

    operator: str
    of: "Expression"


@dataclass(frozen=True)
class PSizeof(PNode):
    """sizeof(of), a type's name or an expression."""

    of: "str | Expression"


@dataclass(frozen=True)
class PCast(PNode):
    """(type)of."""

    type: PTypeName
    of: "Expression"


@dataclass(frozen=True)
class PBinary(PNode):
    """left operator right."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class PChoose(PNode):
    """condition ? first : second."""

    condition: "Expression"
    first: "Expression"
    second: "Expression"


@dataclass(frozen=True)
class PNumbers(PNode):
    """An initialiser that is nothing but decimal numbers."""

    numbers: list[int]


@dataclass(frozen=True)
class PList(PNode):
    """An initialiser of other things."""

    items: "tuple[Initialiser, ...]"


@dataclass(frozen=True)
class PBlock(PNode):
    """Statements in braces."""

    statements: "tuple[Statement, ...]"


@dataclass(frozen=True)
class PReturn(PNode):
    """Return, of a value or of nothing."""

    value: "Expression | None"


@dataclass(frozen=True)
class PIf(PNode):
    """A branch; `other` is what follows else."""

    condition: "Expression"
    then: PBlock
    other: "PBlock | PIf | None"


@dataclass(frozen=True)
class PWhile(PNode):
    """while (condition) body; a for is made of it."""

    condition: "Expression"
    body: PBlock


@dataclass(frozen=True)
class PDeclare(PNode):
    """A variable of a function."""

    variable: PVariable


@dataclass(frozen=True)
class PAssign(PNode):
    """target operator source, such as += ."""

    operator: str
    target: "Expression"
    source: "Expression"


@dataclass(frozen=True)
class PAlone(PNode):
    """A call whose result nobody takes, or (void)of."""

    of: "Expression"


Expression: TypeAlias = (
    PInteger
    | PTyped
    | PName
    | PField
    | PIndex
    | PCall
    | PUnary
    | PSizeof
    | PCast
    | PBinary
    | PChoose
)
Initialiser: TypeAlias = Expression | PNumbers | PList
Statement: TypeAlias = PBlock | PReturn | PIf | PWhile | PDeclare | PAssign | PAlone


def walk(node: PNode) -> Iterator[PNode]:
    """Yield a node and all that is inside it, the initialisers of variables too."""
    yield node
    for part in _list_parts(node):
        yield from walk(part)


def _list_parts(node: PNode | PVariable) -> Iterator[PNode]:
    for part in vars(node).values():
        for one in part if isinstance(part, tuple) else (part,):
            if isinstance(one, PNode):
                yield one
            elif isinstance(one, PVariable):
                yield from _list_parts(one)


@dataclass(frozen=True)
class PFunction:
    """A function with a body."""

    name: str
    result: str
    parameters: tuple[PVariable, ...]
    body: PBlock


@dataclass
class PProgram:
    """What header, source and runtime declare, in their order."""

    tokens: PTokens
    structs: dict[str, tuple[PVariable, ...]] = field(default_factory=dict)
    constants: list[PVariable] = field(default_factory=list)
    functions: dict[str, PFunction] = field(default_factory=dict)
    declared: dict[str, str] = field(default_factory=dict)
    """PFunction -> its result and parameters, word by word."""
    public: set[str] = field(default_factory=set)
    """Functions that the model's header declares."""
    claims: list[Expression] = field(default_factory=list)
    assembly: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """PFunction -> its lines of assembly."""

    def place(self, at: int) -> str:
        """Return file:line:column of a token."""
        return self.tokens.places[min(at, len(self.tokens.places) - 1)]
