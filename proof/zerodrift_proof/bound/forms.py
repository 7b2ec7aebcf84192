"""What a model's C computes for each node, read into numbers that the error rules need.

A node's number is one expression in C: a sum of others with whole coefficients, shifted and
limited, or a call of the runtime. Shares no code with the generator.
"""

from dataclasses import dataclass, field, replace

from zerodrift_proof.certificate.parser import (
    CAssign,
    CBinary,
    CBlock,
    CCall,
    CCast,
    CChoose,
    CDeclare,
    CField,
    CIndex,
    CInteger,
    CList,
    CName,
    CNode,
    CNumbers,
    CUnary,
    Expression,
    Program,
    walk,
)
from zerodrift_proof.certificate.values import NotUnderstoodError

CODE, LOAD = "code", "load"
"""Names of a limited input and of a limited load within a form."""


@dataclass(frozen=True)
class NodeForm:
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
    """Of a power; of a code the field of the input."""
    load: int = -1
    """Index of the drift that a load is less by."""


def read_forms(program: Program, prefix: str) -> dict[str, NodeForm]:
    """Return node -> form, outputs as drift[0] and so on; what has none is left out."""
    forms: dict[str, NodeForm] = {}
    body = program.functions[f"{prefix}_advance"].body
    for block in _list_blocks(program, prefix):
        local: dict[str, Expression] = {}
        for statement in block.statements:
            if isinstance(statement, CDeclare):
                variable = statement.variable
                first = variable.first
                if not variable.sizes and not isinstance(first, CNumbers | CList | None):
                    local[variable.name] = first
            elif isinstance(statement, CAssign):
                cell = _name_cell(statement.target)
                if cell.startswith("drift["):
                    forms[cell] = _read(statement.source, local)
        if block is body:
            for name, value in local.items():
                try:
                    forms[name] = _read(value, {})
                except NotUnderstoodError:
                    continue  # no node: flags, the place in a ring
    return forms


def find_list(program: Program, prefix: str, name: str) -> list[str]:
    """Return the names that an array within a step is filled with."""
    for block in _list_blocks(program, prefix):
        for statement in block.statements:
            if isinstance(statement, CDeclare) and statement.variable.name == name:
                first = statement.variable.first
                if isinstance(first, CList):
                    return [item.name for item in first.items if isinstance(item, CName)]
    raise NotUnderstoodError(f"no array {name}")


def _list_blocks(program: Program, prefix: str) -> list[CBlock]:
    body = program.functions[f"{prefix}_advance"].body
    return [node for node in walk(body) if isinstance(node, CBlock)]


def _name_cell(node: CNode) -> str:
    """Return name[3] for an element with a number as its index, else ""."""
    if not isinstance(node, CIndex) or not isinstance(node.of, CName):
        return ""
    return f"{node.of.name}[{node.index.number}]" if isinstance(node.index, CInteger) else ""


def _number(node: Expression) -> int:
    form = _read(node, {})
    if form.terms or form.shift or form.call:
        raise NotUnderstoodError("a number was expected")
    return form.constant


def _read(node: Expression, local: dict[str, Expression]) -> NodeForm:
    match node:
        case CInteger():
            return NodeForm(constant=node.number)
        case CCast():
            return _read(node.of, local)
        case CName() if node.name in local:
            return _read(local[node.name], local)
        case CName():
            return NodeForm({(node.name,): 1})
        case CIndex() if cell := _name_cell(node):
            return NodeForm({(cell,): 1})
        case CIndex():
            return NodeForm({("ring",): 1}, call="ring")
        case CField() if node.name.endswith("_count"):
            return NodeForm({(node.name,): 1}, call="count")
        case CUnary(operator="-"):
            return _scale(_read(node.of, local), -1)
        case CBinary(operator="+" | "-" | "*"):
            return _combine(node.operator, _read(node.left, local), _read(node.right, local))
        case CChoose(condition=CBinary(operator="<" | ">") as condition):
            pair = [_read(x, local) for x in (condition.left, condition.right)]
            if pair == [_read(x, local) for x in (node.first, node.second)]:
                names = [next(iter(form.terms))[0] for form in pair]
                call = "maximum" if condition.operator == ">" else "minimum"
                return NodeForm({(name,): 1 for name in names}, call=call)
        case CCall():
            return _read_call(node.name, node.arguments, local)
    raise NotUnderstoodError(f"a {type(node).__name__} in a node's expression")


def _plain(form: NodeForm) -> NodeForm:
    if form.shift or form.low is not None or (form.call and form.call not in (CODE, LOAD)):
        raise NotUnderstoodError("arithmetic on what was shifted or limited")
    return form


def _scale(form: NodeForm, factor: int) -> NodeForm:
    form = _plain(form)
    terms = {name: c * factor for name, c in form.terms.items()}
    return replace(form, terms=terms, constant=form.constant * factor)


def _combine(operator: str, left: NodeForm, right: NodeForm) -> NodeForm:
    left, right = _plain(left), _plain(right)
    if operator == "*":
        if not left.terms or not right.terms:
            number, form = (left, right) if not left.terms else (right, left)
            return _scale(form, number.constant)
        if left.constant or right.constant:
            raise NotUnderstoodError("a product of sums")
        terms = {(*a, *b): x * y for a, x in left.terms.items() for b, y in right.terms.items()}
        return NodeForm(terms)
    if operator == "-":
        right = _scale(right, -1)
    terms = dict(left.terms)
    for name, c in right.terms.items():
        terms[name] = terms.get(name, 0) + c
    whole = left if left.call else right
    return replace(whole, terms=terms, constant=left.constant + right.constant)


def _read_call(
    name: str, arguments: tuple[Expression, ...], local: dict[str, Expression]
) -> NodeForm:
    if name in ("INT64_C", "INT32_C", "UINT32_C"):
        return _read(arguments[0], local)
    if name == "zd_load":
        index = _name_field(arguments[1])
        low, high = _number(arguments[2]), _number(arguments[3])
        return NodeForm({(LOAD,): 1}, call=LOAD, numbers=(low, high), load=index)
    if name in ("zd_clamp32", "zd_clamp64"):
        low, high = _number(arguments[1]), _number(arguments[2])
        if isinstance(arguments[0], CField):
            return NodeForm({(CODE,): 1}, call=CODE, numbers=(low, high), table=arguments[0].name)
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
        table = arguments[0]
        if not isinstance(table, CUnary) or not isinstance(table.of, CName):
            raise NotUnderstoodError("a power without a table")
        return replace(_plain(_read(arguments[1], local)), call=name, table=table.of.name)
    if name == "zd_between":
        return NodeForm({("ring",): 1}, call="between", numbers=(_number(arguments[2]),))
    raise NotUnderstoodError(f"a call of {name}")


def _name_field(node: Expression) -> int:
    """Return 3 for s->drift[3]."""
    if not isinstance(node, CIndex) or not isinstance(node.of, CField) or node.of.name != "drift":
        raise NotUnderstoodError("a load that is less by no drift")
    return _number(node.index)
