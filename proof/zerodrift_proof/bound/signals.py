"""The error bound's signals: as the certificate tells them, and of chip and float model.

The error bound in certificate.json as the checker reads it, by itself.

`check` walks the signals; these bound a step each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from zerodrift_proof.bound import numbers
from zerodrift_proof.certificate.values import NotUnderstoodError

Place = tuple[str, int]
"""A node of the C and an index in it."""


@dataclass(frozen=True)
class FloatLine:
    """A signal of the float model, and how the chip has it."""

    node: str
    index: int
    scale: Fraction
    offset: Fraction
    operation: str
    of: tuple[int, ...]
    numbers: tuple[Fraction | None, ...]

    @property
    def place(self) -> Place:
        """The integer that stands for it."""
        return self.node, self.index


@dataclass(frozen=True)
class ErrorClaim:
    """What is claimed of an output."""

    output: str
    counts_per_unit: int
    signal: int
    bound: Fraction


def read_bound(told: Mapping[str, object]) -> tuple[list[ErrorClaim], list[FloatLine]]:
    """Return the claims on the outputs, and the float model that they are about.

    Raises:
        KeyError, TypeError, ValueError: it is not built like a certificate.
    """
    claims = [_read_claim(row) for row in _rows(told, "error_bound")]
    return claims, [_read_line(row) for row in _rows(told, "float_model")]


def _rows(told: Mapping[str, object], key: str) -> list[Mapping[str, object]]:
    rows = told[key]
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise TypeError(f"{key} is no list")
    return rows


def _read_number(value: object) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is no number")
    return Fraction(value)


def _read_whole(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{value!r:.40} is no integer")
    return value


def _read_list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.40} is no list")
    return value


def _read_claim(row: Mapping[str, object]) -> ErrorClaim:
    per_unit = _read_whole(row["counts_per_unit"])
    if per_unit < 1:
        raise ValueError(f"{per_unit} counts per unit")
    return ErrorClaim(
        str(row["output"]), per_unit, _read_whole(row["signal"]), _read_number(row["bound"])
    )


def _read_line(row: Mapping[str, object]) -> FloatLine:
    return FloatLine(
        str(row["node"]),
        _read_whole(row["index"]),
        _read_number(row["scale"]),
        _read_number(row["offset"]),
        str(row["operation"]),
        tuple(map(_read_whole, _read_list(row["of"]))),
        tuple(None if x is None else _read_number(x) for x in _read_list(row["numbers"])),
    )


COPY = 15
"""Bits that an int16 copy of a value leaves off."""
DIGITS = 200
"""Bits that a fraction is shortened to, upwards."""


@dataclass(frozen=True)
class Has:
    """A signal: its integers' range and meaning, and how far that is from the float model."""

    line: FloatLine
    low: int
    high: int
    scale: Fraction
    error: Fraction

    def at(self, q: int) -> Fraction:
        """Return what an integer stands for."""
        return q * self.scale + self.line.offset

    @property
    def ends(self) -> tuple[Fraction, Fraction]:
        """The lowest and highest value."""
        low, high = sorted((self.at(self.low), self.at(self.high)))
        return low, high

    @property
    def size(self) -> Fraction:
        """The largest absolute value."""
        return max(map(abs, self.ends))


def bound_linear(
    gains: Sequence[Fraction],
    inputs: Sequence[Has],
    own: Mapping[Place, Fraction],
    constant: Fraction,
) -> Fraction:
    """Return how far own . q + constant can be from the sum of gains times real inputs."""
    total = Fraction(0)
    left = dict(own)
    ranges: dict[Place, Has] = {}
    for gain, x in zip(gains, inputs, strict=True):
        total += abs(gain) * x.error
        constant -= gain * x.line.offset
        if x.line.node:
            left[x.line.place] = left.get(x.line.place, Fraction(0)) - gain * x.scale
            ranges[x.line.place] = x
    low = high = constant
    for place, rest in left.items():
        if rest:
            if place not in ranges:
                raise NotUnderstoodError(f"{place[0]} is added and stands for nothing")
            ends = (rest * ranges[place].low, rest * ranges[place].high)
            low, high = low + min(ends), high + max(ends)
    return total + max(abs(low), abs(high))


def list_gains(line: FloatLine) -> list[Fraction]:
    """Return what each input of a linear line is multiplied by; others pass their input on."""
    return [expect(x) for x in line.numbers] if line.operation == "linear" else [Fraction(1)]


def bound_limited(line: FloatLine, chip: tuple[Fraction, Fraction], inputs: list[Has]) -> Fraction:
    """Return the error of an input limited to `chip`, in the float model to its own limits."""
    if line.operation == "clip":
        return inputs[0].error + bound_limits(line.numbers[:2], inputs[0].ends, chip)
    x, fixed = inputs if not inputs[1].line.node else (inputs[1], inputs[0])
    end = fixed.line.offset
    given = (end, None) if line.operation == "maximum" else (None, end)
    return x.error + fixed.error + bound_limits(given, x.ends, chip)


def bound_limits(
    given: Sequence[Fraction | None],
    reach: tuple[Fraction, Fraction],
    chip: tuple[Fraction, Fraction],
) -> Fraction:
    """Return how far two limits of one number can leave it apart; the second may be any two."""
    corners = [*reach]
    ends = [end for end in (*given, *chip) if end is not None]
    corners += [end for end in ends if reach[0] <= end <= reach[1]]

    def held(x: Fraction, low: Fraction | None, high: Fraction | None) -> Fraction:
        x = x if low is None else max(x, low)
        return x if high is None else min(x, high)

    return max(abs(held(x, *given) - held(x, *chip)) for x in corners)


def bound_constant_power(line: FloatLine, x: Has) -> Fraction:
    """Return how far a power of a constant, computed in floats, can be from the real one."""
    off = []
    for value in (x.line.offset - x.error, x.line.offset + x.error):
        if line.operation == "exp2":
            ends = numbers.exp2(min(max(value, Fraction(-60)), Fraction(60)))
        else:
            exponent = expect(line.numbers[0])
            whole = round(exponent)
            if abs(exponent - whole) < Fraction(1, 10**12):
                slope = whole * (abs(x.line.offset) + x.error) ** max(whole - 1, 0)
                return abs(line.offset - x.line.offset**whole) + slope * x.error
            ends = numbers.power(max(value, Fraction(0)), exponent)
        off += [abs(line.offset - end) for end in ends]
    return max(off)


def bound_power(x: Has, exponent: Fraction) -> Fraction:
    """Return how far apart powers of numbers are that are x.error apart."""
    e = x.error
    if not e:
        return e
    low, high = max(x.ends[0] - e, Fraction(0)), max(x.ends[1] + e, Fraction(0))
    found = []
    steep = low if exponent < 1 else high
    if steep > 0:
        inverse = numbers.power(steep, abs(exponent - 1))
        slope = inverse[1] if exponent > 1 else 1 / inverse[0]
        found.append(exponent * slope * e)
    elif exponent > 1:
        return Fraction(0)
    if exponent < 1:
        found.append(numbers.power(e, exponent)[1])
    return min(found)


def copy_short(x: Has) -> Has:
    """Return the int16 copy of a value with 15 more bits."""
    half = 1 << (COPY - 1)
    low, high = (x.low + half) >> COPY, (x.high + half) >> COPY
    return Has(x.line, low, high, x.scale * (1 << COPY), x.error + abs(x.scale) * half)


def reach_sum(weights: Sequence[int], inputs: Sequence[Has]) -> tuple[int, int]:
    """Return the lowest and highest weighted sum of integers."""
    pairs = [sorted((w * x.low, w * x.high)) for w, x in zip(weights, inputs, strict=True)]
    return sum(low for low, _ in pairs), sum(high for _, high in pairs)


def round_up(x: Fraction) -> Fraction:
    """Return x >= 0 or a little more."""
    surplus = x.numerator.bit_length() - x.denominator.bit_length() - DIGITS
    power = Fraction(2) ** surplus
    return -(-x // power) * power


def expect(x: Fraction | None) -> Fraction:
    """Return a number that has to be there.

    Raises:
        NotUnderstoodError: it is not.
    """
    if x is None:
        raise NotUnderstoodError("a number without an end")
    return x
