"""The assembly of recurrent layers: the one text that is known for a layer of some shape.

There are no rules for instructions. What is known is what the emulated cores have been compared
with, bit for bit; it is stated here a second time, and anything else is refused. Shares no code
with the generator and needs the standard library only.
"""

from collections.abc import Callable, Mapping, Sequence

from zerodrift_proof.certificate import armv6m as c_armv6m
from zerodrift_proof.certificate import armv7em as c_armv7em
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.preprocessor import NAMES_OF_TABLES
from zerodrift_proof.certificate.recurrent import (
    BEFORE,
    BYTES,
    PAIRS,
    GruStep,
    LstmStep,
    run_packed,
    step_lstm,
)
from zerodrift_proof.certificate.values import (
    FaultError,
    Found,
    NotUnderstoodError,
    Pointer,
    Struct,
    Value,
    make_block,
)

MOST_INPUTS, MOST_UNITS = 32, 128


LINKED = (
    "zd_tanh_offset_q30",
    "zd_tanh_slope_q19",
    "zd_tanh_half_offset_q30",
    "zd_tanh_half_slope_q19",
    "zd_sigmoid_offset_q31",
)
NAMES = dict(zip(NAMES_OF_TABLES, LINKED, strict=True))
"""Macros of the runtime: what a table is called where the linker sees it."""


Text = tuple[Mapping[str, int], Mapping[str, tuple[str, ...]]]
"""What a build defines, and its functions of assembly."""


def run_assembly(
    machine: IntervalMachine, name: str, given: Sequence[Found], texts: list[Text]
) -> None:
    """Step a layer by a function of assembly, which must be the text that is known for its shape.

    Args:
        machine: stands at the call.
        name: of the function.
        given: stream, state, features, and what its kind takes besides.
        texts: of every build for which the machine stands.

    Raises:
        NotUnderstoodError: another text, or more than assembly is written for.
        FaultError: arguments of other types, or another layer's.
    """
    own = name.removesuffix("_assembly")
    layer = machine.constants.get(own) or machine.variables.get(own)
    if not isinstance(layer, Struct) or layer.type not in KINDS:
        raise NotUnderstoodError(f"{name} belongs to no layer")
    rows = [p for p in given[:3] if isinstance(p, Pointer) and len(p.sizes) == 1]
    if len(rows) != 3:
        raise FaultError(f"{name} is given no arrays")
    stream, h, x = rows
    if stream != layer.tables["stream"] or h.constant or h.block.constant:
        raise FaultError(f"{name} is given other weights than its layer's, or a constant state")
    if (h.block.type, x.block.type) != ("int32_t", "int16_t"):
        raise FaultError(f"{name} is given other types than int32_t and int16_t")
    inputs, hidden = x.sizes[0], h.sizes[0]
    most = MOST_UNITS // 2 if layer.type == "zd_gru_before_t" else MOST_UNITS
    if inputs > MOST_INPUTS or hidden > most:
        raise NotUnderstoodError(f"{name}: no assembly is known for {inputs} and {hidden}")
    for defined, assembly in texts:
        _require_known(name, layer, inputs, hidden, defined, assembly.get(name, ()))
    KINDS[layer.type](machine, layer, (x, h), given[3:])


def _step_gru(
    machine: IntervalMachine, layer: Struct, arrays: tuple[Pointer, Pointer], given: Sequence[Found]
) -> None:
    x, h = arrays
    if len(given) != 1:
        raise FaultError(f"{layer.name}: its assembly takes four arguments")
    inputs, hidden = x.sizes[0], h.sizes[0]
    scratch = make_block("scratch", "int32_t", [2 * (inputs + hidden + 2)], None)
    counts = (Value(inputs, inputs), Value(hidden, hidden))
    scratches = (Pointer(scratch, Value(0, 0), scratch.sizes),)
    u_keep = machine.as_number(given[0])
    step = GruStep(*counts, x, h, scratches, u_keep)
    run_packed(machine, PACKINGS[layer.type], layer, step)


PACKINGS = {"zd_gru_pairs_t": PAIRS, "zd_gru_before_t": BEFORE, "zd_gru_bytes_t": BYTES}
"""Struct of a GRU's constants -> how its stream is read."""


def _step_lstm(
    machine: IntervalMachine, layer: Struct, arrays: tuple[Pointer, Pointer], given: Sequence[Found]
) -> None:
    x, h = arrays
    cell = given[0] if len(given) == 2 else None
    if not isinstance(cell, Pointer) or len(cell.sizes) != 1 or cell.constant:
        raise FaultError(f"{layer.name}: its assembly is given no cell state")
    if cell.block.type != "int32_t" or cell.sizes != h.sizes:
        raise FaultError(f"{layer.name}: its assembly is given a cell state of another form")
    step_lstm(machine, layer, LstmStep(x, h, cell, machine.as_number(given[1])))


KINDS: dict[
    str,
    Callable[[IntervalMachine, Struct, tuple[Pointer, Pointer], Sequence[Found]], None],
] = {
    **dict.fromkeys(PACKINGS, _step_gru),
    **dict.fromkeys(("zd_lstm_pairs_t", "zd_lstm_bytes_t"), _step_lstm),
}
"""Struct of a layer's constants -> its step."""


def _require_known(
    name: str,
    layer: Struct,
    inputs: int,
    hidden: int,
    defined: Mapping[str, int],
    written: tuple[str, ...],
) -> None:
    """Raise NotUnderstoodError unless the function is the text that is known for its shape."""
    field = layer.fields["shift"]
    shifts = [field.value(g).low for g in range(field.count)]
    small, core = "ZD_SMALL" in defined, defined.get("ZD_ASSEMBLY", defined.get("ZD_GRU_ASSEMBLY"))
    known_shape = c_armv7em.LayerShape(
        name, inputs, hidden, shifts, small, "ZD_UNALIGNED" in defined
    )
    if (layer.type, core) == ("zd_gru_pairs_t", 6):
        found = c_armv6m.write_gru(name, inputs, hidden, shifts, small)
    elif (layer.type, core) == ("zd_gru_pairs_t", 7):
        found = c_armv7em.write_gru(known_shape)
    elif (layer.type, core) == ("zd_gru_before_t", 6):
        found = c_armv6m.write_gru_before(name, inputs, hidden, shifts, small)
    elif (layer.type, core) == ("zd_gru_before_t", 7):
        found = c_armv7em.write_gru_before(known_shape)
    elif (layer.type, core) == ("zd_gru_bytes_t", 7):
        scales = [layer.fields["multiplier_shift"].value(g).low for g in range(3)]
        found = c_armv7em.write_gru_of_bytes(known_shape, scales)
    elif (layer.type, core) == ("zd_lstm_pairs_t", 6):
        bits = layer.fields["cell_bits"].value(0).low
        found = c_armv6m.write_lstm(name, (inputs, hidden), shifts, bits, small)
    elif (layer.type, core) == ("zd_lstm_pairs_t", 7):
        bits = layer.fields["cell_bits"].value(0).low
        found = c_armv7em.write_lstm(known_shape, bits)
    elif (layer.type, core) == ("zd_lstm_bytes_t", 7):
        bits = layer.fields["cell_bits"].value(0).low
        scales = [layer.fields["multiplier_shift"].value(g).low for g in range(4)]
        found = c_armv7em.write_lstm_of_bytes(known_shape, bits, scales)
    else:
        raise NotUnderstoodError(f"{name}: no assembly of {core} is known for {layer.type}")
    lines = list(found)
    text = "".join(NAMES.get(word, "") if word[0] != '"' else word[1:-1] for word in written)
    known = "".join(f"{line}\\n" for line in lines)
    if text != known:
        pairs = zip(text.split("\\n"), [*lines, ""], strict=False)
        differs = next((f"'{a}' where '{b}' is known" for a, b in pairs if a != b), "too short")
        raise NotUnderstoodError(f"{name}: its assembly is another: {differs}")
