"""What a proof tells part by part, and how the C's text is compared without its places."""

from dataclasses import dataclass

from zerodrift_proof.equality.syntax import PNode, PVariable
from zerodrift_proof.equality.terms import UndecidedError
from zerodrift_proof.equality.tokens import RefusedError

UNCHECKED = (UndecidedError, RefusedError, RecursionError, KeyError, ValueError)
PROVEN, TESTED, OPEN = "proven", "tested, not proven", "not proven"


@dataclass(frozen=True)
class ShownPart:
    """One thing that the C does, and whether it is what the specification says."""

    what: str
    """A function, a node, a table or a kernel."""
    build: str
    """Of which way to compile it."""
    verdict: str
    """proven | tested, not proven | not proven."""
    why: str = ""
    """Why it is not proven."""


def tell(error: Exception) -> str:
    """Return why something could not be shown."""
    return str(error) if str(error) else type(error).__name__


def shape_variable(variable: PVariable) -> tuple[object, ...]:
    """Return a declaration without its place."""
    first = None if variable.first is None else shape(variable.first)
    return variable.type, variable.name, tuple(shape(s) for s in variable.sizes), first


def shape(node: PNode) -> tuple[object, ...]:
    """Return a node without the places of its tokens."""
    parts: list[object] = [type(node).__name__]
    for name, value in vars(node).items():
        if name == "at":
            continue
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, PNode):
                parts.append(shape(one))
            elif isinstance(one, PVariable):
                parts.append(shape_variable(one))
            else:
                parts.append(tuple(one) if isinstance(one, list) else one)
        parts.append(name)
    return tuple(parts)
