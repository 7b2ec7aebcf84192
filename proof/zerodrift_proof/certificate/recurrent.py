"""What the kernels of GRU and LSTM do with intervals.

What the GRU's kernels do with intervals, whatever order they have the weights in.

Written from docs/reference/integer-arithmetic.md, section 4. Shares no code with the generator and
needs the standard library only.

What the LSTM's kernel does with intervals.

Written from docs/reference/integer-layers.md, section 3. Shares no code with the generator and
needs the standard library only.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from zerodrift_proof.certificate.intervals import Action, IntervalMachine
from zerodrift_proof.certificate.values import (
    TYPES,
    FaultError,
    GruNumbers,
    LstmNumbers,
    Pointer,
    Struct,
    Value,
)

MOST = 1 << 16
"""Units and inputs that are looked at; a generated model has some hundreds at most."""


def shift_right(machine: IntervalMachine, x: Value, shift: Value, most: int) -> Value:
    """Return x >> shift, which C must define."""
    if not 0 <= shift.low <= shift.high <= most:
        raise FaultError(f"a shift by {shift.low} .. {shift.high} bits; C defines 0 .. {most}")
    if shift.exact is None and not machine.has_block:
        raise FaultError(f"a shift by {shift.low} .. {shift.high} bits, which are not known")
    machine.shift = shift.exact
    ends = [end >> by for end in (x.low, x.high) for by in (shift.low, shift.high)]
    return Value(min(ends), max(ends), x.type)


Rows = tuple[list[int], list[int], list[int]]
"""w_x [H][3][I], w_h [H][3][H] and bias [H][4] of a layer."""


@dataclass(frozen=True)
class Weights:
    """The numbers of a layer."""

    rows: Rows
    multiplier: list[int]
    """[H][3] of 8-bit recurrent weights; else empty."""
    after: bool
    """Whether the reset gate acts after the recurrent product."""


@dataclass(frozen=True)
class GruStep:
    """What a kernel is given beside its layer."""

    inputs: Value
    hidden: Value
    features: Pointer
    h: Pointer
    scratches: tuple[Pointer, ...]
    u_keep: Value


def run_portable(machine: IntervalMachine, after: bool, layer: Struct, step: GruStep) -> None:
    """Step a layer whose weights lie unit by unit; `after` tells where the reset gate acts."""
    _check_sizes(step)
    names = ("w_x", "w_h16", "w_h8", "multiplier", "bias")
    w_x, w_16, w_8, multiplier, bias = (machine.table_of(layer, name) for name in names)
    if bool(w_16) == bool(w_8) or bool(multiplier) != bool(w_8):
        raise FaultError(f"{layer.name}: weights of 16 bits, or of 8 bits and their multipliers")
    for scratch in step.scratches:
        scratch.hold(step.hidden.low)
    _require_apart(step)
    weights = Weights((w_x, w_16 or w_8, bias), multiplier, after)
    _gru(machine, layer, weights, step)
    for scratch in step.scratches:
        _leave_unknown(scratch, step.hidden.low)


def run_packed(machine: IntervalMachine, packing: "Packing", layer: Struct, step: GruStep) -> None:
    """Step a layer whose weights lie in another order."""
    _check_sizes(step)
    unpack, sizes, after = packing.unpack, packing.scratch, packing.after
    inputs, hidden = step.inputs.low, step.hidden.low
    for scratch, size in zip(step.scratches, sizes(machine, inputs, hidden), strict=True):
        scratch.hold(size)
        _leave_unknown(scratch, size)
    _require_apart(step)
    if machine.is_of_block(layer):
        if packing is not PAIRS:
            raise FaultError(f"{layer.name}: a block holds the numbers in the order of pairs")
        _step_of_block(machine, layer, step)
        return
    tables = [
        machine.table_of(layer, name)
        for name in ("stream", "weights", "bytes", "bias", "multiplier")
        if name in layer.tables
    ]
    try:
        rows = unpack(*tables, inputs, hidden)
    except (StopIteration, IndexError, ValueError) as error:
        raise FaultError(f"{layer.name}: its table is short or not filled up: {error}") from None
    multiplier = rows[3] if len(rows) == 4 else []
    _gru(machine, layer, Weights(rows[:3], multiplier, after), step)


def _check_sizes(step: GruStep) -> None:
    for value, what in ((step.inputs, "inputs"), (step.hidden, "units")):
        if value.exact is None or not 0 < value.exact <= MOST:
            raise FaultError(f"{value.low} .. {value.high} {what}")
    u_keep = step.u_keep
    if u_keep.exact not in (-1, 0):
        raise FaultError(f"u_keep is {u_keep.low} .. {u_keep.high}; -1 and 0 are allowed")


def _require_apart(step: GruStep) -> None:
    blocks = [step.h.block, *(scratch.block for scratch in step.scratches)]
    if len({id(block) for block in blocks}) != len(blocks):
        raise FaultError("state and scratch lie on each other")


def _leave_unknown(scratch: Pointer, count: int) -> None:
    """Nothing but the kernel may rely on what it leaves in its scratch."""
    low, high = TYPES[scratch.block.type]
    scratch.fill([Value(low, high, scratch.block.type)] * count)


def _halves(words: list[int]) -> list[int]:
    """Return the two 16-bit numbers of each word, the lower one first."""
    return [((w >> s & 0xFFFF) ^ 0x8000) - 0x8000 for w in words for s in (0, 16)]


def unpack_pairs(
    stream: list[int],
    inputs: int,
    hidden: int,
    gates: int = 3,
    biases: int = 4,
    of_state: bool = True,
) -> Rows:
    """[H]: biases; then blocks of two pairs of inputs, gate by gate; then those of the state."""
    rows: Rows = ([], [], [])
    words = iter(stream)
    for _ in range(hidden):
        rows[2].extend(next(words) for _ in range(biases))
        for target, count in ((rows[0], inputs), (rows[1], hidden))[: 1 + of_state]:
            halves: list[list[int]] = [[] for _ in range(gates)]
            for first in range(0, count, 4):
                width = min(2, -(-(count - first) // 2))
                for gate in halves:
                    gate.extend(_halves([next(words) for _ in range(width)]))
            for gate in halves:
                target.extend(trim(gate, count))
    return rows


def unpack_columns(stream: list[int], inputs: int, hidden: int) -> Rows:
    """[H / 8]: biases [4][8]; then per pair of inputs r u n [3][8]; then the same of the state."""
    units: list[Rows] = [([], [], []) for _ in range(-(-hidden // 8) * 8)]
    words = iter(stream)
    for first in range(0, hidden, 8):
        some = units[first : first + 8]
        for _ in range(4):
            for unit in some:
                unit[2].append(next(words))
        for part, count in ((0, inputs), (1, hidden)):
            gates: list[list[list[int]]] = [[[], [], []] for _ in some]
            for _ in range(-(-count // 2)):
                for gate in range(3):
                    for unit_gates in gates:
                        unit_gates[gate].extend(_halves([next(words)]))
            for unit, unit_gates in zip(some, gates, strict=True):
                unit[part].extend(w for gate in unit_gates for w in trim(gate, count))
    if any(any(numbers) for unit in units[hidden:] for numbers in unit):
        raise ValueError("units beyond the last are not zero")
    return tuple([n for unit in units[:hidden] for n in unit[part]] for part in range(3))  # type: ignore[return-value]


Scaled = tuple[list[int], list[int], list[int], list[int]]
"""Rows, and multipliers of 8-bit recurrent weights."""


def unpack_rows(
    numbers: list[int],
    small: list[int],
    biases: list[int],
    multiplier: list[int],
    inputs: int,
    hidden: int,
    gates: int = 3,
) -> Rows | Scaled:
    """[U][gates]: vectors of 8 features, then of 8 states; U is H up to 4.

    With 8-bit weights of the state these have a table `small` of their own. Biases lie [U / 4][4
    kinds][4], multipliers [U / 4][gates][4].
    """
    bias = _split_fours(biases, 4, hidden)
    if not small and not multiplier:
        w_x, w_h = _split_rows(numbers, gates, hidden, (inputs, hidden))
        return w_x, w_h, bias
    (w_x,) = _split_rows(numbers, gates, hidden, (inputs,))
    (w_h,) = _split_rows(small, gates, hidden, (hidden,))
    return w_x, w_h, bias, _split_fours(multiplier, gates, hidden)


def unpack_rows_before(
    numbers: list[int],
    small: list[int],
    biases: list[int],
    multiplier: list[int],
    inputs: int,
    hidden: int,
) -> Rows | Scaled:
    """Weights of r u of all units, then those of n; the rest as `unpack_rows`."""
    numbers, small = _join_passes(numbers, hidden), _join_passes(small, hidden)
    return unpack_rows(numbers, small, biases, multiplier, inputs, hidden)


def _split_rows(
    numbers: list[int], gates: int, hidden: int, counts: tuple[int, ...]
) -> list[list[int]]:
    """Return the parts of all rows, each of which is filled up to a multiple of 8."""
    widths = [-(-count // 8) * 8 for count in counts]
    _require_length(numbers, gates * sum(widths), hidden)
    parts: list[list[int]] = [[] for _ in counts]
    at = 0
    for row in range(len(numbers) // sum(widths)):
        for part, count, width in zip(parts, counts, widths, strict=True):
            found = trim(numbers[at : at + width], count if row < hidden * gates else 0)
            part.extend(found)
            at += width
    return parts


def _split_fours(numbers: list[int], gates: int, hidden: int) -> list[int]:
    """Return [U / 4][gates][4] unit by unit."""
    _require_length(numbers, gates, hidden)
    each = range(gates)
    return [numbers[j // 4 * 4 * gates + 4 * g + j % 4] for j in range(hidden) for g in each]


def _join_passes(table: list[int], hidden: int) -> list[int]:
    """Return [U][3] of [U][2] and then [U]."""
    units = -(-hidden // 4) * 4
    row, rest = divmod(len(table), 3 * units)
    if rest:
        raise ValueError(f"{len(table)} weights of {units} units")
    both, last = table[: 2 * units * row], table[2 * units * row :]
    joined = []
    for j in range(units):
        joined += both[2 * j * row : 2 * (j + 1) * row] + last[j * row : (j + 1) * row]
    return joined


def _require_length(numbers: list[int], each: int, hidden: int) -> None:
    if len(numbers) != -(-hidden // 4) * 4 * each:
        raise ValueError(f"{len(numbers)} numbers, not {each} of each unit")


def unpack_before(stream: list[int], inputs: int, hidden: int) -> Rows:
    """[H] biases and blocks of r u as `unpack_pairs`, then [H] those of n."""
    words = 2 + 2 * (-(-inputs // 2) - (-hidden // 2))
    if len(stream) != hidden * words * 3 // 2:
        raise ValueError(f"{len(stream)} words, not {hidden * words * 3 // 2}")
    both = unpack_pairs(stream[: hidden * words], inputs, hidden, gates=2, biases=2)
    last = unpack_pairs(stream[hidden * words :], inputs, hidden, gates=1, biases=1)
    rows: Rows = ([], [], [])
    for unit in range(hidden):
        for part, count in ((0, inputs), (1, hidden)):
            rows[part].extend(both[part][2 * unit * count : 2 * (unit + 1) * count])
            rows[part].extend(last[part][unit * count : (unit + 1) * count])
        rows[2].extend((*both[2][2 * unit : 2 * unit + 2], last[2][unit], 0))
    return rows


def unpack_bytes(stream: list[int], inputs: int, hidden: int) -> Scaled:
    """[H]: three biases; blocks of inputs as `unpack_pairs`; r u n per four of the state, the inner
    bytes exchanged; the bias inside; three multipliers. The multipliers come last."""
    words, fours = iter(stream), -(-hidden // 4)
    each = 7 + 3 * (-(-inputs // 2) + fours)
    if len(stream) != hidden * each:
        raise ValueError(f"{len(stream)} words, not {hidden * each}")
    found: Scaled = ([], [], [], [])
    for _ in range(hidden):
        biases = [next(words) for _ in range(3)]
        before = [next(words) for _ in range(3 * -(-inputs // 2))]
        found[0].extend(unpack_pairs([*[0] * 3, *before], inputs, 1, 3, 3, of_state=False)[0])
        rows: list[list[int]] = [[], [], []]
        for _ in range(fours):
            for row in rows:
                row.extend(unpack_four(next(words)))
        for row in rows:
            found[1].extend(trim(row, hidden))
        found[2].extend((*biases, next(words)))
        found[3].extend(next(words) for _ in range(3))
    return found


def unpack_four(word: int) -> list[int]:
    """Four weights of 8 bits, the inner bytes exchanged."""
    return [((word >> s & 0xFF) ^ 0x80) - 0x80 for s in (0, 16, 8, 24)]


@dataclass(frozen=True)
class Packing:
    """How the tables of a kernel lie."""

    unpack: Callable[..., Rows | Scaled]
    """From its tables to the rows, and to the multipliers where it has some."""
    scratch: Callable[[IntervalMachine, int, int], list[int]]
    """What its scratch arrays have to hold, in order."""
    after: bool = True
    """Whether the reset gate acts after the recurrent product."""


PAIRS = Packing(unpack_pairs, lambda m, i, h: [m.per_pair * (-(-i // 2) - (-h // 2))])
ROWS = Packing(unpack_rows, lambda m, i, h: [8 * (-(-i // 8) - (-h // 8))])
ROWS_BEFORE = Packing(
    unpack_rows_before, lambda m, i, h: [16 * (-(-i // 8) - (-h // 8)), 4 * -(-h // 4)], after=False
)
COLUMNS = Packing(unpack_columns, lambda m, i, h: [8 * -(-h // 8), -(-i // 2) + 4 * -(-h // 8)])
BEFORE = Packing(unpack_before, lambda m, i, h: [0], after=False)
BYTES = Packing(unpack_bytes, lambda m, i, h: [0])


def trim(row: list[int], count: int) -> list[int]:
    """Return a row without what fills it up, which must be zeros."""
    if len(row) < count or any(row[count:]):
        raise ValueError(f"a row of {count} weights is short, or filled up with more than zeros")
    return row[:count]


def _move(machine: IntervalMachine, name: str, step: GruStep) -> None:
    """The state stays within the limit that the proof of the recurrence is about."""
    limit, h, n_h = machine.h_limit, step.h, step.hidden.low
    if any(abs(v.low) > limit or abs(v.high) > limit for v in h.values(n_h)):
        machine.fail(f"{name}: the state is not known to be within {limit} before the step")
    h.fill([Value(-limit, limit)] * n_h)


def _step_of_block(machine: IntervalMachine, layer: Struct, step: GruStep) -> None:
    """Every accumulator by what the test of a block lets through."""
    name, n_x, n_h = layer.name, step.inputs.low, step.hidden.low
    x = step.features.values(n_x)
    _move(machine, name, step)
    stream = layer.tables["stream"]
    rows = None if stream is None else machine.find_rows(stream)
    if rows is None or (rows.units, rows.x, rows.h) != (n_h, -(-n_x // 2), -(-n_h // 2)):
        raise FaultError(f"{name}: {n_h} units of {n_x} inputs, of which the test shows nothing")
    least, most = TYPES["int16_t"]
    if any(v.low < least or v.high > most for v in x) or machine.h_limit + (1 << 14) >> 15 > most:
        raise FaultError(f"{name}: a feature or the copy of a state is no int16_t")
    if (name, tuple(x)) in machine.recurrent:
        return
    machine.recurrent.add((name, tuple(x)))
    end = TYPES["int32_t"][1]
    for g, gate in enumerate("run"):
        shift = layer.fields["shift"].value(g)
        shift_right(machine, Value(0, 0), shift, 31)
        machine.note_shift(f"{name}.{gate}.shift", shift.low)
        for j in range(n_h):
            machine.note(f"{name}.{gate}[{j}]", -end, end, 32)
            if g == 2:
                machine.note(f"{name}.{gate}[{j}].inside", -end, end, 32)
    machine.shift = None
    reach = machine.tanh_max + machine.h_limit
    machine.note(f"{name}.state_step", -reach, reach, 32)


def _gru(machine: IntervalMachine, layer: Struct, weights: Weights, step: GruStep) -> None:
    """Every accumulator by the sum of its terms' sizes, hence in whatever order they are added."""
    (w_x, w_h, bias), multiplier = weights.rows, weights.multiplier
    n_x, n_h, h_q15 = step.inputs.low, step.hidden.low, (machine.h_limit + (1 << 14)) >> 15
    x = step.features.values(n_x)
    name = re.sub(r"_(\d+)$", r".\1", layer.name)  # a layer of a stack
    _move(machine, name, step)
    if (name, tuple(x)) in machine.recurrent:
        return
    shifts = [layer.fields["shift"].value(g).low for g in range(3)]
    if multiplier:
        multiplier_shifts = [layer.fields["multiplier_shift"].value(g).low for g in range(3)]
    if (len(w_x), len(w_h), len(bias)) != (3 * n_h * n_x, 3 * n_h * n_h, 4 * n_h):
        raise FaultError(f"{name}: tables do not have the size of {n_h} units and {n_x} inputs")
    if multiplier and len(multiplier) != 3 * n_h:
        raise FaultError(f"{name}: {len(multiplier)} multipliers of {n_h} units")
    for g, gate in enumerate("run"):
        shift_right(machine, Value(0, 0), Value(shifts[g], shifts[g]), 31)
        machine.note_shift(f"{name}.{gate}.shift", shifts[g])
        if multiplier:
            both = Value(multiplier_shifts[g], multiplier_shifts[g])
            shift_right(machine, Value(0, 0), both, 62)
            machine.note_shift(f"{name}.{gate}.multiplier_shift", multiplier_shifts[g])
    sizes = [max(abs(v.low), abs(v.high)) for v in x]
    for row in range(3 * n_h):
        j, g = divmod(row, 3)
        where = f"{name}.{'run'[g]}[{j}]"
        own = zip(w_x[row * n_x : (row + 1) * n_x], sizes, strict=True)
        from_x = sum(abs(w) * size for w, size in own)
        from_h = sum(map(abs, w_h[row * n_h : (row + 1) * n_h])) * h_q15
        if multiplier:
            scaled, shift = from_h * abs(multiplier[row]), multiplier_shifts[g]
            machine.note(f"{where}.product", -from_h, from_h, 32)
            total = scaled + (1 << shift >> 1)
            machine.note(f"{where}.scaled", -total, total, 64)
            from_h = (scaled >> shift) + 1
        if g == 2 and weights.after:
            inside = abs(bias[4 * j + 3]) + from_h
            machine.note(f"{where}.inside", -inside, inside, 32)
            from_h = (inside * machine.r_max >> 32) + 1
        total = abs(bias[4 * j + g]) + from_x + from_h
        machine.note(where, -total, total, 32)
    machine.shift = None
    machine.recurrent.add((name, tuple(x)))
    machine.grus[name] = GruNumbers(
        w_x,
        w_h,
        bias,
        shifts,
        multiplier,
        multiplier_shifts if multiplier else [],
        n_x,
        n_h,
        weights.after,
    )
    most = machine.tanh_max + machine.h_limit
    machine.note(f"{name}.state_step", -most, most, 32)


Given: TypeAlias = tuple[Value, Value, Pointer, Pointer, *tuple[Pointer, ...], Value]
"""inputs, hidden, features, state, scratch arrays, u_keep."""


def portable(after: bool) -> Action:
    """Return the rule of a kernel whose weights lie unit by unit."""

    def act(machine: IntervalMachine, layer: Struct, *given: *Given) -> None:
        run_portable(machine, after, layer, _name_arguments(given))

    return act


def packed(packing: Packing) -> Action:
    """Return the rule of a kernel whose weights lie in another order."""

    def act(machine: IntervalMachine, layer: Struct, *given: *Given) -> None:
        run_packed(machine, packing, layer, _name_arguments(given))

    return act


def _name_arguments(given: Given) -> GruStep:
    inputs, hidden, features, h, *scratches, u_keep = given
    return GruStep(inputs, hidden, features, h, tuple(scratches), u_keep)


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
    step = _name_lstm_arguments(given, hidden.low)
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
    step = _name_lstm_arguments(given, 8 * (-(-n_x // 8) - (-units // 8)))
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


def _name_lstm_arguments(given: tuple[Pointer | Value, ...], scratch: int) -> "LstmStep":
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
