"""What the runtime's functions of a variable step do with intervals (specification, 3.16, 5).

Shares no code with the generator and needs the standard library only.
"""

from zerodrift_proof.certificate.arguments import number
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.values import TYPES, FaultError, Pointer, Value, anything

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
