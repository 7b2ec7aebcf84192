"""What the proof's parser makes of C: expressions, statements and declarations.

`CNode.at` counts tokens, so that whatever is found can be told with its place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias


@dataclass
class Tokens:
    """The words of a file and all that it includes, macros replaced."""

    words: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    """file:line:column of each; of what a macro became, that of the macro's use."""
    macros: dict[str, list[str]] = field(default_factory=dict)
    """Macros without parameters -> the words that they stand for."""


@dataclass(frozen=True)
class CNode:
    """An expression, an initialiser or a statement."""

    at: int
    """The token with which it begins."""


@dataclass(frozen=True)
class TypeName:
    """A type as it is written before a name."""

    name: str
    constant: bool = False
    pointer: bool = False
    volatile: bool = False


@dataclass(frozen=True)
class Variable:
    """A declared variable, parameter or field; sizes and initialiser as expressions."""

    type: TypeName
    name: str
    sizes: "tuple[Expression, ...]"
    at: int
    first: "Initialiser | None" = None


@dataclass(frozen=True)
class CInteger(CNode):
    """A literal, as it is written and its number."""

    token: str
    number: int
    unsigned: bool = False


@dataclass(frozen=True)
class CTyped(CNode):
    """A literal with its type, as INT64_C(-3) and UINT32_C(3) are."""

    number: int
    type: str


@dataclass(frozen=True)
class CName(CNode):
    """A variable, a constant or a limit of stdint.h."""

    name: str


@dataclass(frozen=True)
class CField(CNode):
    """of->name or of.name."""

    of: "Expression"
    operator: str
    name: str


@dataclass(frozen=True)
class CIndex(CNode):
    """of[index]."""

    of: "Expression"
    index: "Expression"


@dataclass(frozen=True)
class CCall(CNode):
    """name(arguments)."""

    name: str
    arguments: "tuple[Expression, ...]"


@dataclass(frozen=True)
class CUnary(CNode):
    """One of - + ~ ! & * before an expression."""

    operator: str
    of: "Expression"


@dataclass(frozen=True)
class CSizeof(CNode):
    """sizeof(of), a type's name or an expression."""

    of: "str | Expression"


@dataclass(frozen=True)
class CCast(CNode):
    """(type)of."""

    type: TypeName
    of: "Expression"


@dataclass(frozen=True)
class CBinary(CNode):
    """left operator right."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class CChoose(CNode):
    """condition ? first : second."""

    condition: "Expression"
    first: "Expression"
    second: "Expression"


@dataclass(frozen=True)
class CNumbers(CNode):
    """An initialiser that is nothing but decimal numbers."""

    numbers: list[int]


@dataclass(frozen=True)
class CList(CNode):
    """An initialiser of other things."""

    items: "tuple[Initialiser, ...]"


@dataclass(frozen=True)
class CBlock(CNode):
    """Statements in braces."""

    statements: "tuple[Statement, ...]"


@dataclass(frozen=True)
class CReturn(CNode):
    """Return, of a value or of nothing."""

    value: "Expression | None"


@dataclass(frozen=True)
class CIf(CNode):
    """A branch; `other` is what follows else."""

    condition: "Expression"
    then: CBlock
    other: "CBlock | CIf | None"


@dataclass(frozen=True)
class CWhile(CNode):
    """while (condition) body; a for is made of it."""

    condition: "Expression"
    body: CBlock


@dataclass(frozen=True)
class CDeclare(CNode):
    """A variable of a function."""

    variable: Variable


@dataclass(frozen=True)
class CAssign(CNode):
    """target operator source, such as += ."""

    operator: str
    target: "Expression"
    source: "Expression"


@dataclass(frozen=True)
class CAlone(CNode):
    """A call whose result nobody takes, or (void)of."""

    of: "Expression"


Expression: TypeAlias = (
    CInteger
    | CTyped
    | CName
    | CField
    | CIndex
    | CCall
    | CUnary
    | CSizeof
    | CCast
    | CBinary
    | CChoose
)
Initialiser: TypeAlias = Expression | CNumbers | CList
Statement: TypeAlias = CBlock | CReturn | CIf | CWhile | CDeclare | CAssign | CAlone


def walk(node: CNode) -> Iterator[CNode]:
    """Yield a node and all that is inside it, the initialisers of variables too."""
    yield node
    for part in _list_parts(node):
        yield from walk(part)


def _list_parts(node: CNode | Variable) -> Iterator[CNode]:
    for part in vars(node).values():
        for one in part if isinstance(part, tuple) else (part,):
            if isinstance(one, CNode):
                yield one
            elif isinstance(one, Variable):
                yield from _list_parts(one)


@dataclass(frozen=True)
class Function:
    """A function with a body."""

    name: str
    result: str
    parameters: tuple[Variable, ...]
    body: CBlock


@dataclass
class Program:
    """What header, source and runtime declare, in their order."""

    tokens: Tokens
    structs: dict[str, tuple[Variable, ...]] = field(default_factory=dict)
    constants: list[Variable] = field(default_factory=list)
    functions: dict[str, Function] = field(default_factory=dict)
    declared: dict[str, str] = field(default_factory=dict)
    """Function -> its result and parameters, word by word."""
    public: set[str] = field(default_factory=set)
    """Functions that the model's header declares."""
    claims: list[Expression] = field(default_factory=list)
    assembly: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Function -> its lines of assembly."""

    def place(self, at: int) -> str:
        """Return file:line:column of a token."""
        return self.tokens.places[min(at, len(self.tokens.places) - 1)]
