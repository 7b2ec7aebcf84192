"""Derives the error bound again from the numbers and tables of the C and those of the float model.

The certificate lists the float model signal by signal, with its unrounded numbers and with how the
chip has each: node times scale plus offset. For each the distance of the two is bounded anew, from
what the C computes for that node. A claim below what is found is refused, and so is what has no
rule. Shares no code with what derived the bound first and needs the standard library only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from zerodrift_proof.bound import numbers
from zerodrift_proof.bound.conversion import ConversionCheck
from zerodrift_proof.bound.recurrent import FeatureRange, bound_gru, bound_lstm
from zerodrift_proof.bound.signals import (
    COPY,
    ErrorClaim,
    FloatLine,
    Has,
    Place,
    bound_constant_power,
    bound_limited,
    bound_limits,
    bound_linear,
    bound_power,
    copy_short,
    expect,
    list_gains,
    reach_sum,
    read_bound,
    round_up,
)
from zerodrift_proof.certificate.model import Model
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
from zerodrift_proof.certificate.values import Block, NotUnderstoodError, Pointer, Struct

# What a model's C computes for each node, read into numbers that the error rules need.
#
# A node's number is one expression in C: a sum of others with whole coefficients, shifted and
# limited, or a call of the runtime. Shares no code with the generator.

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


# Derives the error bound again from the numbers and tables of the C and those of the float model.

HALF = Fraction(1, 2)
STATE = 30
EXPONENT_BITS, RING_BITS, LOWPASS_BITS, TABLE_BITS = 24, 31, 24, 16
RECURRENT = ("gru_after", "gru_before", "lstm")


def check_bound(told: Mapping[str, object], model: Model) -> tuple[int, list[str]]:
    """Return how many outputs' bounds hold, and what is wrong with the others.

    Args:
        told: the content of certificate.json.
        model: one way to compile it, which was run.

    Raises:
        NotUnderstoodError: something without a rule.
        KeyError, TypeError, ValueError: it is not built like a certificate.
    """
    claims, lines = read_bound(told)
    if len(claims) != model.outputs:
        return 0, [f"{len(claims)} error bounds are claimed of {model.outputs} outputs"]
    for k, claim in enumerate(claims):
        if lines[claim.signal].place != ("drift", k):
            return 0, [f"{claim.output}: its bound is about another signal than drift[{k}]"]
    derived = _BoundCheck(model, lines, claims, told.get("conversions")).derive()
    failures = [
        f"{claim.output}: an error of at most {float(claim.bound):.17g} is claimed, "
        f"{float(found):.17g} was derived"
        for claim, found in zip(claims, derived, strict=True)
        if found > claim.bound
    ]
    return len(claims) - len(failures), failures


class _BoundCheck:
    def __init__(
        self,
        model: Model,
        lines: Sequence[FloatLine],
        claims: Sequence[ErrorClaim],
        conversions: object,
    ) -> None:
        self._model, self._lines, self._claims = model, lines, claims
        self._forms = read_forms(model.program, model.prefix)
        self._vectors: dict[str, list[tuple[int, int]]] = {}
        self._states: dict[str, list[Fraction]] = {}
        self._conversions = ConversionCheck(
            conversions, model.program.tokens.words, model.prefix, model.constants
        )

    def derive(self) -> list[Fraction]:
        """Return the bound of each output.

        Where loads are read, each is off by what the drift of the step before may be: by what is
        claimed. If the rules then give no more than that, it holds by induction from the start.
        """
        found: list[Has] = []
        for line in self._lines:
            if any(not 0 <= i < len(found) for i in line.of):
                raise ValueError("a signal is made of later ones")
            found.append(self._derive(line, [found[i] for i in line.of]))
        return [found[claim.signal].error for claim in self._claims]

    # --- what the C has

    def _cells(self, name: str) -> list[int]:
        block = self._model.constants.get(name)
        if not isinstance(block, Block):
            raise NotUnderstoodError(f"no table {name}")
        cells = [cell for cell in block.cells if isinstance(cell, int)]
        if len(cells) != block.count:
            raise NotUnderstoodError(f"{name} is no table of numbers")
        return cells

    def _range(self, line: FloatLine) -> tuple[int, int]:
        if not line.node:
            return 0, 0
        if line.node in self._vectors:
            return self._vectors[line.node][line.index]
        if line.node in self._forms and line.node in self._model.bounds:
            low, high, _ = self._model.bounds[line.node]
            return low, high
        raise NotUnderstoodError(f"{line.node}: its range is not known")

    def _derive(self, line: FloatLine, inputs: list[Has]) -> Has:
        if line.operation in RECURRENT:
            return self._state(line, inputs)
        if line.operation == "state":
            return self._any_state(line)
        vector = line.node in ("features", "head") or line.node.startswith("dense_")
        if line.node == "drift":
            claim = self._claims[line.index]
            scale = Fraction(1, claim.counts_per_unit)
            return Has(line, 0, 0, scale, round_up(self._drift(line, inputs, scale)))
        if vector:
            low, high, error = self._row(line, inputs)
            self._vectors.setdefault(line.node, []).append((low, high))
            if len(self._vectors[line.node]) != line.index + 1:
                raise NotUnderstoodError(f"{line.node}: rows out of their order")
            return Has(line, low, high, line.scale, round_up(error))
        low, high = self._range(line)
        out = Has(line, low, high, line.scale, Fraction(0))
        moving = [x for x in inputs if x.line.node]
        if line.operation == "constant":
            error = abs(line.offset - expect(line.numbers[0]))
        elif not line.node or (moving and all(x.line.place == line.place for x in moving)):
            error = self._same_integers(line, out, inputs)
        else:
            error = self._by_form(line, out, inputs, self._forms[line.node])
        return Has(line, low, high, line.scale, round_up(error))

    # --- rules of signals without integers of their own

    def _same_integers(self, line: FloatLine, out: Has, inputs: list[Has]) -> Fraction:
        if line.operation in ("linear", "same"):
            own = {line.place: line.scale} if line.node else {}
            return bound_linear(list_gains(line), inputs, own, line.offset)
        if line.operation == "product":
            a, b = inputs if not inputs[1].line.node else (inputs[1], inputs[0])
            c = b.line.offset
            gap = max(abs(out.at(q) - a.at(q) * c) for q in (a.low, a.high))
            return gap + abs(c) * a.error + (a.size + a.error) * b.error
        extreme = line.operation in ("maximum", "minimum")
        if extreme and inputs[0].line.place == inputs[1].line.place:
            return max(
                x.error + max(abs(out.at(q) - x.at(q)) for q in (x.low, x.high)) for x in inputs
            )
        if line.operation in ("clip", "maximum", "minimum"):
            return bound_limited(line, out.ends, inputs)
        if line.operation == "delay":
            steps = max(expect(line.numbers[0]), Fraction(0)) / expect(line.numbers[1])
            x = inputs[0]
            return x.error + steps * (x.high - x.low) * abs(x.scale)
        if line.operation in ("exp2", "power") and not line.node:
            return bound_constant_power(line, inputs[0])
        raise NotUnderstoodError(f"{line.operation} without a node of its own")

    # --- rules by what the C computes

    def _by_form(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        rule = {
            "input": self._input,
            "load": self._load,
            "counter": self._counter,
            "linear": self._sum,
            "same": self._sum,
            "product": self._product,
            "clip": self._clip,
            "maximum": self._extreme,
            "minimum": self._extreme,
            "lowpass": self._lowpass,
            "delay": self._delay,
            "play": self._play,
            "exp2": self._exp2,
            "power": self._power,
        }.get(line.operation)
        if rule is None:
            raise NotUnderstoodError(f"{line.operation}: no rule for its error")
        return rule(line, out, inputs, form)

    def _input(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        if form.call != CODE or form.shift:
            raise NotUnderstoodError(f"{line.node} is no limited code")
        lsb, offset, taken_off = map(expect, line.numbers)
        factor = form.terms[(CODE,)]
        low, high = form.numbers
        gaps = []
        for code in (low, high):
            q = code * factor + form.constant
            gaps.append(abs(out.at(q) - (offset + lsb * code - taken_off)))
        return max(gaps) + self._conversions.bound(form.table, lsb, offset)

    def _load(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        if form.call != LOAD or form.constant or form.shift:
            raise NotUnderstoodError(f"{line.node} is no load")
        (lsb,) = map(expect, line.numbers)
        if line.scale * form.terms[(LOAD,)] != lsb or line.offset:
            raise NotUnderstoodError(f"{line.node}: its counts are not those of its code")
        claim = self._claims[form.load]
        return claim.bound * claim.counts_per_unit * lsb

    def _counter(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        if form.call != "count" or line.scale != expect(line.numbers[0]) or line.offset:
            raise NotUnderstoodError(f"{line.node} counts another time")
        return Fraction(0)

    def _sum(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        if form.call:
            raise NotUnderstoodError(f"{line.node} is no sum")
        unit = line.scale / (1 << form.shift)
        own = {}
        for factors, c in form.terms.items():
            if len(factors) != 1:
                raise NotUnderstoodError(f"{line.node}: a product within a sum")
            own[(factors[0], 0)] = c * unit
        half = 1 << form.shift >> 1
        constant = (form.constant - (0 if form.rounded else half)) * unit + line.offset
        rounded = HALF * abs(line.scale) if form.shift else Fraction(0)
        return bound_linear(list_gains(line), inputs, own, constant) + rounded

    def _product(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        a, b = inputs
        names = {(a.line.node, b.line.node), (b.line.node, a.line.node)}
        if {*form.terms} - names or len(form.terms) != 1 or form.call or form.constant:
            raise NotUnderstoodError(f"{line.node} is no product")
        if a.line.offset or b.line.offset or line.offset or (form.shift and not form.rounded):
            raise NotUnderstoodError(f"{line.node}: a factor's zero is not 0")
        (factor,) = form.terms.values()
        ratio = factor * line.scale / (a.scale * b.scale * (1 << form.shift))
        gap = abs(ratio - 1) * a.size * b.size
        rounded = HALF * abs(line.scale) if form.shift else Fraction(0)
        return a.error * b.size + b.error * (a.size + a.error) + gap + rounded

    def _clip(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        moving = [x for x in inputs if x.line.node]
        if len(moving) != 1 or form.terms != {(moving[0].line.node,): 1}:
            raise NotUnderstoodError(f"{line.node} limits something else")
        if form.low is None or form.high is None or form.constant or form.shift or form.call:
            raise NotUnderstoodError(f"{line.node} is no limit")
        if (moving[0].scale, moving[0].line.offset) != (line.scale, line.offset):
            raise NotUnderstoodError(f"{line.node} has another meaning than what it limits")
        low, high = sorted((out.at(form.low), out.at(form.high)))
        return bound_limited(line, (low, high), inputs)

    def _extreme(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        if form.low is not None:
            return self._clip(line, out, inputs, form)
        flipped = line.scale < 0
        same = all((x.scale, x.line.offset) == (line.scale, line.offset) for x in inputs)
        wanted = {(x.line.node,): 1 for x in inputs}
        if form.call != line.operation or flipped or not same or form.terms != wanted:
            raise NotUnderstoodError(f"{line.node} is no {line.operation} of its inputs")
        return max(x.error for x in inputs)

    def _follows(self, line: FloatLine, x: Has, form: NodeForm, call: str) -> None:
        same = (x.scale, x.line.offset) == (line.scale, line.offset)
        if form.call != call or form.constant or not same:
            raise NotUnderstoodError(f"{line.node} does not follow its input")
        if call not in ("ring", "between") and form.terms != {(x.line.node,): 1}:
            raise NotUnderstoodError(f"{line.node} reads another input")

    def _lowpass(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        (x,) = inputs
        self._follows(line, x, form, "zd_lowpass")
        c_q24, m_q31, shift = form.numbers
        tau_s, period_s = map(expect, line.numbers)
        a, c = Fraction(m_q31, 1 << (shift + 22)), Fraction(c_q24, 1 << LOWPASS_BITS)
        # real: y' = y + A (x - y) + C (x' - x)
        forgets = [1 - kept for kept in numbers.exp(-period_s / tau_s)]
        straight = [1 - share * tau_s / period_s for share in forgets]
        if not (0 < a <= 1 and 0 <= c <= 1):
            raise NotUnderstoodError(f"{line.node} is no low-pass")
        span = Fraction(x.high - x.low, 2) + x.error / abs(x.scale)
        of_a = max(abs(share - a) for share in forgets) / a
        of_c = max(abs(share - c) for share in straight)
        counts = 2 * span * (of_a * (1 - min(straight)) + of_c)
        counts += Fraction(1, 8) + 1 / (a * (1 << 25)) + HALF
        return x.error + counts * abs(x.scale)

    def _delay(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        (x,) = inputs
        share = Fraction(form.numbers[0], 1 << RING_BITS) if form.call == "between" else Fraction(0)
        self._follows(line, x, form, "between" if share else "ring")
        delay_s, period_s = map(expect, line.numbers)
        fields = self._model.program.structs[f"{self._model.prefix}_state_t"]
        (ring,) = [f for f in fields if f.name == f"{line.node}_line"]
        steps = self._model.constant(ring.sizes[0])
        wrong = abs(steps - share - delay_s / period_s) * (x.high - x.low)
        return x.error + (wrong + (HALF if share else 0)) * abs(x.scale)

    def _play(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        (x,) = inputs
        self._follows(line, x, form, "zd_play")
        width = expect(line.numbers[0]) / abs(x.scale)
        span = x.high - x.low
        if width >= span and form.numbers[0] >= span:  # neither moves but by what x is off
            return 3 * x.error
        return x.error + abs(form.numbers[0] - width) * abs(x.scale)

    def _exp2(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        (x,) = inputs
        if form.call != "zd_exp2" or form.low is None or form.high is None:
            raise NotUnderstoodError(f"{line.node} is no limited power of two")
        unit = Fraction(1, 1 << (form.shift + EXPONENT_BITS))
        own = {(factors[0], 0): c * unit for factors, c in form.terms.items() if len(factors) == 1}
        constant = (form.constant - (1 << form.shift >> 1)) * unit
        off = bound_linear([Fraction(1)], [x], own, constant)
        off += HALF / (1 << EXPONENT_BITS) if form.shift else 0
        (top,) = form.numbers
        if off > 1 or line.scale != Fraction(2) ** (top - 27) or line.offset:
            raise NotUnderstoodError(f"{line.node}: its exponent is off by more than 1")
        largest = numbers.exp2(Fraction(form.high, 1 << EXPONENT_BITS))[1]
        moved = largest * (numbers.exp2(off)[1] - 1) if off else Fraction(0)
        octave = tuple(self._model.tables["zd_exp2_octave_q29"])
        far = top + 2 - (form.low >> EXPONENT_BITS) > 31
        rounded = line.scale * (1 if far else HALF)
        return moved + rounded + numbers.exp2_octave(octave) * line.scale / 4

    def _power(self, line: FloatLine, out: Has, inputs: list[Has], form: NodeForm) -> Fraction:
        (x,) = inputs
        table = self._model.constants.get(form.table)
        if form.call != "zd_power" or form.terms != {(x.line.node,): 1} or form.constant:
            raise NotUnderstoodError(f"{line.node} is no power of its input")
        if x.line.offset or x.scale <= 0 or line.offset or not isinstance(table, Struct):
            raise NotUnderstoodError(f"{line.node}: a power of what is not counted from 0")
        exponent = expect(line.numbers[0])
        octave, gains = (self._column(table.tables[name]) for name in ("octave", "gains"))
        low, high, shift = (_one(table.fields[name]) for name in ("low", "high", "shift"))
        top = numbers.power(Fraction(2), exponent)[1] * low
        off = numbers.power_octave(tuple(octave), exponent, low) + max(top - high, Fraction(0))
        unit = line.scale / (1 << shift)
        worst_gain = worst_octave = Fraction(0)
        of_scale = numbers.power(x.scale, exponent)
        for n, gain in enumerate(gains[: max(x.high, 1).bit_length()]):
            of_n = numbers.power(Fraction(1 << n), exponent)
            wanted = (of_scale[0] * of_n[0], of_scale[1] * of_n[1])
            gap = max(abs(gain * unit * low - end) for end in wanted)
            worst_gain = max(worst_gain, gap * top / low)
            worst_octave = max(worst_octave, off * gain * unit)
        rounded = line.scale * HALF if shift else Fraction(0)
        return worst_gain + worst_octave + rounded + bound_power(x, exponent)

    def _column(self, pointer: object) -> list[int]:
        if not isinstance(pointer, Pointer):
            raise NotUnderstoodError("no table of a power")
        return self._cells(pointer.block.name)

    # --- rows: features, layers, head, drift

    def _row(self, line: FloatLine, inputs: list[Has]) -> tuple[int, int, Fraction]:
        if line.node == "features":
            return self._feature(line, inputs)
        if line.node == "head":
            weights = self._weights("head_weights", line.index, len(inputs))
            copies = [copy_short(x) for x in inputs]
            own = {x.line.place: w * line.scale for x, w in zip(inputs, weights, strict=True)}
            low, high = reach_sum(weights, copies)
            return low, high, bound_linear(list_gains(line), copies, own, line.offset)
        return self._dense(line, inputs)

    def _state(self, line: FloatLine, inputs: list[Has]) -> Has:
        """Return a unit of a recurrent layer: those of its node depend on each other."""
        layer, below, copied = self._find_layer(line)
        if line.scale != Fraction(1, 1 << (COPY if copied else STATE)) or line.offset:
            raise NotUnderstoodError(f"{line.node}: a state in another format")
        if any(x.line.place != (below, k) or x.line.offset for k, x in enumerate(inputs)):
            raise NotUnderstoodError(f"{line.node} reads something else than {below}")
        if line.node not in self._states:
            self._states[line.node] = self._find_states(line, layer, inputs)
        errors = self._states[line.node]
        if not 0 <= line.index < len(errors):
            raise NotUnderstoodError(f"{line.node}[{line.index}] is no unit")
        most, error = self._model.h_limit, errors[line.index]
        if copied:
            most, error = most + (1 << STATE - COPY >> 1) >> STATE - COPY, error + HALF * line.scale
        return Has(line, -most, most, line.scale, round_up(error))

    def _any_state(self, line: FloatLine) -> Has:
        """Return a topmost state of a recurrent layer that may be anything from -1 to 1."""
        layers = {**self._model.grus, **self._model.lstms}
        top, level = line.node, 0
        while f"{line.node}.{level}" in layers:
            top, level = f"{line.node}.{level}", level + 1
        width = layers[top].hidden if top in layers else 0
        if line.of or line.numbers or not 0 <= line.index < width:
            raise NotUnderstoodError(f"{line.node}[{line.index}] is no state of a recurrent layer")
        if line.scale != Fraction(1, 1 << STATE) or line.offset:
            raise NotUnderstoodError(f"{line.node}: a state in another format")
        most = self._model.h_limit
        return Has(line, -most, most, line.scale, 1 + most * line.scale)

    def _find_layer(self, line: FloatLine) -> tuple[str, str, bool]:
        """Return a layer's name, what it reads, and whether it is read as an int16 copy.

        GRUs on top of each other are NAME.0, NAME.1, ...; the topmost one's state is NAME's.
        """
        name, _, level = line.node.partition(".")
        levels = 0
        while f"{name}.{levels}" in self._model.grus:
            levels += 1
        if not levels:
            return line.node, "features", False
        at = int(level) if level in map(str, range(levels - 1)) else levels - 1
        if not level or at < levels - 1:
            return f"{name}.{at}", f"{name}.{at - 1}" if at else "features", bool(level)
        raise NotUnderstoodError(f"{line.node} is no layer below another")

    def _find_states(self, line: FloatLine, name: str, inputs: list[Has]) -> list[Fraction]:
        rows = [x for x in self._lines if x.node == line.node]
        alike = all((x.operation, x.of) == (line.operation, line.of) for x in rows)
        if not alike or [x.index for x in rows] != list(range(len(rows))):
            raise NotUnderstoodError(f"{line.node}: its units are not listed one by one")
        features = [FeatureRange(x.low, x.high, x.scale, x.error) for x in inputs]
        given = [[expect(number) for number in x.numbers] for x in rows]
        lines = tuple(self._model.tanh_lines)
        if line.operation == "lstm":
            if line.node not in self._model.lstms:
                raise NotUnderstoodError(f"{line.node} is no LSTM")
            return bound_lstm(self._model.lstms[line.node], given, features, lines)
        if name not in self._model.grus:
            raise NotUnderstoodError(f"{line.node} is no GRU")
        layer = self._model.grus[name]
        if layer.after != (line.operation == "gru_after"):
            raise NotUnderstoodError(f"{line.node}: the reset gate acts elsewhere")
        return bound_gru(layer, given, features, lines)

    def _weights(self, name: str, row: int, count: int) -> list[int]:
        cells = self._cells(name)
        if count == 0 or len(cells) % count:
            raise NotUnderstoodError(f"{name}: rows of another length")
        return cells[row * count : (row + 1) * count]

    def _feature(self, line: FloatLine, inputs: list[Has]) -> tuple[int, int, Fraction]:
        block = self._model.constants.get("features_matrix")
        if not isinstance(block, Block):
            raise NotUnderstoodError("no matrix of features")
        signals = self._read_signals()
        row = self._weights("features_matrix", line.index, block.sizes[-1])
        shift = self._cells("features_shift")[line.index]
        bias = self._cells("features_bias")[line.index]
        unit = line.scale / (1 << shift)
        own: dict[Place, Fraction] = {}
        low = high = bias
        for name, weight in zip(signals, row, strict=True):
            own[(name, 0)] = own.get((name, 0), Fraction(0)) + weight * unit
            first, last, _ = self._model.bounds[name]
            ends = sorted((weight * first, weight * last))
            low, high = low + ends[0], high + ends[1]
        constant = (bias - (1 << shift >> 1)) * unit + line.offset
        error = bound_linear(list_gains(line), inputs, own, constant)
        held = [min(max(end >> shift, -32768), 32767) for end in (low, high)]
        return held[0], held[1], error + (HALF * line.scale if shift else 0)

    def _read_signals(self) -> list[str]:
        """Return the names of what the features are made of, in their order."""
        return find_list(self._model.program, self._model.prefix, "signals")

    def _dense(self, line: FloatLine, inputs: list[Has]) -> tuple[int, int, Fraction]:
        if line.operation not in ("dense_tanh", "dense_clip"):
            raise NotUnderstoodError(f"{line.node}: {line.operation}")
        given, gains = line.numbers[:2], [expect(x) for x in line.numbers[3:]]
        bias = expect(line.numbers[2])
        copies = inputs if inputs[0].line.node == "features" else [copy_short(x) for x in inputs]
        weights = self._weights(f"{line.node}_weights", line.index, len(inputs))
        own_bias = self._cells(f"{line.node}_bias")[line.index]
        shift = self._cells(f"{line.node}_shift")[line.index]
        tanh = line.operation == "dense_tanh"
        copy = Fraction(1, 1 << TABLE_BITS) if tanh else line.scale * (1 << COPY)
        own = {x.line.place: w * copy / (1 << shift) for x, w in zip(inputs, weights, strict=True)}
        constant = (own_bias - (1 << shift >> 1)) * copy / (1 << shift) - bias
        error = bound_linear(gains, copies, own, constant) + (HALF * copy if shift else 0)
        low, high = (end + own_bias >> shift for end in reach_sum(weights, copies))
        if not tanh:
            ends = [self._cells(f"{line.node}_{end}")[line.index] for end in ("low", "high")]
            gap = bound_limits(given, (low * copy, high * copy), (ends[0] * copy, ends[1] * copy))
            held = [min(max(end, ends[0]), ends[1]) << COPY for end in (low, high)]
            return held[0], held[1], error + gap
        if line.scale != Fraction(1, 1 << 30):
            raise NotUnderstoodError(f"{line.node}: tanh in another format")
        least = max(low * copy - error, -high * copy - error, Fraction(0))
        slope = Fraction(1)
        if least > 0:
            e = numbers.exp(2 * min(least, Fraction(32)))[0]
            slope = 4 * e / (1 + e) ** 2
        table = numbers.cached_tanh_error(tuple(self._model.tanh_lines))
        most = self._model.tanh_max
        return -most, most, slope * error + table * line.scale

    def _drift(self, line: FloatLine, inputs: list[Has], scale: Fraction) -> Fraction:
        form = self._forms[f"drift[{line.index}]"]
        if form.call or form.rounded:
            raise NotUnderstoodError("the drift is no sum")
        unit = scale / (1 << form.shift)
        own = {}
        for factors, c in form.terms.items():
            name, _, index = factors[0].rstrip("]").partition("[")
            own[(name, int(index or 0))] = c * unit
        constant = (form.constant - (1 << form.shift >> 1)) * unit
        rounded = HALF * scale if form.shift else Fraction(0)
        return bound_linear(list_gains(line), inputs, own, constant) + rounded


def _one(block: Block) -> int:
    cell = block.cells[0]
    if not isinstance(cell, int):
        raise NotUnderstoodError(f"{block.name} is no number")
    return cell
