"""What the LSTM's kernel does with intervals.

Written from docs/reference/integer-layers.md, section 3. Shares no code with the generator and
needs the standard library only.
"""

import re
from dataclasses import dataclass

from zerodrift_proof.certificate.gru import (
    MOST,
    Rows,
    Scaled,
    shift_right,
    trim,
    unpack_four,
    unpack_pairs,
    unpack_rows,
)
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.values import FaultError, LstmNumbers, Pointer, Struct, Value

CELL = 1 << 30
SLOWEST = 15


def run_lstm(
    machine: IntervalMachine,
    layer: Struct,
    inputs: Value,
    hidden: Value,
    *given: Pointer | Value,
) -> None:
    """Every accumulator by the sum of its terms' sizes, hence in whatever order they are added.

    Args:
        machine: runs the model.
        layer: its constants.
        inputs: number of features.
        hidden: number of units.
        given: features, output, cell state, scratch for the output's copy; whether to relax.
    """
    _require_sizes(inputs, hidden)
    step = _name_arguments(given, hidden.low)
    names = ("w_x", "w_h16", "w_h8", "multiplier", "bias")
    w_x, w_16, w_8, multiplier, bias = (machine.table_of(layer, n) for n in names)
    if bool(w_16) == bool(w_8) or bool(multiplier) != bool(w_8):
        raise FaultError(f"{layer.name}: weights of 16 bits, or of 8 bits and their multipliers")
    weights = LstmRows((w_x, w_16 or w_8, bias), multiplier)
    _step(machine, layer, weights, step, (inputs.low, hidden.low))


def run_lstm_rows(
    machine: IntervalMachine,
    layer: Struct,
    inputs: Value,
    hidden: Value,
    *given: Pointer | Value,
) -> None:
    """Step a layer whose weights lie in whole vectors; arguments as of `run_lstm`."""
    _require_sizes(inputs, hidden)
    n_x, units = inputs.low, hidden.low
    step = _name_arguments(given, 8 * (-(-n_x // 8) - (-units // 8)))
    names = ("weights", "bytes", "bias", "multiplier")
    numbers, small, biases, multiplier = (machine.table_of(layer, n) for n in names)
    try:
        found = unpack_lstm_rows(numbers, small, biases, multiplier, n_x, units)
    except (IndexError, ValueError) as error:
        raise FaultError(f"{layer.name}: its table is short or not filled up: {error}") from None
    scaled = found[3] if len(found) == 4 else []
    weights = LstmRows((found[0], found[1], found[2]), scaled)
    _step(machine, layer, weights, step, (n_x, units))


def _require_sizes(inputs: Value, hidden: Value) -> None:
    for value, what in ((inputs, "inputs"), (hidden, "units")):
        if value.exact is None or not 0 < value.exact <= MOST:
            raise FaultError(f"{value.low} .. {value.high} {what}")


def _name_arguments(given: tuple[Pointer | Value, ...], scratch: int) -> "LstmStep":
    """Return what a kernel is given; nothing may rely on what it leaves in its scratch."""
    *pointers, relaxing = given
    features, h, cell, copy = (p for p in pointers if isinstance(p, Pointer))
    if not isinstance(relaxing, Value):
        raise FaultError("relaxing is no number")
    if copy.block in (h.block, cell.block):
        raise FaultError("output, cell state and scratch lie on each other")
    copy.hold(scratch)
    copy.fill([Value(-(1 << 15), (1 << 15) - 1, "int16_t")] * scratch)
    return LstmStep(features, h, cell, relaxing)


@dataclass(frozen=True)
class LstmRows:
    """The numbers of a layer."""

    rows: Rows
    """w_x [H][4][I], w_h [H][4][H] and bias [H][4]."""
    multiplier: list[int]
    """[H][4] of 8-bit recurrent weights; else empty."""


@dataclass(frozen=True)
class LstmStep:
    """What a kernel is given beside its layer."""

    features: Pointer
    h: Pointer
    cell: Pointer
    relaxing: Value


def step_lstm(machine: IntervalMachine, layer: Struct, step: LstmStep) -> None:
    """Step a layer whose weights lie as the assembly reads them, all of its arrays."""
    inputs, hidden = step.features.sizes[0], step.h.sizes[0]
    stream = machine.table_of(layer, "stream")
    multiplier: list[int] = []
    try:
        if layer.type == "zd_lstm_bytes_t":
            *found, multiplier = unpack_lstm_bytes(stream, inputs, hidden)
            rows: Rows = (found[0], found[1], found[2])
        else:
            rows = unpack_pairs(stream, inputs, hidden, gates=4, biases=4)
    except (StopIteration, IndexError, ValueError) as error:
        raise FaultError(f"{layer.name}: its table is short or not filled up: {error}") from None
    words = -(-inputs // 2) + (-(-hidden // 4) + 1 if multiplier else -(-hidden // 2))
    if len(stream) != hidden * (4 + 4 * words):
        raise FaultError(f"{layer.name}: its table is longer than its layer")
    _step(machine, layer, LstmRows(rows, multiplier), step, (inputs, hidden))


def unpack_lstm_rows(
    numbers: list[int],
    small: list[int],
    biases: list[int],
    multiplier: list[int],
    inputs: int,
    hidden: int,
) -> Rows | Scaled:
    """As `unpack_rows`, of four gates."""
    return unpack_rows(numbers, small, biases, multiplier, inputs, hidden, gates=4)


def unpack_lstm_bytes(stream: list[int], inputs: int, hidden: int) -> Scaled:
    """[H]: i f g o per four of the output, the inner bytes exchanged; four biases, then the
    multipliers; blocks of inputs as `unpack_pairs`. The multipliers come last."""
    words, fours, pairs = iter(stream), -(-hidden // 4), -(-inputs // 2)
    found: Scaled = ([], [], [], [])
    for _ in range(hidden):
        rows: list[list[int]] = [[], [], [], []]
        for _ in range(fours):
            for row in rows:
                row.extend(unpack_four(next(words)))
        for row in rows:
            found[1].extend(trim(row, hidden))
        found[2].extend([next(words) for _ in range(4)])
        found[3].extend([next(words) for _ in range(4)])
        after = [next(words) for _ in range(4 * pairs)]
        found[0].extend(unpack_pairs([*[0] * 4, *after], inputs, 1, 4, 4, of_state=False)[0])
    return found


def _step(
    machine: IntervalMachine,
    layer: Struct,
    weights: LstmRows,
    step: LstmStep,
    sizes: tuple[int, int],
) -> None:
    n_x, count = sizes
    relaxing, h, cell = step.relaxing, step.h, step.cell
    if relaxing.exact not in (0, 1):
        raise FaultError(f"relaxing is {relaxing.low} .. {relaxing.high}; 0 and 1 are allowed")
    if h.block is cell.block:
        raise FaultError("output and cell state lie on each other")
    name = re.sub(r"_(\d+)$", r".\1", layer.name)  # a layer of a stack
    for place, limit in ((h, machine.h_limit), (cell, CELL)):
        if any(abs(v.low) > limit or abs(v.high) > limit for v in place.values(count)):
            machine.fail(f"{name}: {place.block.name} is not within {limit} before the step")
        place.fill([Value(-limit, limit)] * count)
    x = tuple(step.features.values(n_x))
    if (name, x) in machine.stepped:
        return
    largest = [max(abs(v.low), abs(v.high)) for v in x]
    _note_gates(machine, layer, weights, name, largest, count)
    _note_cell(machine, layer, name)
    machine.lstms[name] = LstmNumbers(
        *weights.rows,
        [layer.fields["shift"].value(g).low for g in range(4)],
        weights.multiplier,
        [
            layer.fields["multiplier_shift"].value(g).low
            for g in range(4 if weights.multiplier else 0)
        ],
        n_x,
        count,
        layer.fields["cell_bits"].value(0).low,
    )
    machine.shift = None
    machine.stepped.add((name, x))


def _note_gates(
    machine: IntervalMachine,
    layer: Struct,
    weights: LstmRows,
    name: str,
    sizes: list[int],
    units: int,
) -> None:
    (w_x, w_h, bias), multiplier = weights.rows, weights.multiplier
    rows, n_x = 4 * units, len(sizes)
    if (len(w_x), len(w_h), len(bias)) != (rows * n_x, rows * units, rows):
        raise FaultError(f"{name}: tables do not have the size of {units} units and {n_x} inputs")
    if multiplier and len(multiplier) != rows:
        raise FaultError(f"{name}: {len(multiplier)} multipliers of {units} units")
    second = 0
    for g, gate in enumerate("ifgo"):
        _note_shift(machine, layer, "shift", g, f"{name}.{gate}.shift", 31)
        if multiplier:
            where = f"{name}.{gate}.multiplier_shift"
            _note_shift(machine, layer, "multiplier_shift", g, where, 62)
    copied = (machine.h_limit + (1 << 14)) >> 15
    for row in range(rows):
        j, g = divmod(row, 4)
        where = f"{name}.{'ifgo'[g]}[{j}]"
        own = zip(w_x[row * n_x : (row + 1) * n_x], sizes, strict=True)
        from_x = sum(abs(w) * size for w, size in own)
        from_h = sum(map(abs, w_h[row * units : (row + 1) * units])) * copied
        if multiplier:
            second = layer.fields["multiplier_shift"].value(g).low
            scaled = from_h * abs(multiplier[row])
            total = scaled + (1 << second >> 1)
            machine.note(f"{where}.product", -from_h, from_h, 32)
            machine.note(f"{where}.scaled", -total, total, 64)
            from_h = (scaled >> second) + 1
        total = abs(bias[row]) + from_x + from_h
        machine.note(where, -total, total, 32)


def _note_shift(
    machine: IntervalMachine, layer: Struct, field: str, at: int, where: str, most: int
) -> None:
    shift = layer.fields[field].value(at).low
    shift_right(machine, Value(0, 0), Value(shift, shift), most)
    machine.note_shift(where, shift)


def _note_cell(machine: IntervalMachine, layer: Struct, name: str) -> None:
    """The sums that move the cell state, which the kernel limits to 2^30."""
    bits = layer.fields["cell_bits"].value(0).low
    if not 24 <= bits <= 27:
        raise FaultError(f"{name}: a cell state of {bits} fractional bits; 24 .. 27 are possible")
    machine.note_shift(f"{name}.cell_bits", bits)
    gate, bend = machine.r_max, machine.tanh_max
    if not (1 << 31) - gate >= (1 << 15):
        raise FaultError(f"{name}: f is not below 1 - 2^-16")
    added = ((bend * gate >> 32) + 1 >> (30 - bits)) + 1
    kept = (CELL * gate >> 32) + 1
    machine.note(f"{name}.moved", -kept - added, kept + added, 32)
    machine.note(f"{name}.distance", -kept - added, kept + added, 32)
    relaxed = CELL + ((kept + added) << SLOWEST)
    machine.note(f"{name}.relaxed", -relaxed, relaxed, 64)
    argument = CELL + (1 << (bits - 16) >> 1)
    machine.note(f"{name}.bend", -argument, argument, 32)
    if 2 * ((bend * gate >> 32) + 1) > machine.h_limit:
        raise FaultError(f"{name}: o tanh(c) is beyond {machine.h_limit}")
