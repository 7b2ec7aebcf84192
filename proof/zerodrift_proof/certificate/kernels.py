"""What the runtime's functions ask of their arguments, and what they do with intervals.

What the runtime's functions of a variable step do with intervals (specification, 3.16, 5).

What a layer normalisation does with intervals.

Written from docs/reference/integer-layers.md, section 4. Shares no code with the generator and
needs the standard library only.

Written from docs/reference/integer-arithmetic.md, section 3. Shares no code with the generator and
needs the standard library only.
"""

import zlib
from collections.abc import Callable
from dataclasses import replace
from math import isqrt

from zerodrift_proof.certificate.intervals import (
    IntervalMachine,
    Rule,
    check_number,
    check_row,
    number,
    typed,
)
from zerodrift_proof.certificate.recurrent import (
    COLUMNS,
    PAIRS,
    ROWS,
    ROWS_BEFORE,
    packed,
    portable,
    run_lstm,
    run_lstm_rows,
    shift_right,
)
from zerodrift_proof.certificate.values import (
    TYPES,
    Address,
    FaultError,
    Found,
    Pointer,
    Struct,
    Value,
    anything,
)

LONGEST_US = 1 << 61
MOST_A = (1 << 31) - 1
"""Of a and c in 2^-31: both are below 1."""
MARGIN = 1 << 22
"""2^21 + 1/a in 2^-24, for a above 2^-21."""


def add_span(machine: IntervalMachine, slept: Value, elapsed: Value) -> Value:
    """Both together, at most 2^61."""
    _require(slept, 0, LONGEST_US, "the time slept")
    del elapsed  # any 64 bits
    return Value(0, LONGEST_US, "int64_t")


def draw_time(machine: IntervalMachine, seed: Value) -> Value:
    """Any time."""
    return anything("uint64_t")


def is_fast(
    machine: IntervalMachine, now: Value, before: Value, most: Value, span: Value, period: Value
) -> Value:
    """0 or 1; what is multiplied stays below 2^63 for any codes."""
    del now, before
    _require(most, 0, TYPES["int32_t"][1], "a rate")
    _require(span, 0, LONGEST_US, "a time")
    number(period, 1, TYPES["uint32_t"][1], "the sample period")
    return Value(0, 1, "uint32_t")


def add_time(
    machine: IntervalMachine, place: Pointer, span: Value, limit: Value, by: Value
) -> Value:
    """A sum that stops at limit 2^bits."""
    time, name = _cell(place), machine.name_of(place.block).removesuffix(".time")
    _require(span, 0, LONGEST_US, "a time")
    bits, ticks = number(by, 0, 60, "the tick"), number(limit, 1, TYPES["int32_t"][1], "a limit")
    most = ticks << bits
    if most > LONGEST_US or time.low < 0:
        raise FaultError(f"{name}: {time.low} .. {most} us are no times of up to {LONGEST_US}")
    machine.note(f"{name}.sum", 0, time.high + span.high, 64)
    machine.convert(Value(0, time.high + span.high, "int64_t"), "int64_t")
    place.fill([Value(0, most, "int64_t")])
    return Value(0, ((most + (1 << bits >> 1)) >> bits))


def lowpass_after(
    machine: IntervalMachine,
    before: Pointer,
    waiting: Pointer,
    place: Pointer,
    x: Value,
    span: Value,
    rate: Value,
    by: Value,
) -> Value:
    """y' = (1 - a) y + (a - c) x + c x' with 0 <= c <= a < 1: y stays where the inputs were, but
    for what rounding adds, 2^21 a + 1 a step, of which the share a is forgotten. What is collected
    is below 2^-20 time constants."""
    own, held, y = _cell(before), _cell(waiting), _cell(place)
    name = machine.name_of(place.block).removesuffix(".y")
    shift, one = number(by, 0, 50, "the shift"), 1 << 24
    _require(rate, 1, MOST_A, "a rate in 2^-31")
    _require(span, 0, LONGEST_US, "a time")
    _require(held, 0, TYPES["int32_t"][1], "a collected time")
    most = ((1 << (shift + 11)) - 1) // rate.low
    if most > TYPES["int32_t"][1]:
        raise FaultError(f"{name}: up to {most} us are collected, which int32_t does not hold")
    after = Value(min(own.low, x.low), max(own.high, x.high))
    gap = Value(
        (one * own.low - y.high + (1 << 21)) >> 22, (one * own.high - y.low + (1 << 21)) >> 22
    )
    machine.note(f"{name}.gap", gap.low, gap.high, 32)
    scaled = min(gap.low * MOST_A, 0), max(gap.high * MOST_A, 0) + (1 << 27)
    risen = min((x.low - own.high) * MOST_A, 0), max((x.high - own.low) * MOST_A, 0) + (1 << 6)
    machine.note(f"{name}.scaled", *scaled, 64)
    machine.note(f"{name}.rise", *risen, 64)
    low, high = (one * after.low) - MARGIN, (one * after.high) + MARGIN
    moved = Value(min(y.low, low), max(y.high, high), "int64_t")
    place.fill([machine.convert(moved, "int64_t")])
    before.fill([after])
    waiting.fill([Value(0, most)])
    return machine.convert(
        Value((moved.low + (1 << 23)) >> 24, (moved.high + (1 << 23)) >> 24, "int64_t"), "int32_t"
    )


def _cell(pointer: Pointer) -> Value:
    """Return what a single number of the state is."""
    if pointer.block.sizes or pointer.first.exact != 0:
        raise FaultError(f"{pointer.block.name} is no single number")
    return pointer.values(1)[0]


def _require(value: Value, least: int, most: int, what: str) -> None:
    if not least <= value.low <= value.high <= most:
        raise FaultError(f"{what} is {value.low} .. {value.high}; {least} .. {most} is allowed")


MOST = 128
EPSILON = 1 << 60
SPARE = 8
"""A number's square is one of the squares, so that it is at most sqrt(M) of their mean's root; and
what roundings add: 2^-27 of that, at most 6, and a half."""


def normalise(
    machine: IntervalMachine, layer: Struct, x: Pointer, y: Pointer, count: Value
) -> None:
    """Bound every sum by the sizes of its terms; the results by what the parts are limited to.

    Args:
        machine: runs the model.
        layer: its constants.
        x: int16 copies of what it reads.
        y: the results.
        count: how many there are.
    """
    n = number(count, 1, MOST, "the number of normalised values")
    name = layer.name.removesuffix("_p")
    if x.block is y.block:
        raise FaultError(f"{name}: it reads what it writes")
    align, gain, shift, bias = (
        machine.table_of(layer, field) for field in ("align", "gain", "shift", "bias")
    )
    if any(len(row) != n for row in (align, gain, shift, bias)):
        raise FaultError(f"{name}: its tables do not have {n} numbers")
    epsilon, reciprocal, root, mean_shift = (
        layer.fields[field].value(0).low
        for field in ("epsilon", "reciprocal", "root", "mean_shift")
    )
    log = n.bit_length() - 1
    wanted = (2 * (1 << 27 + log) + n) // (2 * n), isqrt(n << 52), 27 + log
    if (reciprocal, root, mean_shift) != wanted or not 1 <= epsilon <= EPSILON:
        raise FaultError(f"{name}: its constants are not those of {n} numbers")
    for i in range(n):
        for field, row in (("align", align), ("shift", shift)):
            shift_right(machine, Value(0, 0), Value(row[i], row[i]), 62)
            machine.note_shift(f"{name}[{i}].{field}", row[i])
    machine.note_shift(f"{name}.mean_shift", mean_shift)
    raised = []
    for by, v in zip(align, x.values(n), strict=True):
        half = 1 << by >> 1
        raised.append(max(abs(((end << 12) + half) >> by) for end in (v.low, v.high)))
    total = sum(raised)
    product = total * reciprocal + (1 << mean_shift >> 1)
    away = max(raised) + (product >> mean_shift) + 1
    # the mean as an integer is at most `astray` from the true one
    astray = total * abs(reciprocal * n - (1 << mean_shift)) // (n << mean_shift) + 2
    squares = epsilon + sum(v * v for v in raised) + n * astray * astray
    scale = (((1 << 30) + 4) * root) >> 29
    machine.note(f"{name}.sum", -total, total, 64)
    machine.note(f"{name}.mean", -product, product, 64)
    machine.note(f"{name}.difference", -away, away, 32)
    machine.note(f"{name}.squares", 0, squares, 63)
    machine.note(f"{name}.scale", 0, scale, 32)
    part = away * scale + (1 << 30)
    machine.note(f"{name}.part", -part, part, 64)
    results = []
    for i in range(n):
        scaled = (root + SPARE) * abs(gain[i]) + (1 << shift[i] >> 1)
        largest = (scaled >> shift[i]) + 1 + abs(bias[i])
        reach = largest + (1 << 14)
        machine.note(f"{name}[{i}].product", -scaled, scaled, 64)
        machine.note(f"{name}[{i}]", -reach, reach, 32)
        ends = ((-largest + (1 << 14)) >> 15, (largest + (1 << 14)) >> 15)
        machine.note(f"{name}[{i}].copy", *ends, 16)
        results.append(Value(-largest, largest))
    y.fill(results)
    machine.shift = None


SAVED_EXTRA = 16
"""Bytes that a saved state has more than the state."""


def _clamp(machine: IntervalMachine, x: Value, low: Value, high: Value) -> Value:
    is_code = x.copy_of is not None and x.copy_of[0] in machine.inputs
    machine.pending["code" if is_code else "limits"] = (low.low, high.high, 32)
    return _limit(x, low, high)


def _clamp_wide(machine: IntervalMachine, x: Value, low: Value, high: Value) -> Value:
    machine.note_plain_sum(x)
    return _limit(x, low, high)


def _limit(x: Value, low: Value, high: Value) -> Value:
    if low.high > high.low:
        raise FaultError(f"limits {low.low} .. {low.high} and {high.low} .. {high.high}")
    return Value(min(max(x.low, low.low), high.high), min(max(x.high, low.low), high.high))


def _shift_sum(machine: IntervalMachine, x: Value, shift: Value) -> Value:
    machine.pending["sum"] = (-x.reach, x.reach, 64)
    return shift_right(machine, x, shift, 63)


def _round_shift(machine: IntervalMachine, x: Value, shift: Value) -> Value:
    half = 1 << number(shift, 0, 62, "the shift") >> 1
    rounded = machine.convert(Value(x.low + half, x.high + half, "int64_t"), "int64_t")
    machine.pending["product"] = (x.low, x.high + half, 64)
    return shift_right(machine, rounded, shift, 62)


def _load(
    machine: IntervalMachine, measured: Value, drift: Value, low: Value, high: Value
) -> Value:
    """Any int32 less any int32, limited."""
    del measured, drift
    machine.pending["difference"] = (1 - (1 << 32), (1 << 32) - 1, 64)
    machine.pending["limits"] = (low.low, high.high, 32)
    return _limit(Value(low.low, high.high), low, high)


def _state_cell(pointer: Pointer) -> Value:
    """Return what a single number of the state is."""
    if pointer.block.sizes or pointer.first.exact != 0:
        raise FaultError(f"{pointer.block.name} is no single number")
    return pointer.values(1)[0]


def _most(machine: IntervalMachine, value: Value, what: str) -> int:
    """Return the largest that a parameter can be: one known number, or any of a block's."""
    if value.exact is None and not machine.has_block:
        raise FaultError(f"{what} is {value.low} .. {value.high}, and no block holds it")
    if value.low < 0:
        raise FaultError(f"{what} is {value.low} .. {value.high}; at least 0 is allowed")
    return value.high


def _play(machine: IntervalMachine, place: Pointer, x: Value, half_width: Value) -> Value:
    """y' lies between y and x, so a range of y that holds all x is never left."""
    y, half = _state_cell(place), _most(machine, half_width, "half of the slack")
    machine.pending["slack"] = (x.low - half, x.high + half, 32)
    machine.convert(Value(x.low - half, x.high + half, "int64_t"), "int32_t")
    after = Value(min(y.low, x.low), max(y.high, x.high))
    place.fill([after])
    return after


def _count_from(
    machine: IntervalMachine,
    drift: Pointer,
    answered: Pointer,
    tared: Pointer,
    tare: Pointer,
    count: Value,
) -> Value:
    """Any answers less any others, limited to int32_t."""
    n = number(count, 0, TYPES["uint32_t"][1], "the length")
    answered.fill(drift.values(n))
    tare.values(n)
    _state_cell(tared)
    drift.fill([anything("int32_t")] * n)
    tared.fill([Value(1, 2)])
    return Value(0, 1, "uint32_t")


def _between(machine: IntervalMachine, older: Value, newer: Value, share: Value) -> Value:
    part = _most(machine, share, "a share in 2^-31")
    ends = (older.low - newer.high, newer.high - older.low)
    rise = max(abs(e) for e in ends) * part
    machine.pending["rise"] = (-rise, rise + (1 << 30), 64)
    return older.join(newer)


def _polynomial(machine: IntervalMachine, terms: list[int]) -> None:
    """Horner's rule for any share f of an octave, 0 <= f < 1."""
    low = high = terms[-1]
    top = (1 << 31) - 1
    machine.pending[f"degree_{len(terms) - 1}"] = (low, high, 32)
    for degree in range(len(terms) - 2, -1, -1):
        low = ((min(low * top, 0) + (1 << 30)) >> 31) + terms[degree]
        high = ((max(high * top, 0) + (1 << 30)) >> 31) + terms[degree]
        machine.pending[f"degree_{degree}"] = (low, high, 32)


def _exp2(machine: IntervalMachine, t: Value, octave_of_top: Value) -> Value:
    """Rises with t, since no coefficient of the octave is negative and 2^1 continues at 2^0."""
    octave, top = machine.tables["zd_exp2_octave_q29"], number(octave_of_top, -128, 127, "top")
    if min(octave) < 0 or sum(octave) > 1 << 30 or t.high >> 24 > top:
        raise FaultError(f"2^t for t up to {t.high} is not bounded by octave {top}")
    machine.pending["exponent"] = (t.low, t.high, 32)
    _polynomial(machine, octave)
    ends = []
    for end in (t.low, t.high):
        mantissa, f = octave[-1], (end & 0xFFFFFF) << 7
        for c in reversed(octave[:-1]):
            mantissa = c + ((mantissa * f + (1 << 30)) >> 31)
        shift = min(top + 2 - (end >> 24), 31)
        ends.append((mantissa + (1 << (shift - 1))) >> shift)
    return Value(ends[0], ends[1])


def _power(machine: IntervalMachine, power: Struct, x: Value) -> Value:
    octave, gains = (machine.table_of(power, name) for name in ("octave", "gains"))
    low, high, terms, shift = (
        power.fields[name].value(0).low for name in ("low", "high", "terms", "shift")
    )
    octaves = max(x.high, 1).bit_length() - 1
    if octaves >= len(gains) or min(gains) < 0 or not 0 <= low <= high or shift > 62:
        raise FaultError(f"x^p: x reaches octave {octaves}, the table has {len(gains)}")
    if not 1 <= terms <= len(octave):
        raise FaultError(f"x^p: {terms} terms of a polynomial of {len(octave)}")
    _polynomial(machine, octave[:terms])
    product = high * max(gains[: octaves + 1]) + (1 << shift >> 1)
    machine.pending |= {
        "octaves": (0, len(gains), 6),
        "mantissa": (low, high, 32),
        "gain": (0, max(gains), 32),
        "product": (0, product, 64),
    }
    shift_right(machine, x, Value(shift, shift), 62)
    return machine.convert(Value(0, product >> shift, "int64_t"), "int32_t")


def _dot(machine: IntervalMachine, weights: Pointer, x: Pointer, count: Value) -> Value:
    n = number(count, 0, TYPES["uint32_t"][1], "the length")
    machine.row_of = weights.block.name.removeprefix("b->").removesuffix("_weights")
    if not weights.block.constant:
        raise FaultError(f"{weights.block.name} is no table of weights")
    terms = list(zip(weights.values(n), x.values(n), strict=True))
    ends = [sorted(a * b for a in (w.low, w.high) for b in (v.low, v.high)) for w, v in terms]
    reach = sum(w.reach * v.reach for w, v in terms)
    norm = machine.find_norm(weights, n)
    if norm is not None and norm * max(v.reach for _, v in terms) < reach:
        reach = norm * max(v.reach for _, v in terms)
        machine.convert(Value(-reach, reach, "int64_t"), "int32_t")
        return Value(-reach, reach, "int32_t", reach)
    total = Value(sum(e[0] for e in ends), sum(e[-1] for e in ends), "int64_t", reach)
    machine.convert(Value(-reach, reach, "int64_t"), "int32_t")  # in any order
    return machine.convert(total, "int32_t")


def _lowpass_rest(machine: IntervalMachine, x: Value, c: Value) -> Value:
    share = _share_left(c)
    return machine.combine("*", replace(x, type="int64_t"), share)


def _share_left(c: Value) -> Value:
    """Return 1 - c in 2^-24, for any c from 0 to 1."""
    one = 1 << 24
    if not 0 <= c.low <= c.high <= one:
        raise FaultError(f"c in 2^-24 is {c.low} .. {c.high}; 0 .. {one} is allowed")
    return Value(one - c.high, one - c.low, "int64_t")


def _lowpass(
    machine: IntervalMachine, place: Pointer, x: Value, c_q24: Value, m_q31: Value, by: Value
) -> Value:
    """v tends into (1 - c) x and a margin: a step forgets the share a of how far it is outside and
    adds 2^21 a + 1/2, so that it stays where it is inside and comes nearer where it is not, also in
    the range of all blocks' c, of which a block's own is a part."""
    one = 1 << 24
    share, shift = _share_left(c_q24), number(by, 0, 62, "the shift")
    a_one = 1 << (shift + 22)
    most = min(a_one, (1 << 31) - 1)
    if not 1 <= m_q31.low <= m_q31.high <= most:
        raise FaultError(f"a in 2^-31 is {m_q31.low} .. {m_q31.high}; 1 .. {most} is allowed")
    v, name = _state_cell(place), machine.name_of(place.block).removesuffix(".v")
    margin = (1 << 21) + -(-a_one // m_q31.low)
    ends = [s * end for s in (share.low, share.high) for end in (x.low, x.high)]
    low, high = min(ends) - margin, max(ends) + margin
    passed = [c * end for c in (c_q24.low, c_q24.high) for end in (x.low, x.high)]
    y = Value(v.low + min(passed), v.high + max(passed), "int64_t")
    gap = Value((one * x.low - y.high + (1 << 21)) >> 22, (one * x.high - y.low + (1 << 21)) >> 22)
    half = 1 << shift >> 1
    scaled = [g * m for g in (gap.low, gap.high) for m in (m_q31.low, m_q31.high)]
    machine.note(f"{name}.y", y.low, y.high, 64)
    machine.note(f"{name}.gap", gap.low, gap.high, 32)
    machine.note(f"{name}.scaled", min(scaled), max(scaled) + half, 64)
    place.fill([machine.convert(Value(min(v.low, low), max(v.high, high), "int64_t"), "int64_t")])
    out = Value((y.low + (1 << 23)) >> 24, (y.high + (1 << 23)) >> 24, "int64_t")
    shift_right(machine, out, by, 62)
    return machine.convert(out, "int32_t")


def _copy_state(machine: IntervalMachine, h: Pointer, copy: Pointer, count: Value) -> None:
    n = number(count, 0, TYPES["uint32_t"][1], "the length")
    copy.hold(n)
    half, most = 1 << 14, TYPES["int32_t"][1]
    cells = []
    for v in h.values(n):
        if v.high + half > most:
            machine.fail(f"a state of {v.high} and 1/2 does not fit int32_t")
        cells.append(Value((v.low + half) >> 15, (v.high + half) >> 15))
    copy.fill([machine.convert(v, "int16_t") for v in cells])


def _crc(machine: IntervalMachine, crc: Value, values: Pointer, count: Value) -> Value:
    """Over each number as a word of 32 bits, where all are known."""
    found = values.values(number(count, 0, TYPES["uint32_t"][1], "the length"))
    if crc.exact is None or any(v.exact is None for v in found):
        return anything("uint32_t")
    words = b"".join((v.low & 0xFFFFFFFF).to_bytes(4, "little") for v in found)
    after = zlib.crc32(words, crc.exact)
    return Value(after, after, "uint32_t")


def _crc_word(machine: IntervalMachine, crc: Value, word: Value) -> Value:
    if crc.exact is None or word.exact is None:
        return anything("uint32_t")
    after = zlib.crc32(word.low.to_bytes(4, "little"), crc.exact)
    return Value(after, after, "uint32_t")


def _bytes_of(machine: IntervalMachine, state: Found, written: bool) -> Struct:
    own = f"{machine.prefix}_state_t"
    if not isinstance(state, Address) or not state.bytes or state.struct.type != own:
        raise FaultError("what is saved or restored is not the bytes of the state")
    if written and state.constant:
        raise FaultError("a constant state is restored")
    return state.struct


def _hold_saved(
    machine: IntervalMachine, saved: Found, struct: Struct, size: Found, identity: Found
) -> None:
    own = machine.size_of(struct.type)
    wide = check_number(machine, "uint32_t", size)
    if wide.exact != own:
        raise FaultError(f"{wide.low} .. {wide.high} bytes of a state that has {own}")
    check_row("const uint8_t *", saved).hold(own + SAVED_EXTRA)
    if check_number(machine, "uint32_t", identity).exact != machine.guard.identity:
        raise FaultError("a state is saved or restored as another model's")


def _save(
    machine: IntervalMachine, saved: Found, state: Found, size: Found, identity: Found
) -> None:
    struct = _bytes_of(machine, state, written=False)
    _hold_saved(machine, saved, struct, size, identity)
    target = check_row("uint8_t *", saved)
    target.fill([anything("uint8_t")] * (machine.size_of(struct.type) + SAVED_EXTRA))


def _restore(
    machine: IntervalMachine, state: Found, saved: Found, size: Found, identity: Found
) -> Value:
    """0: the state holds any bits, those of the copy; otherwise it is as it was."""
    struct = _bytes_of(machine, state, written=True)
    _hold_saved(machine, saved, struct, size, identity)
    if machine.choose(2):
        return Value(1, TYPES["uint32_t"][1], "uint32_t")
    for block in struct.fields.values():
        Pointer(block, Value(0, 0), (block.count,)).fill([anything(block.type)] * block.count)
    machine.give(struct)
    return Value(0, 0, "uint32_t")


def _observe(machine: IntervalMachine, values: Found, count: Found) -> None:
    """What the test harness reads; nothing on a chip."""
    n = number(machine.as_number(count), 0, TYPES["uint32_t"][1], "the length")
    if not isinstance(values, Pointer):
        raise FaultError("no numbers are observed")
    values.values(n)


def _size(of: Callable[..., int]) -> Rule:
    """A macro that is the size of an array, in unsigned numbers."""

    def rule(machine: IntervalMachine, *given: Found) -> Value:
        sizes = [machine.as_number(one) for one in given]
        n = of(machine, *(number(v, 0, 1 << 16, "a size") for v in sizes))
        return Value(n, n, machine.common(machine.unsigned, sizes[0].type))

    return rule


GRU = "uint32_t, uint32_t, const int16_t *, int32_t *"
RULES: dict[str, Rule] = {
    "zd_clamp32": typed("int32_t, int32_t, int32_t", _clamp, "int32_t"),
    "zd_clamp64": typed("int64_t, int64_t, int64_t", _clamp_wide, "int64_t"),
    "zd_asr32": typed(
        "int32_t, uint32_t", lambda machine, x, s: shift_right(machine, x, s, 31), "int32_t"
    ),
    "zd_asr64": typed("int64_t, uint32_t", _shift_sum, "int64_t"),
    "zd_tanh_q30": typed(
        "int32_t", lambda machine, t: Value(-machine.tanh_max, machine.tanh_max), "int32_t"
    ),
    "zd_round_shift64": typed("int64_t, uint32_t", _round_shift, "int64_t"),
    "zd_load": typed("int32_t, int32_t, int32_t, int32_t", _load, "int32_t"),
    "zd_play": typed("int32_t *, int32_t, int32_t", _play, "int32_t"),
    "zd_count_from": typed(
        "int32_t *, int32_t *, int32_t *, const int32_t *, uint32_t", _count_from, "uint32_t"
    ),
    "zd_between": typed("int32_t, int32_t, int32_t", _between, "int32_t"),
    "zd_exp2": typed("int32_t, int32_t", _exp2, "int32_t"),
    "zd_power": typed("&zd_power_t, int32_t", _power, "int32_t"),
    "zd_dot_i16": typed("const int16_t *, const int16_t *, uint32_t", _dot, "int32_t"),
    "zd_lowpass_rest": typed("int32_t, int32_t", _lowpass_rest, "int64_t"),
    "zd_lowpass": typed("int64_t *, int32_t, int32_t, int32_t, uint32_t", _lowpass, "int32_t"),
    "zd_add_span": typed("int64_t, uint64_t", add_span, "int64_t"),
    "zd_draw_time": typed("uint32_t", draw_time, "uint64_t"),
    "zd_is_fast": typed("int32_t, int32_t, int32_t, int64_t, uint32_t", is_fast, "uint32_t"),
    "zd_add_time": typed("int64_t *, int64_t, int32_t, uint32_t", add_time, "int32_t"),
    "zd_lowpass_after": typed(
        "int32_t *, int32_t *, int64_t *, int32_t, int64_t, int32_t, uint32_t",
        lowpass_after,
        "int32_t",
    ),
    "zd_gru_copy_state": typed("const int32_t *, int16_t *, uint32_t", _copy_state),
    "zd_gru_step_after": typed(
        f"&zd_gru_t, {GRU}, int16_t *, int32_t",
        portable(after=True),
    ),
    "zd_gru_step_before": typed(
        f"&zd_gru_t, {GRU}, int16_t *, int16_t *, int32_t",
        portable(after=False),
    ),
    "zd_gru_step_pairs": typed(
        f"&zd_gru_pairs_t, {GRU}, int32_t *, int32_t",
        packed(PAIRS),
    ),
    "zd_gru_step_columns": typed(
        f"&zd_gru_columns_t, {GRU}, int32_t *, int32_t *, int32_t",
        packed(COLUMNS),
    ),
    "zd_gru_step_rows": typed(
        f"&zd_gru_rows_t, {GRU}, int16_t *, int32_t",
        packed(ROWS),
    ),
    "zd_gru_step_rows_before": typed(
        f"&zd_gru_rows_t, {GRU}, int16_t *, int32_t *, int32_t",
        packed(ROWS_BEFORE),
    ),
    "zd_lstm_step": typed(
        f"&zd_lstm_t, {GRU}, int32_t *, int16_t *, uint32_t",
        run_lstm,
    ),
    "zd_lstm_step_rows": typed(
        f"&zd_lstm_rows_t, {GRU}, int32_t *, int16_t *, uint32_t",
        run_lstm_rows,
    ),
    "zd_layer_norm": typed("&zd_layer_norm_t, const int16_t *, int32_t *, uint32_t", normalise),
    "zd_crc32_i16": typed("uint32_t, const int16_t *, uint32_t", _crc, "uint32_t"),
    "zd_crc32_i32": typed("uint32_t, const int32_t *, uint32_t", _crc, "uint32_t"),
    "zd_crc32_word": typed("uint32_t, uint32_t", _crc_word, "uint32_t"),
    "zd_tables_are_sound": typed("", lambda machine: Value(1, 1), "uint32_t"),
    "zd_tanh_is_sound": typed("", lambda machine: Value(1, 1), "uint32_t"),
    "zd_gates_are_sound": typed("", lambda machine: Value(1, 1), "uint32_t"),
    "zd_exp2_is_sound": typed("", lambda machine: Value(1, 1), "uint32_t"),
    "zd_save": _save,
    "zd_restore": _restore,
    "ZD_OBSERVE": _observe,
    "ZD_QUIET": lambda machine, on: None,
    # what scratch arrays are declared by
    "ZD_PAIR_SCRATCH": _size(lambda m, i, h: m.per_pair * ((i + 1) // 2 + (h + 1) // 2)),
    "ZD_ROW_VECTORS": _size(lambda m, n: (n + 7) // 8),
    "ZD_ROW_UNITS": _size(lambda m, h: (h + 3) // 4 * 4),
    "ZD_COLUMN_UNITS": _size(lambda m, h: (h + 7) // 8 * 8),
    "ZD_COLUMN_PAIRS": _size(lambda m, i, h: (i + 1) // 2 + (h + 7) // 8 * 4),
}
STRUCTS: dict[str, tuple[tuple[str, str, int], ...]] = {
    "zd_gru_t": (
        ("w_x", "const int16_t *", 0),
        ("w_h16", "const int16_t *", 0),
        ("w_h8", "const int8_t *", 0),
        ("multiplier", "const int32_t *", 0),
        ("bias", "const int32_t *", 0),
        ("shift", "uint8_t", 3),
        ("multiplier_shift", "uint8_t", 3),
    ),
    "zd_lstm_t": (
        ("w_x", "const int16_t *", 0),
        ("w_h16", "const int16_t *", 0),
        ("w_h8", "const int8_t *", 0),
        ("multiplier", "const int32_t *", 0),
        ("bias", "const int32_t *", 0),
        ("shift", "uint8_t", 4),
        ("multiplier_shift", "uint8_t", 4),
        ("cell_bits", "uint8_t", 0),
    ),
    "zd_gru_pairs_t": (("stream", "const int32_t *", 0), ("shift", "uint8_t", 3)),
    "zd_lstm_pairs_t": (
        ("stream", "const int32_t *", 0),
        ("shift", "uint8_t", 4),
        ("cell_bits", "uint8_t", 0),
    ),
    "zd_lstm_bytes_t": (
        ("stream", "const int32_t *", 0),
        ("shift", "uint8_t", 4),
        ("multiplier_shift", "uint8_t", 4),
        ("cell_bits", "uint8_t", 0),
    ),
    "zd_gru_before_t": (("stream", "const int32_t *", 0), ("shift", "uint8_t", 3)),
    "zd_gru_bytes_t": (
        ("stream", "const int32_t *", 0),
        ("shift", "uint8_t", 3),
        ("multiplier_shift", "uint8_t", 3),
    ),
    "zd_gru_columns_t": (("stream", "const int32_t *", 0), ("shift", "uint8_t", 3)),
    "zd_gru_rows_t": (
        ("weights", "const int16_t *", 0),
        ("bytes", "const int8_t *", 0),
        ("bias", "const int32_t *", 0),
        ("multiplier", "const int32_t *", 0),
        ("shift", "uint8_t", 3),
        ("multiplier_shift", "uint8_t", 3),
    ),
    "zd_lstm_rows_t": (
        ("weights", "const int16_t *", 0),
        ("bytes", "const int8_t *", 0),
        ("bias", "const int32_t *", 0),
        ("multiplier", "const int32_t *", 0),
        ("shift", "uint8_t", 4),
        ("multiplier_shift", "uint8_t", 4),
        ("cell_bits", "uint8_t", 0),
    ),
    "zd_layer_norm_t": (
        ("align", "const uint8_t *", 0),
        ("gain", "const int32_t *", 0),
        ("shift", "const uint8_t *", 0),
        ("bias", "const int32_t *", 0),
        ("epsilon", "int64_t", 0),
        ("reciprocal", "int32_t", 0),
        ("root", "int32_t", 0),
        ("mean_shift", "uint8_t", 0),
    ),
    "zd_power_t": (
        ("octave", "const int32_t *", 0),
        ("gains", "const int32_t *", 0),
        ("low", "int32_t", 0),
        ("high", "int32_t", 0),
        ("terms", "uint8_t", 0),
        ("shift", "uint8_t", 0),
    ),
}
"""The runtime's structs: fields, their types, and how many of them; 0: a single one."""
