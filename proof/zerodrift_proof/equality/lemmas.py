"""What of the C is held against the specification by itself: header, checksum, the runtime's
functions.

What a model's header tells its user, held against the model: macros, and how functions are called.

Each is compared as it is written, with its type, and nothing else may be defined.

The checksum of a guarded state: its C takes every number of the state in, as documented.

32 bits turned by one to the right before each word is added: identity and steps, then the fields in
the order of the struct, wide ones as two words, numbers of 16 bits two to a word at the end; fields
of more than 512 numbers where they stand.

Each is run over terms once for every piece of its domain on which it is one formula: tanh for each
line of its table, 2^t and x^p for each octave, a recurrent step for any features and states.
"""

from collections.abc import Iterator, Sequence

from zerodrift_proof.equality.kernels import (
    CELL_LIMIT,
    H_LIMIT_Q30,
    Layers,
    LayerStep,
    TermArithmetic,
    compute_tanh,
    list_nodes,
)
from zerodrift_proof.equality.machine import TermMachine
from zerodrift_proof.equality.memory import AddressOf, CellBlock, Found, Instance, Number, Spot
from zerodrift_proof.equality.model import (
    FORMAT,
    Flag,
    Model,
)
from zerodrift_proof.equality.rules import read_c_power
from zerodrift_proof.equality.specification import IDENTITY, STEPS, Specification
from zerodrift_proof.equality.syntax import TYPES, PProgram
from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole

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
