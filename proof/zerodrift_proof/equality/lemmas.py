"""The runtime's own functions: their C is what the specification says, for every argument.

Each is run over terms once for every piece of its domain on which it is one formula: tanh for each
line of its table, 2^t and x^p for each octave, a recurrent step for any features and states.
"""

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
from zerodrift_proof.equality.memory import (
    AddressOf,
    CellBlock,
    Found,
    Instance,
    Number,
    Spot,
)
from zerodrift_proof.equality.rules import read_c_power
from zerodrift_proof.equality.terms import UndecidedError, Whole

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
