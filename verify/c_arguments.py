"""Arguments of the runtime's functions, held against the parameters that these have.

Shares no code with the generator and needs the standard library only.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from zerodrift.verify.c_intervals import IntervalMachine
from zerodrift.verify.c_values import TYPES, Address, FaultError, Pointer, Value

Action = Callable[..., Any]
"""(machine, *arguments) -> what the function returns."""


def typed(types: str, action: Action, result: str = "") -> Action:
    """Return a rule that first holds the arguments against the function's parameters.

    Args:
        types: of the parameters: a number's type; `const T *` or `T *`, of which the second is
            written to; `&S`, a struct of the runtime.
        action: what it does with them.
        result: the type of what it returns.
    """
    kinds = [kind.strip() for kind in types.split(",")] if types else []

    def rule(machine: IntervalMachine, *arguments: Any) -> Any:
        if len(arguments) != len(kinds):
            raise FaultError(f"{len(arguments)} arguments where {len(kinds)} are expected")
        given = [check(machine, k, a) for k, a in zip(kinds, arguments, strict=True)]
        found = action(machine, *given)
        return replace(found, type=result, copy_of=None) if result else None

    return rule


def check(machine: IntervalMachine, kind: str, argument: Any) -> Any:
    """Return an argument as the parameter holds it.

    Raises:
        FaultError: it is of another type.
    """
    if kind in TYPES:
        value = machine.as_number(argument)
        return machine.keep(value, kind)
    if kind[0] == "&":
        if not isinstance(argument, Address) or argument.struct.type != kind[1:] or argument.bytes:
            raise FaultError(f"another type than {kind[1:]} is given")
        return argument.struct
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
