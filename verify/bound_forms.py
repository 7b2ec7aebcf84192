"""What a model's C computes for each node, read into numbers that the error rules need.

A node's number is one expression in C: a sum of others with whole coefficients, shifted and
limited, or a call of the runtime. Shares no code with the generator.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from zerodrift.verify.c_nodes import CNode, Program, Variable
from zerodrift.verify.c_values import NotUnderstoodError

CODE, LOAD = "code", "load"
"""Names of a limited input and of a limited load within a form."""


@dataclass(frozen=True)
class Form:
    """limit((sum of coefficients times products of nodes + constant) >> shift)."""

    terms: dict[tuple[str, ...], int] = field(default_factory=dict)
    """Names of the factors -> coefficient."""
    constant: int = 0
    shift: int = 0
    rounded: bool = False
    """Whether half of the shift's count was added beside the constant."""
    low: int | None = None
    high: int | None = None
    call: str = ""
    """The runtime's function that gives the number; then terms are its one argument."""
    numbers: tuple[int, ...] = ()
    """The other arguments of that."""
    table: str = ""
    load: int = -1
    """Index of the drift that a load is less by."""


def read_forms(program: Program, prefix: str) -> dict[str, Form]:
    """Return node -> form, outputs as drift[0] and so on; what has none is left out."""
    forms: dict[str, Form] = {}
    body = program.functions[f"{prefix}_advance"].body
    for block in _list_blocks(body):
        local: dict[str, CNode] = {}
        for statement in block.parts:
            if statement.kind == "declare":
                variable: Variable = statement.parts[0]
                if variable.first is not None and not variable.sizes:
                    local[variable.name] = variable.first
            cell = _name_cell(statement.parts[1]) if statement.kind == "assign" else ""
            if cell.startswith("drift["):
                forms[cell] = _read(statement.parts[2], local)
        if block is body:
            for name, first in local.items():
                try:
                    forms[name] = _read(first, {})
                except NotUnderstoodError:
                    continue  # no node: flags, the place in a ring
    return forms


def _list_blocks(node: Any) -> Iterator[CNode]:
    if isinstance(node, CNode):
        if node.kind == "block":
            yield node
        for part in node.parts:
            yield from _list_blocks(part)
    elif isinstance(node, tuple | list):
        for part in node:
            yield from _list_blocks(part)


def _name_cell(node: CNode) -> str:
    """Return name[3] for an element with a number as its index, else ""."""
    if node.kind != "index" or node.parts[0].kind != "name" or node.parts[1].kind != "integer":
        return ""
    return f"{node.parts[0].parts[0]}[{node.parts[1].parts[1]}]"


def _number(node: CNode) -> int:
    form = _read(node, {})
    if form.terms or form.shift or form.call:
        raise NotUnderstoodError("a number was expected")
    return form.constant


def _read(node: CNode, local: dict[str, CNode]) -> Form:
    kind, parts = node.kind, node.parts
    if kind == "integer":
        return Form(constant=parts[1])
    if kind == "cast":
        return _read(parts[1], local)
    if kind == "name":
        name = parts[0]
        return _read(local[name], local) if name in local else Form({(name,): 1})
    if kind == "index" and (cell := _name_cell(node)):
        return Form({(cell,): 1})
    if kind == "index":
        return Form({("ring",): 1}, call="ring")
    if kind == "field" and parts[2].endswith("_count"):
        return Form({(parts[2],): 1}, call="count")
    if kind == "unary" and parts[0] == "-":
        return _scale(_read(parts[1], local), -1)
    if kind == "binary" and parts[0] in "+-*":
        return _combine(parts[0], _read(parts[1], local), _read(parts[2], local))
    if kind == "choose" and parts[0].kind == "binary" and parts[0].parts[0] in "<>":
        pair = [_read(x, local) for x in (*parts[0].parts[1:], *parts[1:])]
        if pair[:2] == pair[2:]:
            names = tuple(next(iter(p.terms))[0] for p in pair[:2])
            largest = parts[0].parts[0] == ">"
            return Form({(name,): 1 for name in names}, call="maximum" if largest else "minimum")
    if kind == "call":
        return _read_call(parts[0], parts[1], local)
    raise NotUnderstoodError(f"a {kind} in a node's expression")


def _plain(form: Form) -> Form:
    if form.shift or form.low is not None or (form.call and form.call not in (CODE, LOAD)):
        raise NotUnderstoodError("arithmetic on what was shifted or limited")
    return form


def _scale(form: Form, factor: int) -> Form:
    form = _plain(form)
    terms = {name: c * factor for name, c in form.terms.items()}
    return replace(form, terms=terms, constant=form.constant * factor)


def _combine(operator: str, left: Form, right: Form) -> Form:
    left, right = _plain(left), _plain(right)
    if operator == "*":
        if not left.terms or not right.terms:
            number, form = (left, right) if not left.terms else (right, left)
            return _scale(form, number.constant)
        if left.constant or right.constant:
            raise NotUnderstoodError("a product of sums")
        terms = {(*a, *b): x * y for a, x in left.terms.items() for b, y in right.terms.items()}
        return Form(terms)
    if operator == "-":
        right = _scale(right, -1)
    terms = dict(left.terms)
    for name, c in right.terms.items():
        terms[name] = terms.get(name, 0) + c
    whole = left if left.call else right
    return replace(whole, terms=terms, constant=left.constant + right.constant)


def _read_call(name: str, arguments: tuple[CNode, ...], local: dict[str, CNode]) -> Form:
    if name in ("INT64_C", "INT32_C", "UINT32_C"):
        return _read(arguments[0], local)
    if name == "zd_load":
        index = _name_field(arguments[1])
        low, high = _number(arguments[2]), _number(arguments[3])
        return Form({(LOAD,): 1}, call=LOAD, numbers=(low, high), load=index)
    if name in ("zd_clamp32", "zd_clamp64"):
        low, high = _number(arguments[1]), _number(arguments[2])
        if arguments[0].kind == "field":
            return Form({(CODE,): 1}, call=CODE, numbers=(low, high))
        form = _read(arguments[0], local)
        if form.low is not None or form.call:
            raise NotUnderstoodError("two limits")
        return replace(form, low=low, high=high)
    if name in ("zd_asr64", "zd_asr32", "zd_round_shift64"):
        form = _plain(_read(arguments[0], local))
        shift = _number(arguments[1])
        return replace(form, shift=shift, rounded=name == "zd_round_shift64")
    if name == "zd_exp2":
        return replace(_read(arguments[0], local), call=name, numbers=(_number(arguments[1]),))
    if name in ("zd_lowpass", "zd_play"):
        numbers = tuple(map(_number, arguments[2:]))
        return replace(_plain(_read(arguments[1], local)), call=name, numbers=numbers)
    if name == "zd_power":
        table = arguments[0].parts[1].parts[0]
        return replace(_plain(_read(arguments[1], local)), call=name, table=table)
    if name == "zd_between":
        return Form({("ring",): 1}, call="between", numbers=(_number(arguments[2]),))
    raise NotUnderstoodError(f"a call of {name}")


def _name_field(node: CNode) -> int:
    """Return 3 for s->drift[3]."""
    if node.kind != "index" or node.parts[0].kind != "field" or node.parts[0].parts[2] != "drift":
        raise NotUnderstoodError("a load that is less by no drift")
    return _number(node.parts[1])


def find_list(program: Program, prefix: str, name: str) -> list[str]:
    """Return the names that an array within a step is filled with."""
    for block in _list_blocks(program.functions[f"{prefix}_advance"].body):
        for statement in block.parts:
            if statement.kind == "declare" and statement.parts[0].name == name:
                first = statement.parts[0].first
                if first is not None and first.kind == "list":
                    return [str(item.parts[0]) for item in first.parts if item.kind == "name"]
    raise NotUnderstoodError(f"no array {name}")
