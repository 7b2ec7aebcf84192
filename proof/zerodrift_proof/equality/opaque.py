"""Functions that stand for themselves: those of a variable step, and layer normalisations.

The functions of a variable step, which stand for themselves (specification, 3.16 and 5).

What the C of a model hands them and does with what they give is shown. That their own C, in
zd_signals.h, is the specification is tested bit by bit against the reference, not proven. The
numbers here are computed from the specification's text alone.

A layer normalisation, which stands for itself (integer-layers.md, section 4).

What the C of a model hands it, with which constants, and what it does with the results is shown.
That its own C, in zd_layer_norm.h, is the specification is tested bit by bit against the reference,
not proven. The numbers here are computed from the specification's text alone.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isqrt

from zerodrift_proof.equality.kernels import TermArithmetic
from zerodrift_proof.equality.machine import Rule, TermMachine
from zerodrift_proof.equality.memory import AddressOf, Found, Instance, Number, Spot
from zerodrift_proof.equality.rules import as_number, as_place, exact, list_numbers
from zerodrift_proof.equality.terms import Opaque, Terms, UndecidedError, Whole

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


def _put(machine: TermMachine, place: Spot, value: Whole) -> None:
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
        _put(machine, spot, value)
    return Number(moved.out, "int32_t")


def _run_time(machine: TermMachine, arguments: list[Found]) -> Found:
    place, span, limit, bits = arguments
    spot = as_place(place, "int64_t")
    own = machine.cells(spot, 1)[0]
    given = machine.convert(as_number(span), "int64_t").term
    after, ticks = say_time(machine.terms, own, given, exact(limit), exact(bits))
    _put(machine, spot, after)
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
