"""Bounds on the error of integer against real arithmetic, by cause; shared by every error rule.

A signal's integer q represents the number q scale + offset. A rule bounds its distance from the
result of exact arithmetic with the unrounded parameters. All numbers are fractions; what cannot be
exact is rounded up.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.intervals import enclose_exp2, enclose_power, furthest, shorten
from zerodrift.operations.signals import Real, Signal

ZERO = Fraction(0)
HALF = Fraction(1, 2)


@dataclass(frozen=True)
class Error:
    """The largest distance from real arithmetic in a signal's unit, as the sum of its causes."""

    table: Fraction = ZERO
    """Activation tables, and the polynomials of exp2 and powers."""
    coefficients: Fraction = ZERO
    """Numbers of the model that are rounded to integers: gains, offsets, limits, slacks."""
    rounding: Fraction = ZERO
    """Results of sums, products, powers and copies, each rounded once."""
    lowpass: Fraction = ZERO
    """Low-pass filters: every step's rounding over all time, and their coefficients."""
    weights: Fraction = ZERO
    """Weights and biases of the network's layers."""
    output: Fraction = ZERO
    """The answer, rounded to a count of the output."""
    conversion: Fraction = ZERO
    """Raw codes that a table brings to the quantity."""
    range: Fraction = ZERO
    """States of a recurrent layer of which no more is shown than where they lie."""

    @cached_property
    def total(self) -> Fraction:
        """The bound."""
        return sum(filter(None, self.parts()), ZERO)

    def parts(self) -> tuple[Fraction, ...]:
        """Return the causes in their order."""
        return tuple(getattr(self, name) for name in CAUSES)

    def __add__(self, other: "Error") -> "Error":
        both = zip(self.parts(), other.parts(), strict=True)
        return _shortened(a + b if a and b else a or b for a, b in both)

    def scale(self, gain: Fraction) -> "Error":
        """Return the error of something that moves by at most `gain` >= 0 times as much."""
        return _shortened(part and part * gain for part in self.parts())

    def covers(self, other: "Error") -> bool:
        """Return whether no cause of another error is larger than here."""
        return all(a >= b for a, b in zip(self.parts(), other.parts(), strict=True))


CAUSES = tuple(f.name for f in fields(Error))
NONE = Error()


def _shortened(parts: Iterable[Fraction]) -> Error:
    return Error(*map(shorten, parts))


def larger(errors: Sequence[Error]) -> Error:
    """Return the error with the largest total: of something that is never worse than the worst."""
    return max(errors, key=lambda error: error.total)


@dataclass(frozen=True)
class Known:
    """What is known of a signal: its integers' range, what they stand for, and the error so far."""

    low: int
    high: int
    scale: Fraction
    offset: Fraction
    error: Error = NONE

    @property
    def ends(self) -> tuple[Fraction, Fraction]:
        """The lowest and highest value that the integers stand for."""
        ends = (self.low * self.scale + self.offset, self.high * self.scale + self.offset)
        return min(ends), max(ends)

    @property
    def magnitude(self) -> Fraction:
        """The largest absolute value that the integers stand for."""
        return max(map(abs, self.ends))


@dataclass(frozen=True)
class SumTerm:
    """One term of a sum in real arithmetic: gain times a signal."""

    gain: Fraction
    node: tuple[str, int]
    """Of the integers that the signal is read from; an empty name is a constant."""
    known: Known


def list_terms(real: Real, known: Sequence[Known]) -> list[SumTerm]:
    """Return the terms of a `linear`, or the one of what is the `same`."""
    gains = real.numbers if real.operation == "linear" else (1.0,)
    return [
        SumTerm(Fraction(gain), (signal.node, signal.index), of)
        for gain, signal, of in zip(gains, real.inputs, known, strict=True)
    ]


def gather(
    names: Iterable[str], coefficients: Iterable[int], unit: Fraction
) -> dict[tuple[str, int], Fraction]:
    """Return what one count of each node adds to a sum on the chip."""
    chip: dict[tuple[str, int], Fraction] = {}
    for name, coefficient in zip(names, coefficients, strict=True):
        chip[name, 0] = chip.get((name, 0), ZERO) + coefficient * unit
    return chip


def copy_known(x: Known, shift: int) -> Known:
    """Return what is known of round_shift(q, shift) of a signal's integers."""
    half = 1 << shift >> 1
    rounded = Error(rounding=abs(x.scale) * half)
    return Known(
        (x.low + half) >> shift,
        (x.high + half) >> shift,
        x.scale * (1 << shift),
        x.offset,
        x.error + rounded,
    )


def bound_sum(
    terms: Sequence[SumTerm],
    chip: Mapping[tuple[str, int], Fraction],
    constant: Fraction,
    cause: str,
) -> Error:
    """Return how far a sum on the chip, before it is rounded, is from that of real arithmetic.

    Args:
        terms: of real arithmetic.
        chip: per node what one count of it adds on the chip, in the result's unit.
        constant: what the chip adds, less what the result's zero stands for.
        cause: that the rounded coefficients count as.

    The difference is sum (chip - gain scale) q + constant - sum gain offset, whose q lie in known
    ranges, and sum gain (value - real value), whose terms are the signals' errors.
    """
    gaps = dict(chip)
    ranges: dict[tuple[str, int], Known] = {}
    error = NONE
    for term in terms:
        error += term.known.error.scale(abs(term.gain))
        constant -= term.gain * term.known.offset
        if term.node[0]:
            gaps[term.node] = gaps.get(term.node, ZERO) - term.gain * term.known.scale
            ranges[term.node] = term.known
    low = high = constant
    for node, gap in gaps.items():
        if gap == 0:
            continue
        if node not in ranges:
            raise NoRuleError(f"{node[0]}: a term of the sum stands for nothing")
        ends = (gap * ranges[node].low, gap * ranges[node].high)
        low, high = low + min(ends), high + max(ends)
    return error + Error(**{cause: shorten(max(abs(low), abs(high)))})


def require(condition: bool, what: str) -> None:
    """Raise NoRuleError where a rule does not apply."""
    if not condition:
        raise NoRuleError(what)


def bound_in_place(signal: Signal, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
    """Return the error of a signal that is its input's integers with another meaning, or constant.

    Raises:
        NoRuleError: the operation has no rule without a node of its own.
    """
    if real.operation in ("linear", "same"):
        place = {(signal.node, signal.index): out.scale} if signal.node else {}
        return bound_sum(list_terms(real, inputs), place, out.offset, "coefficients")
    if real.operation in ("maximum", "minimum") and real.inputs[0] == real.inputs[1]:
        return larger([x.error + _bound_gap(out, x) for x in inputs])
    if real.operation == "delay":
        (x,) = inputs
        delay_s, period_s = map(Fraction, real.numbers)
        steps = max(delay_s, ZERO) / period_s
        return x.error + Error(coefficients=steps * (x.high - x.low) * abs(x.scale))
    if real.operation == "product" and not all(s.node for s in real.inputs):
        return _bound_multiple(real, out, inputs)
    if real.operation in ("clip", "maximum", "minimum"):
        return bound_limit(real, out, inputs)
    if real.operation in ("exp2", "power") and not signal.node:
        return _bound_constant(real, out, inputs[0])
    raise NoRuleError(f"{real.operation}: no rule without a node of its own")


def _bound_gap(out: Known, x: Known) -> Error:
    """Return how far apart two meanings of the same integers are."""
    ends = [(out.scale - x.scale) * q + out.offset - x.offset for q in (x.low, x.high)]
    return Error(coefficients=shorten(max(map(abs, ends))))


def bound_limit(real: Real, out: Known, inputs: Sequence[Known]) -> Error:
    """Return the error of a signal that is limited by numbers, or by another that is constant."""
    if real.operation == "clip":
        return bound_held(real.numbers, out, inputs[0])
    x, limit = inputs if not real.inputs[1].node else reversed(inputs)
    end = float(limit.offset)  # which a constant's offset is
    ends = (end, math.inf) if real.operation == "maximum" else (-math.inf, end)
    return bound_held(ends, out, x) + limit.error


def bound_held(numbers: Sequence[float], out: Known, x: Known) -> Error:
    """Return the error of a signal limited to two numbers, by a node of its own or by nothing.

    |out - limit(real x)| <= |out - limit(value of x)| + |limit(value of x) - limit(real x)|; the
    last of them is at most x's error, since a limit brings numbers no further apart. The first one
    is largest at an end of x or of the limits, as out and limit(x) are both limits of x.
    """
    low, high = numbers
    tops, bottoms = sorted(x.ends), sorted(out.ends)

    def limit(value: Fraction) -> Fraction:
        value = value if value >= low else Fraction(low)
        return value if value <= high else Fraction(high)

    def chip(value: Fraction) -> Fraction:
        return min(max(value, bottoms[0]), bottoms[1])

    wanted = [value for value in (*tops, *bottoms) if tops[0] <= value <= tops[1]]
    wanted += [Fraction(end) for end in (low, high) if tops[0] <= end <= tops[1]]
    gap = max(abs(chip(value) - limit(value)) for value in wanted)
    return x.error + Error(coefficients=shorten(gap))


def _bound_multiple(real: Real, out: Known, inputs: Sequence[Known]) -> Error:
    """Return the error of a product with a constant: the moving one's integers at another scale."""
    a, b = inputs if real.inputs[1].node == "" else tuple(reversed(inputs))
    factor = b.offset
    ends = [out.scale * q + out.offset - (a.scale * q + a.offset) * factor for q in (a.low, a.high)]
    error = a.error.scale(abs(factor)) + b.error.scale(a.magnitude + a.error.total)
    return error + Error(coefficients=shorten(max(map(abs, ends))))


def _bound_constant(real: Real, out: Known, x: Known) -> Error:
    """Return the error of a power of a constant, which was computed in double precision."""
    reach = x.error.total
    ends = []
    for value in (x.offset - reach, x.offset + reach):
        if real.operation == "exp2":
            held = min(max(value, Fraction(-60)), Fraction(60))
            ends.append(furthest(out.offset, enclose_exp2(held)))
            continue
        exponent = Fraction(real.numbers[0])
        whole = round(exponent)
        if abs(exponent - whole) < Fraction(1, 10**12):
            steepest = whole * (abs(x.offset) + reach) ** max(whole - 1, 0)
            ends.append(abs(out.offset - x.offset**whole) + steepest * reach)
            continue
        ends.append(furthest(out.offset, enclose_power(max(value, ZERO), exponent)))
    return Error(coefficients=shorten(max(ends)))
