"""What the C of a generated model is read into: expressions, statements and declarations.

Shares no code with the generator and needs the standard library only.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias


class PlacedWords(Protocol):
    """What a program is read from: its words, where each stands, and macros by name."""

    @property
    def words(self) -> Sequence[str]:
        """All of them, in their order."""

    @property
    def places(self) -> Sequence[str]:
        """file:line of each, or file:line:column."""

    @property
    def macros(self) -> Mapping[str, Sequence[str]]:
        """Name -> the words that it stands for."""


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
    """A literal."""

    token: str
    number: int
    unsigned: bool = False
    longs: int = 0
    """How many l it ends with."""


@dataclass(frozen=True)
class CName(CNode):
    """A variable, a constant or a macro of the runtime."""

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
class CFor(CNode):
    """for (type name = first; name operator end; name++) body."""

    type: str
    name: str
    first: "Expression"
    operator: str
    end: "Expression"
    body: CBlock


@dataclass(frozen=True)
class CWhile(CNode):
    """while (condition) body; the certificate's checker has no rule for it, and reads none."""

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
    CInteger | CName | CField | CIndex | CCall | CUnary | CSizeof | CCast | CBinary | CChoose
)
Initialiser: TypeAlias = Expression | CNumbers | CList
Statement: TypeAlias = CBlock | CReturn | CIf | CFor | CWhile | CDeclare | CAssign | CAlone


def list_parts(node: CNode | Variable) -> Iterator[CNode]:
    """Yield the nodes that a node is made of, those of a variable that it declares too."""
    for part in vars(node).values():
        for one in part if isinstance(part, tuple) else (part,):
            if isinstance(one, CNode):
                yield one
            elif isinstance(one, Variable):
                yield from list_parts(one)


def walk(node: CNode) -> Iterator[CNode]:
    """Yield a node and all that is inside it."""
    yield node
    for part in list_parts(node):
        yield from walk(part)


def are_alike(one: CNode, other: CNode) -> bool:
    """Return whether two nodes are the same words, wherever they stand."""
    mine, its = ({**vars(node), "at": 0} for node in (one, other))
    parts = zip(list_parts(one), list_parts(other), strict=False)
    plain = all(
        mine[name] == its.get(name) for name in mine if not isinstance(mine[name], CNode | tuple)
    )
    counts = len(list(list_parts(one))) == len(list(list_parts(other)))
    return type(one) is type(other) and plain and counts and all(are_alike(*two) for two in parts)


def is_name(node: CNode | None, name: str) -> bool:
    """Return whether a node is nothing but this name."""
    return isinstance(node, CName) and node.name == name


@dataclass(frozen=True)
class Function:
    """A function with a body."""

    name: str
    result: str
    parameters: tuple[Variable, ...]
    body: CBlock


@dataclass
class Program:
    """What header and source declare, in their order."""

    tokens: PlacedWords
    structs: dict[str, tuple[Variable, ...]] = field(default_factory=dict)
    constants: list[Variable] = field(default_factory=list)
    functions: dict[str, Function] = field(default_factory=dict)
    claims: list[Expression] = field(default_factory=list)
    claim_names: list[str] = field(default_factory=list)
    assembly: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Function -> its lines of assembly."""
    declared: dict[str, int] = field(default_factory=dict)
    """Function -> the token of its first declaration."""
    signatures: dict[str, str] = field(default_factory=dict)
    """Function -> the words of its result and of its parameters, up to the last bracket."""
    static: set[str] = field(default_factory=set)
    """Functions that are."""
    naked: set[str] = field(default_factory=set)
    """Functions that are declared to have nothing around their assembly."""

    def place(self, at: int) -> str:
        """Return file:line of a token."""
        return self.tokens.places[min(at, len(self.tokens.places) - 1)]
