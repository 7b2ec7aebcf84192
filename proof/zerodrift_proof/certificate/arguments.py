"""Arguments of the runtime's functions, held against the parameters that these have.

Shares no code with the generator and needs the standard library only.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from zerodrift_proof.certificate.intervals import IntervalMachine, Rule
from zerodrift_proof.certificate.values import (
    TYPES,
    Address,
    FaultError,
    Found,
    Pointer,
    Struct,
    Value,
)

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
