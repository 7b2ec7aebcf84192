"""What the C of a generated model is read into: expressions, statements and declarations.

Shares no code with the generator and needs the standard library only.
"""

from dataclasses import dataclass, field
from typing import Any

from zerodrift.verify.c_reader import Tokens


@dataclass(frozen=True)
class CNode:
    """An expression or statement: its kind, where it stands, and its parts."""

    kind: str
    at: int
    parts: tuple[Any, ...]


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
    sizes: tuple[CNode, ...]
    at: int
    first: CNode | None = None
    """Its initialiser."""


@dataclass(frozen=True)
class Function:
    """A function with a body."""

    name: str
    result: str
    parameters: tuple[Variable, ...]
    body: CNode


@dataclass
class Program:
    """What header and source declare, in their order."""

    tokens: Tokens
    structs: dict[str, tuple[Variable, ...]] = field(default_factory=dict)
    constants: list[Variable] = field(default_factory=list)
    functions: dict[str, Function] = field(default_factory=dict)
    claims: list[CNode] = field(default_factory=list)
    assembly: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Function -> its lines of assembly."""

    def place(self, at: int) -> str:
        """Return file:line of a token."""
        return self.tokens.places[min(at, len(self.tokens.places) - 1)]
