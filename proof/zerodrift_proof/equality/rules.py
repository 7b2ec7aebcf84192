"""What functions do that are not run when C is run over terms, and the order of kernels' numbers.

The order in which each kernel reads a recurrent layer's numbers, laid out from the model.

Written from docs/reference/kernels.md and the comments above the kernels' structs in the runtime.
Two neighbours of 16 bits are a pair, one signed word, the first one low; a word of four weights of
8 bits holds the first, third, second and fourth, the first one low. What is missing to a whole pair
or vector is zero.

`zd_tanh_q30`, `zd_exp2`, `zd_power` and the recurrent kernels stand for themselves; that their C is
what the specification says is shown in `build`. CRC, save and restore are taken as they are
documented; the runtime's text is known by its hash.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from math import isqrt
from typing import TypeAlias

from zerodrift_proof.equality.kernels import (
    TANH,
    Layers,
    Numbered,
    Power,
    TermArithmetic,
    find_exp2,
    find_power,
)
from zerodrift_proof.equality.machine import (
    AddressOf,
    Found,
    Instance,
    Number,
    Rule,
    Spot,
    TermMachine,
    refuse_other_type,
)
from zerodrift_proof.equality.syntax import TYPES
from zerodrift_proof.equality.terms import Opaque, Terms, UndecidedError, Whole

Tables = tuple[list[int], ...]
"""As the kernel's struct has them, in the order of its fields."""
EIGHT, FOUR = 8, 4
"""Numbers of 16 bits, and units, that MVE takes at once; the columns kernel takes eight units."""


def _sign(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word


def _pair(row: Sequence[int]) -> list[int]:
    filled = [*row, *[0] * (len(row) % 2)]
    return [
        _sign(filled[k] & 0xFFFF | (filled[k + 1] & 0xFFFF) << 16)
        for k in range(0, len(filled), 2)
    ]  # fmt: skip


def _four(row: Sequence[int]) -> list[int]:
    filled = [*row, *[0] * (-len(row) % 4)]
    words = []
    for k in range(0, len(filled), 4):
        first, second, third, fourth = (n & 0xFF for n in filled[k : k + 4])
        words.append(_sign(first | third << 8 | second << 16 | fourth << 24))
    return words


def _rows_of(layer: Numbered, unit: int, of_state: bool) -> list[tuple[int, ...]]:
    """Return a unit's rows, gate by gate."""
    rows = layer.w_h if of_state else layer.w_x
    return list(rows[unit * layer.gates : (unit + 1) * layer.gates])


def _biases(layer: Numbered, unit: int) -> list[int]:
    return list(layer.bias[4 * unit : 4 * unit + 4])


def _multipliers(layer: Numbered, unit: int) -> list[int]:
    return list(layer.multiplier[layer.gates * unit : layer.gates * (unit + 1)])


def _blocks(rows: Sequence[Sequence[int]]) -> Iterator[int]:
    """Yield blocks of two pairs, gate by gate, the last one of one pair where they are odd."""
    words = [_pair(row) for row in rows]
    for first in range(0, len(words[0]), 2):
        for gate in words:
            yield from gate[first : first + 2]


def pack_pairs(layer: Numbered) -> Tables:
    """Return the stream of pairs: biases, blocks of features, blocks of the state, unit by unit."""
    stream: list[int] = []
    for unit in range(layer.hidden):
        stream += _biases(layer, unit)
        for of_state in (False, True):
            stream += _blocks(_rows_of(layer, unit, of_state))
    return (stream,)


def pack_before(layer: Numbered) -> Tables:
    """Return the stream of a reset before the product: r and u of all units, then n of all."""
    stream: list[int] = []
    for gates in (slice(0, 2), slice(2, 3)):
        for unit in range(layer.hidden):
            stream += _biases(layer, unit)[gates]
            for of_state in (False, True):
                stream += _blocks(_rows_of(layer, unit, of_state)[gates])
    return (stream,)


def _interleave(rows: Sequence[Sequence[int]]) -> list[int]:
    """Return the words of four weights, for each four those of all gates."""
    return list(chain.from_iterable(zip(*(_four(row) for row in rows), strict=True)))


def pack_bytes(layer: Numbered) -> Tables:
    """Return a GRU's stream with recurrent weights of 8 bits.

    Unit by unit: three biases, blocks of features, the fours of the state, the bias inside the
    reset, the multipliers.
    """
    stream: list[int] = []
    for unit in range(layer.hidden):
        bias = _biases(layer, unit)
        stream += [*bias[:3], *_blocks(_rows_of(layer, unit, False))]
        stream += [*_interleave(_rows_of(layer, unit, True)), bias[3], *_multipliers(layer, unit)]
    return (stream,)


def pack_lstm_bytes(layer: Numbered) -> Tables:
    """Return an LSTM's: the fours of the output, biases, multipliers, blocks of features."""
    stream: list[int] = []
    for unit in range(layer.hidden):
        stream += [*_interleave(_rows_of(layer, unit, True)), *_biases(layer, unit)]
        stream += [*_multipliers(layer, unit), *_blocks(_rows_of(layer, unit, False))]
    return (stream,)


def pack_columns(layer: Numbered) -> Tables:
    """Return eight units side by side: the four biases, then each pair of features gate by gate,
    then the same of the state; units beyond the last are zeros."""
    stream: list[int] = []
    for first in range(0, layer.hidden, EIGHT):
        units = range(first, first + EIGHT)
        stream += [_biases(layer, u)[k] if u < layer.hidden else 0 for k in range(4) for u in units]
        for of_state in (False, True):
            wide = [
                [_pair(row) for row in _rows_of(layer, u, of_state)] if u < layer.hidden else None
                for u in units
            ]
            for pair in range(-(-(layer.hidden if of_state else layer.inputs) // 2)):
                for gate in range(layer.gates):
                    stream += [rows[gate][pair] if rows else 0 for rows in wide]
    return (stream,)


def pack_rows(layer: Numbered) -> Tables:
    """Return weights, recurrent ones of 8 bits, biases and multipliers in whole vectors."""
    return _pack_rows(layer, (slice(0, layer.gates),))


def pack_rows_before(layer: Numbered) -> Tables:
    """The same with the reset before the product: weights of r and u of all units, then of n."""
    return _pack_rows(layer, (slice(0, 2), slice(2, 3)))


def _pack_rows(layer: Numbered, passes: Sequence[slice]) -> Tables:
    units = range(-(-layer.hidden // FOUR) * FOUR)
    scaled = bool(layer.multiplier)

    def fill(row: Sequence[int]) -> list[int]:
        return [*row, *[0] * (-len(row) % EIGHT)]

    def lay(of_state: Sequence[bool]) -> list[int]:
        table: list[int] = []
        for gates in passes:
            for unit in units:
                parts = [_rows_of(layer, min(unit, layer.hidden - 1), one) for one in of_state]
                for several in zip(*(part[gates] for part in parts), strict=True):
                    row = [n for one in several for n in fill(one)]
                    table += row if unit < layer.hidden else [0] * len(row)
        return table

    def spread(numbers: Callable[[Numbered, int], list[int]]) -> list[int]:
        table: list[int] = []
        for first in range(0, layer.hidden, FOUR):
            several = [
                numbers(layer, u) if u < layer.hidden else [0] * len(numbers(layer, 0))
                for u in range(first, first + FOUR)
            ]
            table += chain.from_iterable(zip(*several, strict=True))
        return table

    weights = lay((False,) if scaled else (False, True))
    small = lay((True,)) if scaled else []
    return weights, small, spread(_biases), spread(_multipliers) if scaled else []


def pack_assembly(layer: Numbered) -> Tables:
    """Return the stream of a layer in assembly, which its kind and its weights tell."""
    if layer.multiplier:
        return pack_lstm_bytes(layer) if layer.kind == "lstm" else pack_bytes(layer)
    return pack_before(layer) if layer.kind == "gru before" else pack_pairs(layer)


SHIFT = "shift"
ASSEMBLY: dict[str, Callable[[Numbered], Tables]] = {
    "zd_gru_pairs_t": pack_pairs,
    "zd_gru_before_t": pack_before,
    "zd_gru_bytes_t": pack_bytes,
    "zd_lstm_pairs_t": pack_pairs,
    "zd_lstm_bytes_t": pack_lstm_bytes,
}
"""Constants of a layer in assembly -> the order of its table."""


@dataclass
class Used:
    """What was taken to be as the specification says, and has to be shown."""

    tanh: bool = False
    exp2: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Top -> the widest range of the exponent."""
    powers: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Constant -> the widest range of x."""
    norms: set[str] = field(default_factory=set)
    """Layer normalisations."""
    saved: list[tuple[str, bool]] = field(default_factory=list)
    restored: int = 0


def make_rules(prefix: str, layers: Callable[[], Layers], used: Used) -> dict[str, Rule]:
    """Return the rules of a model's functions.

    Args:
        prefix: of the model.
        layers: its recurrent layers, once there are terms.
        used: is told what has to be shown.
    """
    rules: dict[str, Rule] = {
        "zd_tanh_q30": lambda m, a: _tanh(m, a, used),
        "zd_exp2": lambda m, a: _exp2(m, a, used),
        "zd_power": lambda m, a: _power(m, a, used),
        "zd_gru_step_after": lambda m, a: _gru(m, a, layers(), "gru"),
        "zd_gru_step_before": lambda m, a: _gru(m, a, layers(), "gru before"),
        "zd_lstm_step": lambda m, a: _lstm(m, a, layers()),
        "zd_crc32_i16": partial(_crc, "int16_t"),
        "zd_crc32_i32": partial(_crc, "int32_t"),
        "zd_crc32_word": _crc_word,
        "zd_save": lambda m, a: _save(m, a, prefix, used),
        "zd_restore": lambda m, a: _restore(m, a, prefix, used),
        "ZD_PAIR_SCRATCH": lambda m, a: _size(m, scratch_of_pairs(*map(exact, a))[0][1]),
        "ZD_ROW_VECTORS": lambda m, a: _size(m, -(-exact(a[0]) // 8)),
        "ZD_ROW_UNITS": lambda m, a: _size(m, -(-exact(a[0]) // 4) * 4),
        "ZD_COLUMN_UNITS": lambda m, a: _size(m, -(-exact(a[0]) // 8) * 8),
        "ZD_COLUMN_PAIRS": lambda m, a: _size(m, scratch_of_columns(*map(exact, a))[1][1]),
    }
    of_rows = ("weights", "bytes", "bias", "multiplier")
    packed = {
        "zd_gru_step_pairs": Packed("gru", ("stream",), pack_pairs, scratch_of_pairs),
        "zd_gru_step_columns": Packed("gru", ("stream",), pack_columns, scratch_of_columns),
        "zd_gru_step_rows": Packed("gru", of_rows, pack_rows, scratch_of_rows),
        "zd_gru_step_rows_before": Packed(
            "gru before", of_rows, pack_rows_before, scratch_of_rows_before
        ),
        "zd_lstm_step_rows": Packed("lstm", of_rows, pack_rows, scratch_of_rows),
    }
    for name, kernel in packed.items():
        rules[name] = _make_packed(layers, kernel)
    return rules


Arrays: TypeAlias = list[tuple[str, int]]
"""Of each scratch array of a kernel its type, and how many numbers it must have."""
Scratch: TypeAlias = Callable[[int, int], Arrays]
"""From inputs and units."""


@dataclass(frozen=True)
class Packed:
    """A kernel of intrinsics, which has the weights in another order."""

    kind: str
    """Of its layers: gru | gru before | lstm."""
    tables: tuple[str, ...]
    """Fields of its constants."""
    pack: Callable[[Numbered], Tables]
    """From a layer to the tables."""
    scratch: Scratch


def scratch_of_pairs(inputs: int, hidden: int) -> Arrays:
    """Return what the kernel of pairs needs where a pair takes two words."""
    return [("int32_t", 2 * (-(-inputs // 2) - (-hidden // 2)))]


def scratch_of_rows(inputs: int, hidden: int) -> Arrays:
    """Return what the kernel of rows needs."""
    return [("int16_t", 8 * (-(-inputs // 8) - (-hidden // 8)))]


def scratch_of_rows_before(inputs: int, hidden: int) -> Arrays:
    """Return what the same needs with the reset before the product."""
    ((kind, count),) = scratch_of_rows(inputs, hidden)
    return [(kind, 2 * count), ("int32_t", -(-hidden // 4) * 4)]


def scratch_of_columns(inputs: int, hidden: int) -> Arrays:
    """Return what the kernel of columns needs."""
    units = -(-hidden // 8)
    return [("int32_t", 8 * units), ("int32_t", -(-inputs // 2) + 4 * units)]


def _size(machine: TermMachine, count: int) -> Number:
    return machine.constant(count, "uint32_t")


def as_number(found: Found) -> Number:
    """Return an argument that is a number."""
    if not isinstance(found, Number):
        raise UndecidedError("an argument that is no number")
    return found


def as_place(found: Found, kind: str) -> Spot:
    """Return an argument that points to numbers of a type."""
    if not isinstance(found, Spot) or found.block.type != kind:
        raise UndecidedError(f"an argument that does not point to {kind}")
    return found


def exact(found: Found) -> int:
    """Return an argument that is a known number."""
    value = as_number(found).term.exact
    if value is None:
        raise UndecidedError("an argument that is not known")
    return value


def _widen(into: dict[int, tuple[int, int]], key: int, term: Whole) -> None:
    low, high = into.get(key, (term.low, term.high))
    into[key] = min(low, term.low), max(high, term.high)


def _tanh(machine: TermMachine, arguments: list[Found], used: Used) -> Found:
    used.tanh = True
    t = machine.convert(as_number(arguments[0]), "int32_t").term
    return Number(machine.terms.call(TANH, [t]), "int32_t")


def _exp2(machine: TermMachine, arguments: list[Found], used: Used) -> Found:
    t = machine.convert(as_number(arguments[0]), "int32_t").term
    top = exact(arguments[1])
    if t.high >> 24 > top:
        raise UndecidedError("an exponent above its top")
    _widen(used.exp2, top, t)
    return Number(machine.terms.call(find_exp2(machine.terms, top), [t]), "int32_t")


def read_c_power(address: Found) -> tuple[str, Power]:
    """Return the name and the numbers of a power's constants."""
    if not isinstance(address, AddressOf) or address.of.type != "zd_power_t":
        raise UndecidedError("no constants of a power")
    fields = address.of.fields

    def numbers(cells: Sequence[object]) -> tuple[int, ...]:
        found = [c.exact for c in cells if isinstance(c, Whole)]
        values = tuple(n for n in found if n is not None)
        if len(values) != len(cells):
            raise UndecidedError("constants of a power that are not known")
        return values

    def table(name: str) -> tuple[int, ...]:
        place = fields[name].cells[0]
        if not isinstance(place, Spot) or place.at.exact != 0:
            raise UndecidedError("a table of a power that is not there")
        return numbers(place.block.cells)

    low, high, terms, shift = (
        numbers(fields[n].cells)[0] for n in ("low", "high", "terms", "shift")
    )
    octave = table("octave")
    if not 0 < terms <= len(octave):
        raise UndecidedError(f"{terms} terms of {len(octave)}")
    return address.of.name, Power(octave[:terms], table("gains"), low, high, shift)


def _power(machine: TermMachine, arguments: list[Found], used: Used) -> Found:
    name, power = read_c_power(arguments[0])
    x = machine.convert(as_number(arguments[1]), "int32_t").term
    low, high = used.powers.get(name, (x.low, x.high))
    used.powers[name] = min(low, x.low), max(high, x.high)
    known = find_power(machine.terms, name.removesuffix("_p"), power)
    return Number(machine.terms.call(known, [x]), "int32_t")


def _gru(machine: TermMachine, arguments: list[Found], layers: Layers, kind: str) -> Found:
    address, inputs, hidden, x, h, *scratches, keep = arguments
    layer = _find_layer(address, layers, kind, exact(inputs), exact(hidden))
    if exact(keep) not in (0, -1):
        raise UndecidedError("u_keep is neither 0 nor -1")
    _step(machine, layers, layer, as_place(x, "int16_t"), as_place(h, "int32_t"), exact(keep) == 0)
    _forget(machine, scratches, [("int16_t", layer.hidden)] * len(scratches), [x, h])
    return None


def _lstm(machine: TermMachine, arguments: list[Found], layers: Layers) -> Found:
    address, inputs, hidden, x, h, cell, scratch, relaxing = arguments
    layer = _find_layer(address, layers, "lstm", exact(inputs), exact(hidden))
    if exact(relaxing) not in (0, 1):
        raise UndecidedError("relaxing is neither 0 nor 1")
    places = as_place(x, "int16_t"), as_place(h, "int32_t"), as_place(cell, "int32_t")
    _step(machine, layers, layer, *places[:2], exact(relaxing) == 1, places[2])
    _forget(machine, [scratch], [("int16_t", layer.hidden)], places)
    return None


def _find_layer(address: Found, layers: Layers, kind: str, inputs: int, hidden: int) -> Numbered:
    if not isinstance(address, AddressOf) or address.of.name not in layers.layers:
        raise UndecidedError("a layer that the model does not have")
    layer = layers.layers[address.of.name]
    if (layer.kind, layer.inputs, layer.hidden) != (kind, inputs, hidden):
        raise UndecidedError(f"{layer.name} is stepped as another layer")
    return layer


def _step(
    machine: TermMachine,
    layers: Layers,
    layer: Numbered,
    x: Spot,
    h: Spot,
    relaxing: bool,
    c: Spot | None = None,
) -> None:
    """Step a layer as the specification says; its states must be within what is proven."""
    from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30

    hidden = layer.hidden
    given, states = machine.cells(x, layer.inputs), machine.cells(h, hidden)
    cells = machine.cells(c, hidden) if c is not None else []
    for term, limit in [(t, H_LIMIT_Q30) for t in states] + [(t, CELL_LIMIT) for t in cells]:
        if term.low < -limit or term.high > limit:
            raise UndecidedError(f"{layer.name} is stepped from a state beyond {limit}")
    outputs, after = layers.step(layer.name, given, states, cells, relaxing)
    _put(machine, h, outputs)
    if c is not None:
        _put(machine, c, after)


def _put(machine: TermMachine, place: Spot, values: Sequence[Whole]) -> None:
    first = place.at.exact
    if first is None or first + len(values) > len(place.block.cells):
        raise UndecidedError(f"where in {place.block.name} is written")
    for k, value in enumerate(values):
        machine.write(place.block, first + k, value)


def _forget(
    machine: TermMachine, given: Sequence[Found], wanted: Arrays, beside: Sequence[Found]
) -> None:
    """Nothing may rely on what a kernel leaves in its scratch.

    Its arrays have the kernel's types and sizes, and are apart from each other and from what the
    kernel is given `beside` them.
    """
    taken = [place.block for place in beside if isinstance(place, Spot)]
    for found, (kind, count) in zip(given, wanted, strict=True):
        place = as_place(found, kind)
        if place.at.exact != 0 or count > len(place.block.cells):
            raise UndecidedError("scratch that is not there")
        if any(place.block is block for block in taken):
            raise UndecidedError(
                f"scratch that is {place.block.name}, which the kernel has already"
            )
        taken.append(place.block)
        for k in range(len(place.block.cells)):
            machine.write(place.block, k, None)


def _make_packed(layers: Callable[[], Layers], kernel: Packed) -> Rule:
    """Return the rule of a kernel that has the weights in another order."""

    def rule(machine: TermMachine, arguments: list[Found]) -> Found:
        address, inputs, hidden, x, h, *given, mode = arguments
        layer = _find_layer(address, layers(), kernel.kind, exact(inputs), exact(hidden))
        assert isinstance(address, AddressOf)
        tables = tuple(list_numbers(address.of, name) for name in kernel.tables)
        shift, more, bits = _read_shifts(address.of)
        hold_packed(layer, tables, kernel.pack, shift, more)
        lstm = layer.kind == "lstm"
        cell = as_place(given.pop(0), "int32_t") if lstm else None
        _hold_mode(layer, mode, bits)
        places = as_place(x, "int16_t"), as_place(h, "int32_t")
        _step(machine, layers(), layer, *places, exact(mode) == int(lstm), cell)
        own: list[Found] = [x, h, cell] if cell is not None else [x, h]
        _forget(machine, given, kernel.scratch(layer.inputs, layer.hidden), own)
        return None

    return rule


def _read_shifts(constants: Instance) -> tuple[list[int], list[int], list[int]]:
    """Return a layer's shifts, those of its multipliers, and its cell_bits."""
    shift, more, bits = (
        [c.low for c in constants.fields[name].cells if isinstance(c, Whole)]
        if name in constants.fields
        else []
        for name in (SHIFT, "multiplier_shift", "cell_bits")
    )
    return shift, more, bits


def _hold_mode(layer: Numbered, mode: Found, bits: Sequence[int]) -> None:
    """Raise where a kernel is called neither for a step in time nor towards rest."""
    lstm = layer.kind == "lstm"
    if list(bits) != [layer.cell_bits] * lstm:
        raise UndecidedError(f"{layer.name}: another cell_bits than the model's")
    if exact(mode) not in ((0, 1) if lstm else (0, -1)):
        raise UndecidedError("neither a step in time nor one towards rest")


def make_assembly(layers: Callable[[], Layers], layer: Numbered, constants: Instance) -> Rule:
    """Return the rule of a layer's function in assembly, whose text is known elsewhere."""
    shift, more, bits = _read_shifts(constants)
    pack = ASSEMBLY[constants.type]

    def rule(machine: TermMachine, arguments: list[Found]) -> Found:
        stream, h, x, *cell, mode = arguments
        place, lstm = as_place(stream, "int32_t"), layer.kind == "lstm"
        numbers = [c.low for c in place.block.cells if isinstance(c, Whole)]
        hold_packed(layer, (numbers,), pack, shift, more)
        _hold_mode(layer, mode, bits)
        if len(cell) != int(lstm):
            raise UndecidedError(f"{layer.name}: a cell state of another kind of layer")
        own = as_place(cell[0], "int32_t") if lstm else None
        places = as_place(x, "int16_t"), as_place(h, "int32_t")
        _step(machine, layers(), layer, *places, exact(mode) == int(lstm), own)
        return None

    return rule


def list_numbers(instance: Instance, name: str) -> list[int]:
    """Return the constants that a field points to; none where it is NULL."""
    place = instance.fields[name].cells[0]
    if isinstance(place, Whole) and place.exact == 0:
        return []
    if not isinstance(place, Spot) or place.at.exact != 0:
        raise UndecidedError(f"{instance.name}.{name} points to no table")
    return [c.low for c in place.block.cells if isinstance(c, Whole) and c.exact is not None]


def hold_packed(
    layer: Numbered,
    tables: Tables,
    pack: Callable[[Numbered], Tables],
    shift: Sequence[int],
    multiplier_shift: Sequence[int] = (),
) -> None:
    """Raise where a kernel's tables are not the model's numbers in its order."""
    same = list(shift) == list(layer.shift)
    if layer.multiplier:
        same = same and list(multiplier_shift) == list(layer.multiplier_shift)
    if not same or tables != pack(layer):
        raise UndecidedError(f"{layer.name}: the kernel's table holds other numbers than the model")


def _crc(kind: str, machine: TermMachine, arguments: list[Found]) -> Found:
    crc, values, count = arguments
    if not isinstance(values, Spot):
        raise UndecidedError("a CRC over no numbers")
    refuse_other_type(kind, values, "a CRC")
    cells = machine.cells(values, exact(count))
    start = as_number(crc).term
    if start.exact is None or any(c.exact is None for c in cells):
        known = Opaque("crc", lambda _: (0, 2**32 - 1))
        return Number(machine.terms.call(known, [start, *cells]), "uint32_t")
    words = b"".join((c.low & 0xFFFFFFFF).to_bytes(4, "little") for c in cells)
    return machine.constant(zlib.crc32(words, start.low), "uint32_t")


def _crc_word(machine: TermMachine, arguments: list[Found]) -> Found:
    crc, word = (machine.convert(as_number(a), "uint32_t").term for a in arguments)
    if crc.exact is None or word.exact is None:
        known = Opaque("crc", lambda _: (0, 2**32 - 1))
        return Number(machine.terms.call(known, [crc, word]), "uint32_t")
    return machine.constant(zlib.crc32(word.low.to_bytes(4, "little"), crc.low), "uint32_t")


def _hold_saved(
    machine: TermMachine, state: Found, size: Found, identity: Found, prefix: str
) -> int:
    if not isinstance(state, AddressOf) or not state.bytes or state.of.type != f"{prefix}_state_t":
        raise UndecidedError("what is saved or restored is not the state")
    if as_number(size).term is not machine.convert(machine.size_of(state.of.type), "uint32_t").term:
        raise UndecidedError("the state's size")
    return exact(identity)


def _save(machine: TermMachine, arguments: list[Found], prefix: str, used: Used) -> Found:
    saved, state, size, identity = arguments
    own = _hold_saved(machine, state, size, identity, prefix)
    place = as_place(saved, "uint8_t")
    used.saved.append((f"{own}", place.at.exact == 0))
    return None


def _restore(machine: TermMachine, arguments: list[Found], prefix: str, used: Used) -> Found:
    """0: the state holds the copy's bits, whatever they are; or it is as it was."""
    state, saved, size, identity = arguments
    own = _hold_saved(machine, state, size, identity, prefix)
    used.saved.append((f"{own}", as_place(saved, "uint8_t").at.exact == 0))
    assert isinstance(state, AddressOf)
    if machine.fork(2):
        used.restored = 1
        return Number(machine.terms.symbol("refused", 1, 2**32 - 1), "uint32_t")
    used.restored = 0
    for name, block in state.of.fields.items():
        low, high = TYPES[block.type]
        for k in range(len(block.cells)):
            machine.write(block, k, machine.terms.symbol(f"restored {name}[{k}]", low, high))
    return machine.constant(0, "uint32_t")


# Functions that stand for themselves: those of a variable step, and layer normalisations.
#
# The functions of a variable step, which stand for themselves (specification, 3.16 and 5).
#
# What the C of a model hands them and does with what they give is shown. That their own C, in
# zd_signals.h, is the specification is tested bit by bit against the reference, not proven. The
# numbers here are computed from the specification's text alone.
#
# A layer normalisation, which stands for itself (integer-layers.md, section 4).
#
# What the C of a model hands it, with which constants, and what it does with the results is shown.
# That its own C, in zd_layer_norm.h, is the specification is tested bit by bit against the
# reference, not proven. The numbers here are computed from the specification's text alone.

LONGEST = 2**61
MARGIN = 2**22
TESTED_ALONE = (
    "their C was compared with the reference bit by bit, for steps from 0 to 2^61 us; it is not"
    " derived"
)
"""Why the functions are told as tested."""
STRAIGHT = [int(2**33 / math.factorial(n + 2) + 1) >> 1 for n in range(11)]


@dataclass(frozen=True)
class Moved:
    """What a low-pass holds after a step, and its output."""

    before: Whole
    waiting: Whole
    y: Whole
    out: Whole


def find_shares(time: int, rate: int, shift: int) -> tuple[int, int, int] | None:
    """Return a, k and c of a step; None where it is collected."""
    bits = time.bit_length()
    place = time >> (bits - 32) if bits > 32 else time << (32 - bits)
    product = place * rate
    e = product.bit_length() + bits - 63 - shift
    if time == 0 or e < -19:
        return None
    m = product >> (product.bit_length() - 31)
    if e > 24:
        m, e = 2**31 - 1, 24
    k = max(-e, 0)
    f, straight = m >> k, STRAIGHT[10]
    for coefficient in STRAIGHT[9::-1]:
        straight = coefficient - (f * straight >> 31)
    c = f * straight >> 32
    a, s = m - (m * c >> 31), 2**31 - c
    for _ in range(e):
        s, a = s - (s * a >> 32), 2 * a - ((a * a + 2**31 - 1) >> 31)
    return a, k, min(2**31 - s, a >> k)


def _compute_lowpass(values: Sequence[int], rate: int, shift: int) -> tuple[int, int, int]:
    before, waiting, y, x, span = values
    shares = find_shares(waiting + span, rate, shift)
    if shares is None:
        return before, waiting + span, y
    a, k, c = shares
    gap = (before * 2**24 - y + 2**21) >> 22
    moved = (gap * a + 2 ** (8 + k)) >> (9 + k)
    return x, 0, y + moved + (((x - before) * c + 2**6) >> 7)


def bound_waiting(rate: int, shift: int) -> int:
    """Return the longest time that is collected: of T/tau < 2^-20."""
    return ((1 << (shift + 11)) - 1) // rate


def say_lowpass(terms: Terms, given: Sequence[Whole], rate: int, shift: int) -> Moved:
    """Return what a step makes of before, waiting, y, x and span."""
    before, waiting, y, x, span = given
    if waiting.exact == 0 and span.exact == 0:  # no time is collected
        return Moved(before, waiting, y, TermArithmetic(terms).round_shift(y, 24))
    low, high = min(before.low, x.low), max(before.high, x.high)
    bounds = {
        "before": (low, high),
        "waiting": (0, bound_waiting(rate, shift)),
        "y": (min(y.low, 2**24 * low - MARGIN), max(y.high, 2**24 * high + MARGIN)),
    }

    def part(name: str, at: int) -> Whole:
        known = Opaque(
            f"low-pass {rate} {shift} {name}",
            lambda _: bounds[name],
            lambda values: _compute_lowpass(values, rate, shift)[at],
        )
        return terms.call(known, given)

    after = part("y", 2)
    out = TermArithmetic(terms).round_shift(after, 24)
    return Moved(part("before", 0), part("waiting", 1), after, out)


def say_span(terms: Terms, slept: Whole, elapsed: Whole) -> Whole:
    """Return the time since the last step."""
    known = Opaque(
        "span", lambda _: (0, LONGEST), lambda v: min(v[0] + min(v[1], LONGEST), LONGEST)
    )
    return terms.call(known, [slept, elapsed])


def say_fast(terms: Terms, given: Sequence[Whole]) -> Whole:
    """Return whether now and before differ by more than rate_max in each period of a span."""

    def compute(values: Sequence[int]) -> int:
        now, before, most, span, period = values
        held = max(span, period)
        return int(held < 2**32 and min(abs(now - before), 2**31 - 1) * period > most * held)

    return terms.call(Opaque("fast", lambda _: (0, 1), compute), given)


def say_time(terms: Terms, time: Whole, span: Whole, limit: int, bits: int) -> tuple[Whole, Whole]:
    """Return the time since the start, and its ticks."""
    most = limit << bits
    known = Opaque(f"time up to {most}", lambda _: (0, most), lambda values: min(sum(values), most))
    after = terms.call(known, [time, span])
    return after, TermArithmetic(terms).round_shift(after, bits)


def make_elapsed_rules() -> dict[str, Rule]:
    """Return the rules of the functions."""
    return {
        "zd_lowpass_after": _run_lowpass,
        "zd_add_span": _with_numbers(
            ("int64_t", "uint64_t"), "int64_t", lambda m, a: say_span(m.terms, *a)
        ),
        "zd_is_fast": _with_numbers(
            ("int32_t", "int32_t", "int32_t", "int64_t", "uint32_t"),
            "uint32_t",
            lambda m, a: say_fast(m.terms, a),
        ),
        "zd_add_time": _run_time,
        "zd_draw_time": _draw_time,
    }


def _with_numbers(
    kinds: tuple[str, ...], result: str, run: Callable[[TermMachine, list[Whole]], Whole]
) -> Rule:
    def rule(machine: TermMachine, arguments: list[Found]) -> Found:
        given = [
            machine.convert(as_number(a), kind).term
            for a, kind in zip(arguments, kinds, strict=True)
        ]
        return Number(run(machine, given), result)

    return rule


def _put_value(machine: TermMachine, place: Spot, value: Whole) -> None:
    at = place.at.exact
    if at is None:
        raise UndecidedError(f"where in {place.block.name} is written")
    machine.write(place.block, at, value)


def _run_lowpass(machine: TermMachine, arguments: list[Found]) -> Found:
    *places, x, span, rate, shift = arguments
    kinds = ("int32_t", "int32_t", "int64_t")
    spots = [as_place(found, kind) for found, kind in zip(places, kinds, strict=True)]
    given = [machine.cells(spot, 1)[0] for spot in spots]
    given.append(machine.convert(as_number(x), "int32_t").term)
    given.append(machine.convert(as_number(span), "int64_t").term)
    if given[1].low < 0 or not 0 <= given[4].low <= given[4].high <= LONGEST:
        raise UndecidedError("a low-pass is stepped by no time")
    moved = say_lowpass(machine.terms, given, exact(rate), exact(shift))
    for spot, value in zip(spots, (moved.before, moved.waiting, moved.y), strict=True):
        _put_value(machine, spot, value)
    return Number(moved.out, "int32_t")


def _run_time(machine: TermMachine, arguments: list[Found]) -> Found:
    place, span, limit, bits = arguments
    spot = as_place(place, "int64_t")
    own = machine.cells(spot, 1)[0]
    given = machine.convert(as_number(span), "int64_t").term
    after, ticks = say_time(machine.terms, own, given, exact(limit), exact(bits))
    _put_value(machine, spot, after)
    return Number(ticks, "int32_t")


def _draw_time(machine: TermMachine, arguments: list[Found]) -> Found:
    seed = exact(arguments[0])
    return machine.constant((seed >> 16) << ((seed >> 11) & 31), "uint64_t")


NORM_TESTED = "its C was compared with the reference bit by bit; it is not derived"
"""Why it is told as tested."""


@dataclass(frozen=True)
class Normalisation:
    """The numbers of a layer normalisation."""

    align: tuple[int, ...]
    gain: tuple[int, ...]
    shift: tuple[int, ...]
    bias: tuple[int, ...]
    epsilon: int

    @property
    def root(self) -> int:
        """sqrt(M) in Q26, downwards."""
        return isqrt(len(self.align) << 52)


def list_norm_constants(count: int) -> tuple[int, int, int]:
    """Return reciprocal, its shift and root for so many numbers."""
    shift = 26 + count.bit_length()
    return (2**shift + count // 2) // count, shift, isqrt(count << 52)


def compute_norm(norm: Normalisation, x: Sequence[int]) -> list[int]:
    """Return the results for int16 copies."""
    count = len(x)
    reciprocal, mean_shift, root = list_norm_constants(count)
    v = [_round(n * 4096, by) for n, by in zip(x, norm.align, strict=True)]
    mean = _round(sum(v) * reciprocal, mean_shift)
    squares = norm.epsilon + sum((n - mean) ** 2 for n in v)
    doublings = (62 - squares.bit_length()) // 2 * 2
    a = squares << doublings >> 32
    r = 1143535043 - (652298158 * a >> 30)
    for _ in range(4):
        r = r * (1610612736 - ((r * r >> 29) * a >> 30)) >> 30
    scale = r * root >> 29
    found = []
    rows = zip(v, norm.gain, norm.shift, norm.bias, strict=True)
    for n, gain, shift, bias in rows:
        part = _round((n - mean) * scale, 31 - doublings // 2)
        found.append(_round(part * gain, shift) + bias)
    return found


def _round(x: int, by: int) -> int:
    return (x + (1 << by >> 1)) >> by


def say_norm(terms: Terms, norm: Normalisation, x: Sequence[Whole]) -> list[Whole]:
    """Return the results, each a function of all copies and of the layer's numbers."""
    row = terms.row(x)

    def make(i: int) -> Opaque:
        product = (norm.root + 8) * abs(norm.gain[i]) + (1 << norm.shift[i] >> 1)
        most = (product >> norm.shift[i]) + 1 + abs(norm.bias[i])
        return Opaque(
            f"{i} of {norm}", lambda _: (-most, most), lambda given: compute_norm(norm, given)[i]
        )

    return [terms.call(make(i), x, row) for i in range(len(x))]


def run_norm(told: Callable[[str], None]) -> Callable[[TermMachine, list[Found]], Found]:
    """Return the rule of `zd_layer_norm`; `told` is given the name of each layer."""

    def rule(machine: TermMachine, arguments: list[Found]) -> Found:
        address, x, y, width = arguments
        if not isinstance(address, AddressOf) or address.of.type != "zd_layer_norm_t":
            raise UndecidedError("no constants of a layer normalisation")
        count, norm = exact(width), _read(address.of)
        if any(len(row) != count for row in (norm.align, norm.gain, norm.shift, norm.bias)):
            raise UndecidedError(f"{address.of.name}: its tables do not have {count} numbers")
        given = machine.cells(as_place(x, "int16_t"), count)
        place = as_place(y, "int32_t")
        first = place.at.exact
        if first is None or first + count > len(place.block.cells):
            raise UndecidedError(f"where in {place.block.name} is written")
        for k, value in enumerate(say_norm(machine.terms, norm, given)):
            machine.write(place.block, first + k, value)
        told(address.of.name.removesuffix("_p"))
        return None

    return rule


def _read(constants: Instance) -> Normalisation:
    rows = [tuple(list_numbers(constants, n)) for n in ("align", "gain", "shift", "bias")]
    epsilon, *single = (
        _read_number(constants, name) for name in ("epsilon", "reciprocal", "mean_shift", "root")
    )
    if tuple(single) != list_norm_constants(len(rows[0])):
        raise UndecidedError(f"{constants.name}: its constants are not those of its width")
    return Normalisation(rows[0], rows[1], rows[2], rows[3], epsilon)


def _read_number(constants: Instance, name: str) -> int:
    (cell,) = constants.fields[name].cells
    if not isinstance(cell, Whole) or cell.exact is None:
        raise UndecidedError(f"{constants.name}.{name} is not known")
    return cell.exact
