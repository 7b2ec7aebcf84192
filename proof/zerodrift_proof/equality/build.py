"""One way to read the model's C, held against the specification, function by function.

What a proof tells part by part, and how the C's text is compared without its places.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from zerodrift_proof.equality.kernels import (
    CELL_LIMIT,
    H_LIMIT_Q30,
    Layers,
    LayerStep,
    TermArithmetic,
    compute_tanh,
    list_nodes,
)
from zerodrift_proof.equality.machine import (
    AddressOf,
    CellBlock,
    Found,
    Instance,
    Number,
    Spot,
    TermMachine,
)
from zerodrift_proof.equality.model import (
    FORMAT,
    Flag,
    Model,
)
from zerodrift_proof.equality.parser import parse_all
from zerodrift_proof.equality.reader import RefusedError, preprocess
from zerodrift_proof.equality.rules import (
    NORM_TESTED,
    TESTED_ALONE,
    Used,
    exact,
    make_elapsed_rules,
    make_rules,
    read_c_power,
    run_norm,
    say_span,
)
from zerodrift_proof.equality.specification import (
    CHECK,
    DRIFT,
    IDENTITY,
    SLEPT,
    STEPS,
    TARED,
    Outcome,
    Specification,
    State,
)
from zerodrift_proof.equality.syntax import TYPES, PNode, PProgram, PTypeName, PVariable
from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole

# What of the C is held against the specification by itself: header, checksum, the runtime's
# functions.
#
# What a model's header tells its user, held against the model: macros, and how functions are
# called.
#
# Each is compared as it is written, with its type, and nothing else may be defined.
#
# The checksum of a guarded state: its C takes every number of the state in, as documented.
#
# 32 bits turned by one to the right before each word is added: identity and steps, then the fields
# in the order of the struct, wide ones as two words, numbers of 16 bits two to a word at the end;
# fields of more than 512 numbers where they stand.
#
# Each is run over terms once for every piece of its domain on which it is one formula: tanh for
# each line of its table, 2^t and x^p for each octave, a recurrent step for any features and states.

SAVED_EXTRA_BYTES = 16
"""What a saved state has beside the state."""
MANIFEST = "manifest.json"
FAULTS = {"REPLAY": 1, "TABLES": 2}
"""What a self-test may return."""
UNSIGNED = ("MODEL_ID", "SAMPLE_PERIOD_US", "FLAG_", "FAULT_")
"""Macros that begin so, behind the prefix, are of uint32_t; other numbers are plain ones."""
UNTOLD = ("H", "CODE_ID")
"""Macros that say nothing of the model: against a second inclusion, and files of two
generations."""


def find_difference(model: Model, prefix: str, program: PProgram) -> str:
    """Return what a header says otherwise than the model; "" where all is the same.

    Args:
        model: the integer model.
        prefix: of the C's names.
        program: the C as it was read.
    """
    return _compare_macros(model, prefix, program) or _compare_functions(model, prefix, program)


def _list_expected(model: Model) -> dict[str, int | str]:
    """Return the names that an application reads -> what the model says of each."""
    told: dict[str, int | str] = {
        "FORMAT": FORMAT,
        "MODEL_HASH": model.hash,
        "MODEL_ID": model.identity,
        "MANIFEST": MANIFEST,
        "CHANNELS": len(model.channels),
        "OUTPUTS": len(model.outputs),
    }
    if model.sample_period_us is not None:
        told["SAMPLE_PERIOD_US"] = model.sample_period_us
    for index, (name, output) in enumerate(zip(model.output_names, model.outputs, strict=True)):
        told[name.upper()] = index
        told[f"{name.upper()}_LSB_PER_UNIT"] = output.lsb_per_unit
    absent = {
        Flag.INPUT_RANGE: not model.guards.ranges,
        Flag.NO_READING: not model.optional,
        Flag.TARED: not model.tare,
    }
    told |= {f"FLAG_{one.name}": int(one) for one in Flag if not absent.get(one, False)}
    return told | {f"FAULT_{name}": value for name, value in FAULTS.items()}


def _compare_macros(model: Model, prefix: str, program: PProgram) -> str:
    upper = f"{prefix.upper()}_"
    wanted = {
        f"{upper}{name}": _write(name, value) for name, value in _list_expected(model).items()
    }
    wanted[f"{upper}SAVED_BYTES"] = f"({SAVED_EXTRA_BYTES}u+sizeof({prefix}_state_t))"
    if model.forced:
        wanted[f"{upper}FORCED"] = "1"
    found = {
        name: "".join(words)
        for name, words in program.tokens.macros.items()
        if name.startswith(upper) and name.removeprefix(upper) not in UNTOLD
    }
    for name in (*wanted, *found):
        if found.get(name) != wanted.get(name):
            said = found.get(name, "not defined")
            return f"{name} is {said}; the model gives {wanted.get(name, 'no such name')}"
    return ""


def _write(name: str, value: int | str) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return f"UINT32_C({value})" if name.startswith(UNSIGNED) else str(value)


def _compare_functions(model: Model, prefix: str, program: PProgram) -> str:
    wanted = {f"{prefix}_{name}": told for name, told in _list_functions(model, prefix).items()}
    for name in (*wanted, *sorted(program.public)):
        found = program.declared.get(name) if name in program.public else None
        if found != wanted.get(name):
            said = found or "not declared"
            return f"{name} is {said}; the model gives {wanted.get(name, 'no such function')}"
        if name not in program.functions:
            return f"{name} is declared and not defined"
    return ""


def _list_functions(model: Model, prefix: str) -> dict[str, str]:
    """Return the functions of a header -> result and parameters, macros replaced."""
    state, given = f"{prefix}_state_t * s", f"const {prefix}_input_t * in"
    drift = f"int32_t drift [ {len(model.outputs)} ]"
    saved = f"uint8_t saved [ ( {SAVED_EXTRA_BYTES}u + sizeof ( {prefix}_state_t ) ) ]"
    found = {
        "init": f"void ( {state} )",
        "settle": f"void ( {state} , {given} )",
        "step": f"uint32_t ( {state} , {given} , {drift} )",
        "selftest": "uint32_t ( void )",
        "save": f"void ( const {state} , {saved} )",
        "restore": f"uint32_t ( {state} , const {saved} )",
    }
    if model.variable_step:
        found["step_after"] = f"uint32_t ( {state} , {given} , uint64_t elapsed_us , {drift} )"
        found["restore_after"] = f"uint32_t ( {state} , const {saved} , uint64_t age_us )"
    if model.tare:
        found |= dict.fromkeys(("tare", "untare"), f"void ( {state} )")
    return found


LONG = 512


def prove_checksum(machine: TermMachine, meaning: Specification, prefix: str) -> str:
    """Return where the C's checksum is another; "" where it is not."""
    terms = machine.terms
    instance = machine.make_instance(f"{prefix}_state_t", "s")
    state: dict[str, list[Whole]] = {}
    for field in meaning.fields:
        low, high = TYPES[field.type]
        mark = f"unsound s->{field.name}"
        state[field.name] = [terms.symbol(f"{mark}[{k}]", low, high) for k in range(field.count)]
        instance.fields[field.name].cells = list(state[field.name])
    found = machine.call(f"{prefix}_sum_up", [AddressOf(instance)])
    check = terms.constant(0)
    for number, word in enumerate(_list_words(terms, meaning, state)):
        check = word if number == 0 else _add(terms, check, word)
    return "" if isinstance(found, Number) and found.term is check else "another sum"


def _add(terms: Terms, check: Whole, word: Whole) -> Whole:
    turned = terms.add(terms.shift(check, 1), terms.modulo(terms.scale(check, 1 << 31), 32))
    return terms.modulo(terms.add(turned, word), 32)


def _list_words(
    terms: Terms, meaning: Specification, state: dict[str, list[Whole]]
) -> Iterator[Whole]:
    yield terms.modulo(state[IDENTITY][0], 32)
    yield state[STEPS][0]
    halves: list[Whole] = []
    for field in meaning.fields[2:-1]:
        cells = state[field.name]
        if "64" in field.type:
            for cell in cells:
                bits = terms.modulo(cell, 64)
                yield terms.modulo(bits, 32)
                yield terms.shift(bits, 32)
        elif "32" in field.type:
            yield from (terms.modulo(cell, 32) for cell in cells)
        elif len(cells) > LONG:
            length = field.sizes[-1]
            for row in range(0, len(cells), length):
                yield from _pair(terms, cells[row : row + length])
        else:
            halves += cells
    yield from _pair(terms, halves)


def _pair(terms: Terms, cells: Sequence[Whole]) -> Iterator[Whole]:
    for k in range(0, len(cells), 2):
        low = terms.modulo(cells[k], 16)
        if k + 1 < len(cells):
            high = terms.modulo(cells[k + 1], 16)
            yield terms.add(low, terms.scale(high, 1 << 16))
        else:
            yield low


LAST = 2**31


def prove_tanh(machine: TermMachine) -> str:
    """Return where the C's tanh is not the table of 4.1; "" where it is everywhere."""
    terms, nodes = machine.terms, list_nodes()
    edges = [(-LAST, -(2**19) - 1), (2**19, LAST - 1)]
    for low, high in edges:
        t = terms.symbol("t", low, high)
        if _call(machine, "zd_tanh_q30", [Number(t, "int32_t")]).exact != compute_tanh(low):
            return f"beyond {low} .. {high}"
    for i in range(512):
        first = (i << 11) - 2**19
        t = terms.symbol("t", first, first + 2047)
        f = terms.subtract(t, terms.constant(first))
        rise = nodes[i + 1] - nodes[i]
        wanted = terms.add(terms.constant(nodes[i] << 11), terms.scale(f, rise))
        if _call(machine, "zd_tanh_q30", [Number(t, "int32_t")]) is not wanted:
            return f"line {i}"
    return ""


def prove_exp2(machine: TermMachine, top: int, low: int, high: int) -> str:
    """Return where the C's 2^t is not 3.8."""
    terms, rule = machine.terms, TermArithmetic(machine.terms)
    for octave in range(low >> 24, (high >> 24) + 1):
        t = terms.symbol("t", octave << 24, ((octave + 1) << 24) - 1)
        given: list[Found] = [Number(t, "int32_t"), machine.constant(top)]
        if _call(machine, "zd_exp2", given) is not rule.exp2_in_octave(t, octave, top):
            return f"octave {octave}"
    return ""


def prove_power(machine: TermMachine, name: str, low: int, high: int) -> str:
    """Return where the C's x^p is not 3.9."""
    terms, rule = machine.terms, TermArithmetic(machine.terms)
    constants = machine.globals[name]
    if not isinstance(constants, Instance):
        return "no constants"
    _, power = read_c_power(AddressOf(constants))
    if low <= 0:
        x = terms.symbol("x", low, min(high, 0))
        if _call(machine, "zd_power", [AddressOf(constants), Number(x, "int32_t")]).exact != 0:
            return "x <= 0"
    for n in range(max(high, 1).bit_length()):
        if high < 1:
            break
        x = terms.symbol("x", 1 << n, min((2 << n) - 1, LAST - 1))
        found = _call(machine, "zd_power", [AddressOf(constants), Number(x, "int32_t")])
        if n >= len(power.gains) or found is not rule.power_in_octave(power, x, n):
            return f"octave {n}"
    return ""


def _call(machine: TermMachine, name: str, arguments: list[Found]) -> Whole:
    found = machine.call(name, arguments)
    if not isinstance(found, Number):
        raise UndecidedError(f"{name} gives no number")
    return found.term


def prove_layer(machine: TermMachine, layers: Layers, name: str, relaxing: bool) -> str:
    """Return where the C's step of a layer is not that of section 4, or of the LSTM."""
    layer, terms = layers.layers[name], machine.terms
    constants = machine.globals.get(name)
    if not isinstance(constants, Instance):
        return "no constants"
    ranges = layers.given[name, relaxing]
    x = [terms.symbol(f"x[{i}]", low, high) for i, (low, high) in enumerate(ranges)]
    h = [terms.symbol(f"h[{j}]", -H_LIMIT_Q30, H_LIMIT_Q30) for j in range(layer.hidden)]
    c: list[Whole] = []
    if layer.kind == "lstm":
        c = [terms.symbol(f"c[{j}]", -CELL_LIMIT, CELL_LIMIT) for j in range(layer.hidden)]
    features = CellBlock("x", "int16_t", (layer.inputs,), list(x))
    states = CellBlock("h", "int32_t", (layer.hidden,), list(h))
    cells = CellBlock("c", "int32_t", (layer.hidden,), list(c))
    arguments: list[Found] = [
        AddressOf(constants),
        machine.constant(layer.inputs, "uint32_t"),
        machine.constant(layer.hidden, "uint32_t"),
        _point(machine, features),
        _point(machine, states),
    ]
    if layer.kind == "lstm":
        arguments.append(_point(machine, cells))
    for k in range(2 if layer.kind == "gru before" else 1):
        scratch = CellBlock(f"scratch_{k}", "int16_t", (layer.hidden,), [None] * layer.hidden)
        arguments.append(_point(machine, scratch))
    if layer.kind == "lstm":
        arguments.append(machine.constant(int(relaxing), "uint32_t"))
    else:
        arguments.append(machine.constant(0 if relaxing else -1))
    function = {"gru": "zd_gru_step_after", "gru before": "zd_gru_step_before"}
    machine.call(function.get(layer.kind, "zd_lstm_step"), arguments)
    outputs, after = LayerStep(terms, layer).run(x, h, c, relaxing)
    for found, wanted, what in ((states, outputs, "h"), (cells, after, "c")):
        for j, term in enumerate(wanted):
            if found.cells[j] is not term:
                return f"{what}[{j}]"
    return ""


def _point(machine: TermMachine, block: CellBlock) -> Spot:
    return Spot(block, machine.terms.constant(0), block.sizes)


# One way to read the model's C, held against the specification, function by function.

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


class Proof:
    """One way to read the C, held against the specification."""

    def __init__(
        self,
        model: Model,
        texts: Mapping[str, str],
        prefix: str,
        build: str,
        defined: Mapping[str, str],
    ) -> None:
        """Read the C.

        Raises:
            RefusedError, UndecidedError: something without a rule.
        """
        self.model, self.prefix, self.build = model, prefix, build
        self.tokens = preprocess(texts, prefix, defined)
        self.program = parse_all(self.tokens, prefix)
        self.used = Used()
        self.sound: Callable[[TermMachine], Whole] | None = None
        rules = make_rules(prefix, lambda: self.meaning.layers, self.used)
        rules |= make_elapsed_rules()
        rules["zd_layer_norm"] = run_norm(self.used.norms.add)
        self.machine = TermMachine(self.program, rules)
        self.meaning = Specification(self.machine.terms, model)
        self.terms = self.machine.terms
        self.nodes: dict[str, str] = {}
        """Node -> why it differs; "" where it does not."""
        self.machine.watch[f"{prefix}_advance"] = {}

    # --- what is shown

    def is_own_text(self, other: "Proof") -> bool:
        """Return whether the model's files hold the same here as in another build."""
        return self._list_own() == other._list_own()

    def _list_own(self) -> list[object]:
        program = self.program
        files = (f"{self.prefix}.c:", f"{self.prefix}.h:")

        def is_own(at: int) -> bool:
            return program.place(at).startswith(files)

        functions = [
            (f.name, f.result, [shape_variable(v) for v in f.parameters], shape(f.body))
            for f in program.functions.values()
            if is_own(f.body.at)
        ]
        constants = [shape_variable(v) for v in program.constants if is_own(v.at)]
        structs = [(n, [shape_variable(v) for v in f]) for n, f in program.structs.items()]
        macros = [
            (n, m) for n, m in self.tokens.macros.items() if n.startswith(self.prefix.upper())
        ]
        return [functions, constants, structs, macros]

    def run(self, whole: bool = True) -> Iterator[ShownPart]:
        """Yield what is shown; of the same text of the model, what the runtime may change."""
        if whole:
            yield self._show("header", self._header)
            yield self._show("struct of the inputs", self._input_fields)
            yield self._show("struct of the state", self._state_fields)
        yield self._show("state_is_sound", self._soundness)
        rules = self.machine.rules
        if self.model.guarded:
            yield self._show(
                "sum_up", lambda: prove_checksum(self.machine, self.meaning, self.prefix)
            )
            rules[f"{self.prefix}_sum_up"] = self._sum_up
        rules[f"{self.prefix}_state_is_sound"] = self._answer_sound
        yield self._show("init", self._init)
        yield self._show("settle", self._settle)
        yield self._show("step, of a state that is not sound", lambda: self._step("unsound"))
        yield self._show("step, of a new state", lambda: self._step("new"))
        yield self._show("step", lambda: self._step("running"))
        if self.model.variable_step:
            yield from self._show_times()
        if self.model.tare:
            yield self._show("tare", lambda: self._tare("tare", 1, self.meaning.tare))
            yield self._show("untare", lambda: self._tare("untare", 2, self.meaning.untare))
        for node, why in self.nodes.items():
            yield self._judge(f"node {node}", why)
        if whole:
            yield self._show("save", self._save)
            yield self._show("restore", self._restore)
            if self.model.variable_step:
                yield self._show("restore_after", lambda: self._restore("restore_after"))
            del rules[f"{self.prefix}_state_is_sound"]
            yield self._show("selftest", self._selftest)
        yield from self._lemmas()

    def _judge(self, what: str, why: str) -> ShownPart:
        return ShownPart(what, self.build, OPEN if why else PROVEN, why)

    def _show(self, what: str, run: Callable[[], str]) -> ShownPart:
        try:
            return self._judge(what, run())
        except UNCHECKED as error:
            return self._judge(what, f"{self.machine.place}: {tell(error)}")

    def _show_times(self) -> Iterator[ShownPart]:
        """Yield what a variable step has more; `step` is one of the sample period."""
        for scenario, what in (
            ("unsound", "step_after, of a state that is not sound"),
            ("new", "step_after, of a new state"),
            ("running", "step_after"),
        ):
            yield self._show(what, partial(self._step, scenario, "step_after"))
        yield ShownPart("functions of a variable step", self.build, TESTED, TESTED_ALONE)

    def _lemmas(self) -> Iterator[ShownPart]:
        machine, used, layers = self.machine, self.used, self.meaning.layers
        if used.tanh or layers.layers:
            yield self._show("table of tanh, line by line", lambda: prove_tanh(machine))
        for top, exponents in used.exp2.items():
            yield self._show(f"2^t, top {top}", partial(prove_exp2, machine, top, *exponents))
        for name, ends in used.powers.items():
            yield self._show(f"x^p of {name}", partial(prove_power, machine, name, *ends))
        for name in sorted(used.norms):
            yield ShownPart(f"layer normalisation {name}", self.build, TESTED, NORM_TESTED)
        for name, relaxing in layers.given:
            what = f"{name}, {'towards rest' if relaxing else 'a step'}"
            yield self._show(what, partial(prove_layer, machine, layers, name, relaxing))

    # --- header and structs

    def _header(self) -> str:
        return find_difference(self.model, self.prefix, self.program)

    def _compare_fields(self, kind: str, wanted: list[tuple[str, str, tuple[int, ...]]]) -> str:
        """Compare names, types and sizes, in order: how a struct lies in memory."""
        fields = self.program.structs.get(f"{self.prefix}_{kind}_t", ())
        plain = all(f.type == PTypeName(f.type.name) for f in fields)
        found = [
            (f.name, f.type.name, tuple(exact(self.machine.evaluate(s)) for s in f.sizes))
            for f in fields
        ]
        return "" if found == wanted and plain else f"{found}; the model gives {wanted}"

    def _input_fields(self) -> str:
        kinds = [f"{channel.raw_type}_t" for channel in self.model.channels]
        names = zip(self.meaning.channels, kinds, strict=True)
        return self._compare_fields("input", [(name, kind, ()) for name, kind in names])

    def _state_fields(self) -> str:
        wanted = [(f.name, f.type, f.sizes) for f in self.meaning.fields]
        return self._compare_fields("state", wanted)

    # --- states and inputs

    def _any_state(self, scenario: str) -> State:
        """Return a state of any bits, a new one, or one that passes the test of a state."""
        state: State = {}
        for field in self.meaning.fields:
            low, high = TYPES[field.type]
            if scenario == "running":
                low = low if field.low is None else max(low, field.low)
                high = high if field.high is None else min(high, field.high)
                if field.name == "steps":
                    low = 1
            mark = f"{scenario} s->{field.name}"
            state[field.name] = [
                self.terms.symbol(f"{mark}[{k}]", low, high) for k in range(field.count)
            ]
        drift = self.model.drift
        if scenario == "running" and self.model.feeds_back:
            ends = zip(drift.low, drift.high, strict=True)
            state[DRIFT] = [
                self.terms.symbol(f"running s->drift[{k}]", a, b) for k, (a, b) in enumerate(ends)
            ]
        if scenario != "unsound":
            state[IDENTITY] = [self.terms.constant(self.model.identity)]
        if scenario == "new":
            state[STEPS] = [self.terms.constant(0)]
            if self.model.feeds_back:  # as init left it; nothing but a step writes it
                state[DRIFT] = [self.terms.constant(0)] * len(self.model.outputs)
        return state

    def _split_windows(self, state: State) -> Iterator[State]:
        """Yield the state for every place that the oldest features of its windows can have."""
        windows = [n.name for n in self.model.recurrents if not n.streams]
        sizes = {f.name: f.sizes[0] for f in self.meaning.fields if f.name.endswith("_window")}
        states = [state]
        for name in windows:
            states = [
                {**one, f"{name}_oldest": [self.terms.constant(k)]}
                for one in states
                for k in range(sizes[f"{name}_window"])
            ]
        yield from states

    def _as_instance(self, state: State | None) -> Instance:
        made = self.machine.make_instance(f"{self.prefix}_state_t", "s")
        for name, cells in (state or {}).items():
            made.fields[name].cells = list(cells)
        return made

    def _raw(self) -> list[Whole]:
        return [
            self.terms.symbol(f"in->{name}", channel.raw_least, channel.raw_most)
            for name, channel in zip(self.meaning.channels, self.model.channels, strict=True)
        ]

    def _as_input(self, raw: Sequence[Whole]) -> Instance:
        made = self.machine.make_instance(f"{self.prefix}_input_t", "in")
        for block, code in zip(made.fields.values(), raw, strict=True):
            block.cells, block.constant = [code], True
        return made

    def _compare(self, found: Instance, wanted: State) -> str:
        for name, block in found.fields.items():
            for k, cell in enumerate(block.cells):
                if cell is not wanted[name][k]:
                    where = f"s->{name}[{k}]" if block.sizes else f"s->{name}"
                    return f"{where} is another than the specification's"
        return ""

    def _answer_sound(self, machine: TermMachine, arguments: list[Found]) -> Found:
        state = arguments[0]
        if len(arguments) != 1 or not isinstance(state, AddressOf) or self.sound is None:
            raise UndecidedError("state_is_sound of something else")
        if state.of.type != f"{self.prefix}_state_t":
            raise UndecidedError("state_is_sound of something else")
        return Number(self.sound(machine), "uint32_t")

    def _sum_up(self, machine: TermMachine, arguments: list[Found]) -> Found:
        state = arguments[0]
        if not isinstance(state, AddressOf) or state.of.type != f"{self.prefix}_state_t":
            raise UndecidedError("sum_up of something else")
        return Number(self.meaning.checksum(self._read(state.of)), "uint32_t")

    def _read(self, instance: Instance) -> State:
        state: State = {}
        for name, block in instance.fields.items():
            cells = [c for c in block.cells if isinstance(c, Whole)]
            if len(cells) != len(block.cells) and name != "check":
                raise UndecidedError(f"s->{name} is read before it is written")
            state[name] = cells
        return state

    def _entry(self, name: str, *arguments: Found) -> Found:
        return self.machine.call(f"{self.prefix}_{name}", arguments)

    # --- functions

    def _soundness(self) -> str:
        state = self._any_state("unsound")
        wanted = self.meaning.is_sound(state)
        found: list[tuple[Mapping[int, int], Whole]] = []

        def run() -> None:
            answer = self._entry("state_is_sound", AddressOf(self._as_instance(state)))
            if not isinstance(answer, Number):
                raise UndecidedError("no number")
            found.append((dict(self.machine.path.assumed), answer.term))

        for _ in self.machine.explore(run):
            pass
        return self._join_paths(found, wanted, state)

    def _join_paths(
        self, found: list[tuple[Mapping[int, int], Whole]], wanted: Whole, state: State
    ) -> str:
        """A test that returns early: one path for steps = 0, one for others."""
        if len(found) == 1:
            return "" if found[0][1] is wanted else "another test than the specification's"
        new = self.terms.equal(state[STEPS][0], self.terms.constant(0))
        answers: dict[int, Whole] = {}
        for assumed, answer in found:
            if list(assumed) != [new.number]:
                return "it returns early for another reason than a new state"
            answers[assumed[new.number]] = answer
        joined = self.terms.choose(new, answers[1], answers[0])
        return "" if joined is wanted else "another test than the specification's"

    def _init(self) -> str:
        state = self._as_instance(None)
        for _ in self.machine.explore(lambda: self._ignore(self._entry("init", AddressOf(state)))):
            pass
        return self._compare(state, self.meaning.blank())

    def _ignore(self, found: Found) -> None:
        del found

    def _settle(self) -> str:
        raw = self._raw()
        state = self._as_instance(None)

        def run() -> None:
            for block in state.fields.values():
                block.cells = [None] * len(block.cells)
            self._entry("settle", AddressOf(state), AddressOf(self._as_input(raw)))

        codes = self.meaning.convert(raw)
        for _ in self.machine.explore(run):
            lacks = self.machine.decide(self.meaning.lacks(codes))
            if lacks.exact is None:
                return "settle does not ask whether there is a reading"
            wanted = self.meaning.blank() if lacks.exact else self.meaning.settle(codes)
            if why := self._compare(state, wanted):
                return why
        return ""

    def _step(self, scenario: str, entry: str = "step") -> str:
        state = self._any_state(scenario)
        self.sound = lambda machine: machine.terms.constant(int(scenario != "unsound"))
        ways = self._split_windows(state) if scenario == "running" else iter([state])
        for one in ways:
            if why := self._step_one(scenario, one, entry):
                return why
        return ""

    def _step_one(self, scenario: str, state: State, entry: str) -> str:
        raw, meaning, machine = self._raw(), self.meaning, self.machine
        elapsed = self._say_elapsed(entry)
        times = [Number(elapsed, "uint64_t")] if entry == "step_after" else []
        made: list[tuple[Instance, CellBlock, Found]] = []

        def run() -> None:
            drift = CellBlock("drift", "int32_t", (len(self.model.outputs),), [])
            drift.cells = [None] * len(self.model.outputs)
            instance = self._as_instance(state)
            place = Spot(drift, self.terms.constant(0), drift.sizes)
            own = AddressOf(instance), AddressOf(self._as_input(raw))
            flags = self._entry(entry, *own, *times, place)
            made.append((instance, drift, flags))

        codes = meaning.convert(raw)
        for _ in machine.explore(run):
            meaning.span = self.terms.constant(0)
            if scenario == "running" and self.model.variable_step:
                meaning.span = say_span(self.terms, state[SLEPT][0], elapsed)
            wanted = self._say_step(scenario, state, codes)
            meaning.span = self.terms.constant(0)
            instance, drift, flags = made.pop()
            if why := self._compare(instance, wanted.state):
                return why
            for k, cell in enumerate(drift.cells):
                if cell is not wanted.drift[k]:
                    return f"drift[{k}] is another than the specification's"
            if not isinstance(flags, Number) or flags.term is not wanted.flags:
                return "the flags are others than the specification's"
        return ""

    def _tare(self, entry: str, least: int, after: Callable[[State], State]) -> str:
        """Return where `tare` or `untare` of a sound state leaves another than it should."""
        state, machine, terms = self._any_state("running"), self.machine, self.terms
        made: list[Instance] = []

        def run() -> None:
            made.append(self._as_instance(state))
            self._entry(entry, AddressOf(made[-1]))

        for _ in machine.explore(run):
            asked = [terms.less(state[TARED][0], terms.constant(least))]
            if self.model.guarded:
                same = terms.equal(state[CHECK][0], self.meaning.checksum(state))
                asked.insert(0, terms.negate(same))
            wanted = after(state)
            for question in asked:
                decided = machine.decide(question).exact
                if decided is None:
                    return "it does not ask what it has to"
                if decided:
                    wanted = state
                    break
            if why := self._compare(made.pop(), wanted):
                return why
        return ""

    def _say_elapsed(self, entry: str) -> Whole:
        """Return the time that a step is told; `step` tells itself the sample period."""
        if entry == "step_after":
            return self.terms.symbol("elapsed_us", 0, 2**64 - 1)
        return self.terms.constant(self.model.period_us)

    def _say_step(self, scenario: str, state: State, codes: list[Whole]) -> Outcome:
        """Return what the specification says of the path that the machine has just gone."""
        meaning, machine = self.meaning, self.machine
        if scenario == "unsound":
            return meaning.damage()
        if self.model.guarded:
            same = self.terms.equal(state[CHECK][0], meaning.checksum(state))
            decided = machine.decide(same)
            if decided.exact is None:
                raise UndecidedError("the step does not compare the checksum")
            if not decided.exact:
                return meaning.damage()
        lacks = meaning.lacks(codes)
        if scenario == "new":
            if self.model.optional:
                lacks = machine.decide(lacks)
                if lacks.exact is None:
                    raise UndecidedError("the first step does not ask whether there is a reading")
                if lacks.exact:
                    return meaning.wait(state)
            begun = meaning.rest(state, codes, settled=False)
            if self.model.tare:
                begun[TARED] = [self.terms.constant(0)]
            return meaning.step(begun, codes, codes, lacks)[0]
        outcome, done = meaning.step(state, codes, meaning.hold(state, codes), lacks)
        self._compare_nodes(done.values)
        return outcome

    def _compare_nodes(self, values: Mapping[str, list[Whole]]) -> None:
        """Compare what the C's variables hold that are named after nodes."""
        found = self.machine.watch[f"{self.prefix}_advance"]
        for node in self.model.nodes[:-1]:
            wanted, copied = values[node.name], found.get(f"{node.name}_q15")
            holder = found.get(node.name) or copied
            if not isinstance(holder, CellBlock):
                self.nodes.setdefault(node.name, "no variable of its name in the C")
                continue
            if holder is copied:
                wanted = [self.meaning.round_shift(one, 15) for one in wanted]
            same = len(holder.cells) == len(wanted) and all(
                cell is term for cell, term in zip(holder.cells, wanted, strict=False)
            )
            below = [n for n in node.inputs if self.nodes.get(n)]
            if same:
                self.nodes.setdefault(node.name, "")
            elif below:
                self.nodes[node.name] = f"it reads {below[0]}, which is not proven"
            else:
                self.nodes[node.name] = "computes something else than the specification"

    def _save(self) -> str:
        self.used.saved.clear()
        state = self._as_instance(self._any_state("unsound"))
        saved = self._saved()
        for _ in self.machine.explore(
            lambda: self._ignore(self._entry("save", AddressOf(state), saved))
        ):
            pass
        if self.used.saved != [(f"{self.model.identity}", True)]:
            return "save does not copy the state once, as this model's"
        return self._compare(state, self._any_state("unsound"))

    def _saved(self) -> Spot:
        block = CellBlock("saved", "uint8_t", (1 << 30,), [None])
        return Spot(block, self.terms.constant(0), block.sizes)

    def _restore(self, entry: str = "restore") -> str:
        """Refused or not sound: as after init, and 1. Otherwise the copy's bits, and 0.

        With an age, that is added to the time slept, unless the copy is of a new state.
        """
        machine, terms = self.machine, self.terms
        before = self._any_state("unsound")
        answers: list[int] = []

        def answer(machine: TermMachine) -> Whole:
            answers.append(1 - machine.fork(2))
            return machine.terms.constant(answers[-1])

        self.sound = answer
        made: list[tuple[Instance, Found]] = []

        def run() -> None:
            answers.clear()
            self.used.saved.clear()
            machine.forking = True
            instance = self._as_instance(before)
            age = [Number(terms.symbol("age_us", 0, 2**64 - 1), "uint64_t")]
            times = age if entry == "restore_after" else []
            found = self._entry(entry, AddressOf(instance), self._saved(), *times)
            made.append((instance, found))

        paths = 0
        for _ in machine.explore(run):
            instance, found = made.pop()
            paths += 1
            if self.used.saved != [(f"{self.model.identity}", True)]:
                return "restore does not read the copy once, as this model's"
            copy = {
                f.name: [
                    terms.symbol(f"restored {f.name}[{k}]", *TYPES[f.type]) for k in range(f.count)
                ]
                for f in self.meaning.fields
            }
            refused = self.used.restored == 1
            if not refused and not answers:
                return "restore does not ask whether the state is sound"
            sound = not refused and answers == [1]
            if sound and self.model.guarded:
                same = terms.equal(copy[CHECK][0], self.meaning.checksum(copy))
                decided = machine.decide(same).exact
                if decided is None:
                    return "restore does not compare the checksum"
                sound = decided == 1
            if sound and entry == "restore_after":
                copy = self._age(copy)
            wanted = copy if sound else self.meaning.blank()
            if why := self._compare(instance, wanted):
                return why
            code = found.term.exact if isinstance(found, Number) else None
            if code != int(not sound):
                return f"restore returns {code} where {int(not sound)} was expected"
        machine.forking = False
        return "" if paths > 2 else "restore does not try to restore"

    def _age(self, copy: State) -> State:
        """Return a copy's state as it is restored some time later."""
        new = self.machine.decide(self.terms.equal(copy[STEPS][0], self.terms.constant(0)))
        if new.exact is None:
            raise UndecidedError("restore_after does not ask whether the state is new")
        if new.exact:
            return copy
        age = self.terms.symbol("age_us", 0, 2**64 - 1)
        copy = {**copy, SLEPT: [say_span(self.terms, copy[SLEPT][0], age)]}
        return {**copy, CHECK: [self.meaning.checksum(copy)]} if self.model.guarded else copy

    def _selftest(self) -> str:
        """It replays known inputs: with these tables it answers 0."""
        found: list[Found] = []
        for _ in self.machine.explore(lambda: found.append(self._entry("selftest"))):
            pass
        if len(found) != 1 or not isinstance(found[0], Number) or found[0].term.exact != 0:
            return "it does not answer 0"
        return ""
