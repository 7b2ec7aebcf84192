"""What the runtime's functions do with intervals.

Written from docs/reference/integer-arithmetic.md, section 3. Shares no code with the generator and
needs the standard library only.
"""

from collections.abc import Callable
from typing import Any

from zerodrift.verify.c_gru import COLUMNS, PAIRS, ROWS, run_packed, run_portable, shift_right
from zerodrift.verify.c_intervals import Machine
from zerodrift.verify.c_reader import TYPES, Array, Value


def _clamp(machine: Machine, x: Value, low: Value, high: Value) -> Value:
    if x.type != "int64_t":  # an input, or a node of its own
        inputs = machine.code.structs[f"{machine.code.prefix}_input_t"]
        ends = (low.low, high.high, 32)
        machine.pending["code" if x.place in inputs else "limits"] = ends
    return _limit(x, low, high)


def _clamp_wide(machine: Machine, x: Value, low: Value, high: Value) -> Value:
    machine.note_plain_sum(x)
    return _limit(x, low, high)


def _limit(x: Value, low: Value, high: Value) -> Value:
    kind = "int64_t" if x.type == "int64_t" else "int32_t"
    return Value(min(max(x.low, low.low), high.low), min(max(x.high, low.high), high.high), kind)


def _shift_sum(machine: Machine, x: Value, shift: Value) -> Value:
    machine.pending["sum"] = (-x.reach, x.reach, 64)
    return shift_right(machine, x, shift, 63)


def _round_shift(machine: Machine, x: Value, shift: Value) -> Value:
    half = 1 << shift.low >> 1
    machine.convert(Value(x.low, x.high + half, "int64_t"), "int64_t")
    machine.pending["product"] = (x.low, x.high + half, 64)
    return shift_right(machine, Value(x.low + half, x.high + half, "int64_t"), shift, 62)


def _load(machine: Machine, measured: Value, drift: Value, low: Value, high: Value) -> Value:
    """Any int32 less any int32, limited."""
    del measured, drift
    machine.pending["difference"] = (1 - (1 << 32), (1 << 32) - 1, 64)
    machine.pending["limits"] = (low.low, high.high, 32)
    return Value(low.low, high.high)


def _play(machine: Machine, y: Value, x: Value, half_width: Value) -> Value:
    """y' lies between y and x, so a range of y that holds all x is never left."""
    if half_width.low < 0 or y.low > x.low or y.high < x.high:
        machine.fail(f"{y.place}: the state check must admit {x.low} .. {x.high}")
    machine.pending["slack"] = (x.low - half_width.low, x.high + half_width.low, 32)
    return Value(y.low, y.high)


def _between(machine: Machine, older: Value, newer: Value, share: Value) -> Value:
    if not 0 <= share.low <= (1 << 31) - 1:
        machine.fail(f"a share of {share.low} 2^-31")
    ends = (older.low - newer.high, newer.high - older.low)
    rise = max(abs(e) for e in ends) * share.low
    machine.pending["rise"] = (-rise, rise + (1 << 30), 64)
    return older.join(newer)


def _polynomial(machine: Machine, terms: list[int]) -> None:
    """Horner's rule for any share f of an octave, 0 <= f < 1."""
    low = high = terms[-1]
    top = (1 << 31) - 1
    machine.pending[f"degree_{len(terms) - 1}"] = (low, high, 32)
    for degree in range(len(terms) - 2, -1, -1):
        low = ((min(low * top, 0) + (1 << 30)) >> 31) + terms[degree]
        high = ((max(high * top, 0) + (1 << 30)) >> 31) + terms[degree]
        machine.pending[f"degree_{degree}"] = (low, high, 32)


def _exp2(machine: Machine, t: Value, top: Value) -> Value:
    """Rises with t, since no coefficient of the octave is negative and 2^1 continues at 2^0."""
    octave = machine.code.tables["zd_exp2_octave_q29"]
    if min(octave) < 0 or sum(octave) > 1 << 30 or t.high >> 24 > top.low:
        machine.fail(f"2^t for t up to {t.high} is not bounded by octave {top.low}")
    machine.pending["exponent"] = (t.low, t.high, 32)
    _polynomial(machine, octave)
    ends = []
    for end in (t.low, t.high):
        mantissa, f = octave[-1], (end & 0xFFFFFF) << 7
        for c in reversed(octave[:-1]):
            mantissa = c + ((mantissa * f + (1 << 30)) >> 31)
        shift = min(top.low + 2 - (end >> 24), 31)
        ends.append((mantissa + (1 << (shift - 1))) >> shift)
    return Value(ends[0], ends[1])


def _power(machine: Machine, power: Array, x: Value) -> Value:
    octave, gains = (
        [v.low for v in machine.code.constants[name].flat()] for name in power.cells[:2]
    )
    low, high, terms, shift = (v.low for v in power.cells[2:])
    octaves = max(x.high, 1).bit_length() - 1
    if octaves >= len(gains) or min(gains) < 0 or not 0 <= low <= high or terms != len(octave):
        machine.fail(f"x^p: x reaches octave {octaves}, the table has {len(gains)}")
        return Value(*TYPES["int32_t"])
    _polynomial(machine, octave)
    product = high * max(gains[: octaves + 1]) + (1 << shift >> 1)
    machine.pending |= {
        "octaves": (0, len(gains), 6),
        "mantissa": (low, high, 32),
        "gain": (0, max(gains), 32),
        "product": (0, product, 64),
    }
    shift_right(machine, x, power.cells[5], 62)
    return machine.convert(Value(0, product >> shift, "int64_t"), "int32_t")


def _dot(machine: Machine, weights: Array, x: Array, count: Value) -> Value:
    weights.hold(count.low)
    x.hold(count.low)
    machine.row_of = weights.place.removesuffix("_weights")
    terms = list(zip(weights.cells[: count.low], x.flat()[: count.low], strict=True))
    ends = [sorted((w.low * v.low, w.low * v.high)) for w, v in terms]
    reach = sum(abs(w.low) * v.reach for w, v in terms)
    total = Value(sum(e[0] for e in ends), sum(e[1] for e in ends), "int64_t", reach)
    return machine.convert(total, "int32_t")


def _lowpass_rest(machine: Machine, x: Value, c: Value) -> Value:
    share = Value((1 << 24) - c.low, (1 << 24) - c.low, "int64_t")
    return machine.combine("*", x, share)


def _lowpass(machine: Machine, v: Value, x: Value, c: Value, m: Value, shift: Value) -> Value:
    """v lies in (1 - c) x and a margin; a step forgets the share a of it and adds 2^21 a + 1/2."""
    name, one, a_one = v.place.rpartition("_")[0], 1 << 24, 1 << (shift.low + 22)
    if not (0 <= c.low <= one and 0 < m.low <= min(a_one, (1 << 31) - 1)):
        machine.fail(f"{name}: no low-pass: c = {c.low} / {one}, a = {m.low} / {a_one}")
    margin = (1 << 21) + -(-a_one // m.low)
    low, high = (one - c.low) * x.low - margin, (one - c.low) * x.high + margin
    if v.low > low or v.high < high:
        machine.fail(f"{name}: the state check must admit {low} .. {high}, where a step may lead")
    y = Value(v.low + c.low * x.low, v.high + c.low * x.high, "int64_t")
    gap = Value((one * x.low - y.high + (1 << 21)) >> 22, (one * x.high - y.low + (1 << 21)) >> 22)
    half = 1 << shift.low >> 1
    machine.note(f"{name}.y", y.low, y.high, 64)
    machine.note(f"{name}.gap", gap.low, gap.high, 32)
    machine.note(f"{name}.scaled", gap.low * m.low, gap.high * m.low + half, 64)
    out = Value((y.low + (1 << 23)) >> 24, (y.high + (1 << 23)) >> 24, "int64_t")
    shift_right(machine, out, shift, 62)
    return machine.convert(out, "int32_t")


def _copy_state(machine: Machine, h: Array, copy: Array, count: Value) -> None:
    h.hold(count.low)
    copy.hold(count.low)
    cells = [((v.low + (1 << 14)) >> 15, (v.high + (1 << 14)) >> 15) for v in h.flat()]
    copy.cells = [machine.convert(Value(*ends), "int16_t") for ends in cells[: count.low]]


def _plain(n: int) -> Value:
    return Value(n, n, "uint32_t")


RULES: dict[str, Callable[..., Any]] = {
    "zd_clamp32": _clamp,
    "zd_clamp64": _clamp_wide,
    "zd_asr32": lambda machine, x, s: shift_right(machine, x, s, 31),
    "zd_asr64": _shift_sum,
    "zd_tanh_q30": lambda machine, t: Value(-machine.tanh_max, machine.tanh_max),
    "zd_round_shift64": _round_shift,
    "zd_load": _load,
    "zd_play": _play,
    "zd_between": _between,
    "zd_exp2": _exp2,
    "zd_power": _power,
    "zd_dot_i16": _dot,
    "zd_lowpass_rest": _lowpass_rest,
    "zd_lowpass": _lowpass,
    "zd_gru_copy_state": _copy_state,
    "zd_gru_step_after": lambda machine, *given: run_portable(machine, True, *given),
    "zd_gru_step_before": lambda machine, *given: run_portable(machine, False, *given),
    "zd_gru_step_pairs": lambda machine, *given: run_packed(machine, PAIRS, *given),
    "zd_gru_step_columns": lambda machine, *given: run_packed(machine, COLUMNS, *given),
    "zd_gru_step_rows": lambda machine, *given: run_packed(machine, ROWS, *given),
    # what scratch arrays are declared by; the pairs kernel may take as many numbers twice as wide
    "ZD_PAIR_SCRATCH": lambda machine, i, h: _plain((i.low + 1) // 2 + (h.low + 1) // 2),
    "ZD_ROW_VECTORS": lambda machine, n: _plain((n.low + 7) // 8),
    "ZD_COLUMN_UNITS": lambda machine, h: _plain((h.low + 7) // 8 * 8),
    "ZD_COLUMN_PAIRS": lambda machine, i, h: _plain((i.low + 1) // 2 + (h.low + 7) // 8 * 4),
}
