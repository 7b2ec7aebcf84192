"""The chip's conversion of raw codes: its table in the C, and its distance from the formula.

The tables by which the C converts raw codes, read out of its text for the error bound.

A statement that is not written as the generator writes it is refused, so that what stands here is
what the C computes.

For the check of the error bound: the table as the C has it, the formula as the
certificate states it. Each line of the table is held against the formula at the
ends of `CELLS` cells, between which both are within what the second derivative allows beside a
chord; a line of few codes at each of its codes. So no code is left out. Needs the standard library
only.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from itertools import pairwise

from zerodrift_proof.certificate.values import Block, NotUnderstoodError

# Sensors' formulas: as the certificate tells them, in decimal numbers.
#
# The formulas of conversions in certificate.json as the checker reads them, by itself.
#
# For the check of the error bound: what a raw code stands for, from the numbers that the
# certificate states. Fifty digits are carried; `OPEN` is far above what they leave open. Shares no
# code with what chose the chip's table and needs the standard library only.


@dataclass(frozen=True)
class ToldPiece:
    """A polynomial over a range, with a0 exp(a1 (t - a2)**2) beside it or not."""

    low: Decimal
    high: Decimal
    coefficients: tuple[Decimal, ...]
    bump: tuple[Decimal, ...]


@dataclass(frozen=True)
class ToldDivider:
    """A resistor in series with the sensor's."""

    series: Decimal
    counts: Decimal
    is_low: bool


@dataclass(frozen=True)
class ToldJunction:
    """What a code of a thermocouple's cold junction stands for."""

    input: str
    scale: Decimal
    offset: Decimal


@dataclass(frozen=True)
class ToldConversion:
    """What a raw code, or the sum with a junction's voltage, stands for."""

    input: str
    kind: str
    scale: Decimal
    offset: Decimal
    divider: ToldDivider | None = None
    points: tuple[tuple[Decimal, ...], ...] = ()
    coefficients: tuple[Decimal, ...] = ()
    pieces: tuple[ToldPiece, ...] = ()
    r25_ohm: Decimal = Decimal(0)
    beta_K: Decimal = Decimal(0)
    junction_degC: Decimal | None = None
    raw_scale: Decimal | None = None
    raw_offset: Decimal | None = None
    junction: ToldJunction | None = None


def read_told(told: object) -> dict[str, ToldConversion]:
    """Return input -> its formula, of the certificate's `conversions`.

    Raises:
        KeyError, TypeError, ValueError: it is not built like a certificate.
    """
    found = [_read_conversion(_read_object(row)) for row in _read_list(told or [])]
    return {one.input: one for one in found}


def _read_conversion(row: Mapping[str, object]) -> ToldConversion:
    def optional(key: str) -> Decimal | None:
        return None if row.get(key) is None else _read_number(row[key])

    divider, junction = row.get("divider"), row.get("junction")
    return ToldConversion(
        input=str(row["input"]),
        kind=str(row["kind"]),
        scale=_read_number(row["scale"]),
        offset=_read_number(row["offset"]),
        divider=None if divider is None else _read_divider(_read_object(divider)),
        points=tuple(_read_numbers(point) for point in _read_list(row.get("points", []))),
        coefficients=_read_numbers(row.get("coefficients", [])),
        pieces=tuple(_read_piece(_read_object(one)) for one in _read_list(row.get("pieces", []))),
        r25_ohm=optional("r25_ohm") or Decimal(0),
        beta_K=optional("beta_K") or Decimal(0),
        junction_degC=optional("junction_degC"),
        raw_scale=optional("raw_scale"),
        raw_offset=optional("raw_offset"),
        junction=None if junction is None else _read_junction(_read_object(junction)),
    )


def _read_divider(row: Mapping[str, object]) -> ToldDivider:
    ends = (_read_number(row["series_ohm"]), _read_number(row["counts"]))
    return ToldDivider(*ends, row["side"] == "low")


def _read_piece(row: Mapping[str, object]) -> ToldPiece:
    ends = (_read_number(row["low"]), _read_number(row["high"]))
    return ToldPiece(*ends, _read_numbers(row["coefficients"]), _read_numbers(row.get("bump", [])))


def _read_junction(row: Mapping[str, object]) -> ToldJunction:
    return ToldJunction(str(row["input"]), _read_number(row["scale"]), _read_number(row["offset"]))


def _read_number(value: object) -> Decimal:
    """Return a number of the certificate, exactly."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is no number")
    return Decimal(value)


def _read_numbers(value: object) -> tuple[Decimal, ...]:
    return tuple(map(_read_number, _read_list(value)))


def _read_list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.40} is no list")
    return value


def _read_object(value: object) -> Mapping[str, object]:
    if not isinstance(value, dict):
        raise TypeError(f"{value!r:.40} is no object")
    return value


CONTEXT = Context(prec=50, Emax=10**6, Emin=-(10**6))
OPEN = Decimal("1e-25")
"""What a result may be off by, in its unit and as a share: rounding of fifty digits, many times."""
ZERO, ONE, TWO, EIGHT = Decimal(0), Decimal(1), Decimal(2), Decimal(8)
KELVIN, T25_K = Decimal("273.15"), Decimal("298.15")
Number = Decimal


class NumberSpan:
    """An interval of real numbers, for the bound of a second derivative."""

    def __init__(self, low: Number, high: Number) -> None:
        """Hold the numbers from low to high."""
        self.low, self.high = low, high

    def __add__(self, other: "NumberSpan") -> "NumberSpan":
        """Return where sums lie."""
        return NumberSpan(self.low + other.low, self.high + other.high)

    def __neg__(self) -> "NumberSpan":
        """Return where the negatives lie."""
        return NumberSpan(-self.high, -self.low)

    def __mul__(self, other: "NumberSpan") -> "NumberSpan":
        """Return where products lie."""
        ends = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return NumberSpan(min(ends), max(ends))

    def inverse(self) -> "NumberSpan":
        """Return where the reciprocals lie."""
        if self.low <= 0 <= self.high:
            raise NotUnderstoodError("a formula divides by 0")
        return NumberSpan(ONE / self.high, ONE / self.low)

    @property
    def size(self) -> Number:
        """The largest absolute value."""
        return max(abs(self.low), abs(self.high))


def shift(coefficients: Sequence[Number], at: Number) -> list[Number]:
    """Return the coefficients of a polynomial in powers of t - at."""
    found = list(coefficients)
    for k in range(len(found)):
        for i in range(len(found) - 2, k - 1, -1):
            found[i] += at * found[i + 1]
    return found


def evaluate(coefficients: Sequence[Number], t: Number) -> Number:
    """Return a polynomial's value."""
    total = ZERO
    for c in reversed(coefficients):
        total = total * t + c
    return total


@dataclass(frozen=True)
class Piece:
    """A polynomial of temperature over a range, with a0 exp(a1 (t - a2)**2) beside it or not."""

    low: Number
    high: Number
    coefficients: tuple[Number, ...]
    bump: tuple[Number, ...]

    def at(self, t: Number) -> Number:
        """Return its value."""
        return evaluate(self.coefficients, t) + self._bump(t)

    def _bump(self, t: Number) -> Number:
        if not self.bump:
            return ZERO
        a0, a1, a2 = self.bump
        return a0 * CONTEXT.exp(a1 * (t - a2) ** 2)

    def bend(self, low: Number, high: Number) -> Number:
        """Return a bound of the second derivative's size."""
        middle, half = (low + high) / TWO, (high - low) / TWO
        found = shift(self.coefficients, middle)
        total = evaluate([k * (k - 1) * abs(c) for k, c in enumerate(found)][2:], half)
        if self.bump:
            a0, a1, a2 = self.bump
            furthest = max(abs(low - a2), abs(high - a2))
            nearest = ZERO if low <= a2 <= high else min(abs(low - a2), abs(high - a2))
            steep = TWO * abs(a1) + 4 * a1 * a1 * furthest * furthest
            total += abs(a0) * steep * CONTEXT.exp(a1 * nearest * nearest)
        return total

    def slope(self, t: Number) -> Number:
        """Return the derivative."""
        found = evaluate([k * c for k, c in enumerate(self.coefficients)][1:], t)
        if self.bump:
            _, a1, a2 = self.bump
            found += TWO * a1 * (t - a2) * self._bump(t)
        return found


class Pieces:
    """A function of temperature in pieces that meet."""

    def __init__(self, pieces: Sequence[Piece]) -> None:
        """Hold them in rising order."""
        self.pieces = tuple(pieces)
        for before, after in pairwise(pieces):
            if before.high != after.low:
                raise NotUnderstoodError("pieces of a formula that do not meet")

    def _find(self, t: Number) -> Piece:
        for piece in self.pieces:
            if t < piece.high:
                return piece
        return self.pieces[-1]

    def at(self, t: Number) -> Number:
        """Return its value; beyond its ends that of the last piece."""
        return self._find(t).at(t)

    def _within(self, low: Number, high: Number) -> list[tuple[Piece, Number, Number]]:
        last = len(self.pieces) - 1
        found = []
        for i, piece in enumerate(self.pieces):
            begin = low if i == 0 else max(low, piece.low)
            end = high if i == last else min(high, piece.high)
            if begin <= end:
                found.append((piece, begin, end))
        return found

    def bend(self, low: Number, high: Number) -> Number:
        """Return a bound of the second derivative's size, on every piece there."""
        return max(piece.bend(a, b) for piece, a, b in self._within(low, high))

    def kink(self, low: Number, high: Number, width: Number) -> Number:
        """Return how far joints add to the distance from a chord of some width at most."""
        total = ZERO
        for before, after in pairwise(self.pieces):
            t = before.high
            if low <= t <= high:
                total += abs(after.at(t) - before.at(t))
                total += abs(after.slope(t) - before.slope(t)) * width / 4
        return total

    def least_slope(self, low: Number, high: Number) -> Number:
        """Return a number below the derivative everywhere there."""
        found = []
        for piece, a, b in self._within(low, high):
            middle, half = (a + b) / TWO, (b - a) / TWO
            found.append(piece.slope(middle) - piece.bend(a, b) * half)
        return min(found)

    def slope(self, t: Number) -> Number:
        """Return the derivative."""
        return self._find(t).slope(t)


@dataclass(frozen=True)
class Divider:
    """A resistor in series with the sensor's."""

    series: Number
    counts: Number
    is_low: bool

    def at(self, u: Number) -> Number:
        """Return ohm."""
        ratio = u / (self.counts - u) if self.is_low else (self.counts - u) / u
        return self.series * ratio

    def slopes(self, u: NumberSpan) -> tuple[NumberSpan, NumberSpan]:
        """Return where first and second derivative lie."""
        top = NumberSpan(self.series * self.counts, self.series * self.counts)
        far = NumberSpan(self.counts, self.counts) + -u if self.is_low else u
        once = far.inverse()
        sign = NumberSpan(ONE, ONE) if self.is_low else NumberSpan(-ONE, -ONE)
        twice = once * once
        return sign * top * twice, NumberSpan(TWO, TWO) * top * twice * once


class SensorFormula:
    """What a number (a raw code, or a sum) stands for: scale, offset, divider, and a kind."""

    def __init__(self, told: ToldConversion) -> None:
        """Take what the certificate tells.

        Raises:
            NotUnderstoodError: an unknown kind.
        """
        self.scale, self.offset, self.kind = told.scale, told.offset, told.kind
        self.points, self.coefficients = told.points, told.coefficients
        self.divider = None
        if told.divider is not None:
            self.divider = Divider(told.divider.series, told.divider.counts, told.divider.is_low)
        self.pieces, self.times, self.added = None, ONE, ZERO
        if self.kind in ("inverse", "forward"):
            pieces = [Piece(p.low, p.high, p.coefficients, p.bump) for p in told.pieces]
            self.pieces = Pieces(pieces)
            if told.junction_degC is not None:
                self.added = self.pieces.at(told.junction_degC)
        if self.kind == "beta":
            beta = told.beta_K
            self.coefficients = (ONE / T25_K - CONTEXT.ln(told.r25_ohm) / beta, ONE / beta, ZERO)
            self.kind = "steinhart"
        if self.kind not in ("line", "steinhart", "table", "polynomial", "inverse", "forward"):
            raise NotUnderstoodError(f"a conversion by {self.kind}")

    def given(self, x: Number) -> Number:
        """Return what the kind is of: a value in its unit, ohm or V."""
        u = self.scale * x + self.offset
        return (self.divider.at(u) if self.divider else u) + self.added

    def _given_slopes(self, low: Number, high: Number) -> tuple[NumberSpan, NumberSpan]:
        """Return where the first and second derivative of `given` lie."""
        scale = NumberSpan(self.scale, self.scale)
        if self.divider is None:
            return scale, NumberSpan(ZERO, ZERO)
        ends = sorted(self.scale * x + self.offset for x in (low, high))
        first, second = self.divider.slopes(NumberSpan(ends[0], ends[1]))
        return first * scale, second * scale * scale

    def given_bend(self, low: Number, high: Number) -> Number:
        """Return a bound of the second derivative of `given`."""
        return self._given_slopes(low, high)[1].size

    def given_slope(self, low: Number, high: Number) -> Number:
        """Return a bound of the slope of `given`."""
        return self._given_slopes(low, high)[0].size

    def at(self, x: Number) -> Number:
        """Return the quantity, of a kind that states it."""
        u = self.given(x)
        if self.kind == "line":
            return u
        if self.kind == "polynomial":
            return evaluate(self.coefficients, u)
        if self.kind == "forward":
            assert self.pieces is not None
            return self.times * self.pieces.at(u)
        if self.kind == "table":
            return self._look_up(u)
        a, b, c = self.coefficients
        log = CONTEXT.ln(u)
        return ONE / (a + b * log + c * log**3) - KELVIN

    def _look_up(self, u: Number) -> Number:
        for (x0, y0), (x1, y1) in pairwise(self.points):
            if u <= x1:
                return y0 + (y1 - y0) * (u - x0) / (x1 - x0)
        return self.points[-1][1]

    def corners(self, low: Number, high: Number) -> list[Number]:
        """Return where between two numbers a table of points bends."""
        if self.kind != "table":
            return []
        places = ((x - self.offset) / self.scale for x, _ in self.points)
        return [place for place in places if low < place < high]

    def bend(self, low: Number, high: Number) -> Number:
        """Return a bound of the second derivative's size, of a kind that states the quantity."""
        if self.kind in ("line", "table"):
            return ZERO
        ends = sorted((self.given(low), self.given(high)))
        first, second = self._given_slopes(low, high)
        if self.kind == "polynomial":
            piece = Piece(ends[0], ends[1], self.coefficients, ())
            return piece.bend(*ends) * first.size**2
        if self.kind == "forward":
            assert self.pieces is not None
            return abs(self.times) * self.pieces.bend(*ends) * first.size**2
        return self._bend_steinhart(ends, first, second)

    def _bend_steinhart(
        self, ends: Sequence[Number], first: NumberSpan, second: NumberSpan
    ) -> Number:
        a, b, c = (NumberSpan(one, one) for one in self.coefficients)
        ohm = NumberSpan(ends[0], ends[1])
        log = NumberSpan(CONTEXT.ln(ends[0]), CONTEXT.ln(ends[1]))
        once = first * ohm.inverse()
        twice = second * ohm.inverse() + -(once * once)
        three, six = NumberSpan(Decimal(3), Decimal(3)), NumberSpan(Decimal(6), Decimal(6))
        steep = b + three * c * log * log
        w = a + b * log + c * log * log * log
        w_once = steep * once
        w_twice = six * c * log * once * once + steep * twice
        inverse = w.inverse()
        two = NumberSpan(TWO, TWO)
        bend = two * w_once * w_once * inverse * inverse * inverse
        return (bend + -(w_twice * inverse * inverse)).size

    def kink(self, low: Number, high: Number) -> Number:
        """Return what joints of pieces add over a cell."""
        if self.kind != "forward" or self.pieces is None:
            return ZERO
        ends = sorted((self.given(low), self.given(high)))
        return abs(self.times) * self.pieces.kink(ends[0], ends[1], ends[1] - ends[0])


# The chip's conversion of raw codes: its table in the C, and its distance from the formula.

NUMBER = r"(?:-? ?\d+|\( - 2147483647 - 1 \))"
LOOK_UP = (
    r"const int32_t {n}_code = zd_clamp32 \( (?P<given>[\w >-]+?) , (?P<low>N) , (?P<high>N) \) ; "
    r"const uint32_t {n}_place = \( uint32_t \) \( \( int64_t \) {n}_code - \( (?P<base>N) \) \) ; "
    r"const uint32_t {n}_block = {n}_place >> (?P<bits>\d+) ; "
    r"const int32_t {n}_parts = zd_clamp32 \( \( int32_t \) {n}_first \[ {n}_block \+ 1u \]"
    r" - {n}_first \[ {n}_block \] , 1 , (?P<most>\d+) \) ; "
    r"const uint32_t {n}_at = \( {n}_place & (?P<mask>\d+)u \) \* \( uint32_t \) {n}_parts ; "
    r"const int32_t {n}_line = zd_clamp32 \( {n}_first \[ {n}_block \]"
    r" \+ \( int32_t \) \( {n}_at >> (?P<bits2>\d+) \) , 0 , (?P<last>\d+) \) ; "
    r"const int32_t {n} = \( int32_t \) zd_clamp64 \( zd_asr64 \( INT64_C \( (?P<half>\d+) \)"
    r" \+ \( \( int64_t \) {n}_nodes \[ {n}_line \] \* INT64_C \( (?P<width>\d+) \) \)"
    r" \+ \( \( \( int64_t \) {n}_nodes \[ {n}_line \+ 1 \] - {n}_nodes \[ {n}_line \] \)"
    r" \* \( int64_t \) \( {n}_at & (?P<mask2>\d+)u \) \) , (?P<shift>\d+)u \) ,"
    r" (?P<lowest>N) , (?P<highest>N) \) ;"
).replace("N)", f"{NUMBER})")
SUM = (
    r"const int32_t {n}_sum = \( int32_t \) zd_clamp64 \( \( \( int64_t \) in -> {f} \* (\d+) \)"
    r" \+ (\w+) , \( - 2147483647 - 1 \) , 2147483647 \) ;"
)
PLAIN = r"now -> {f} = (?:\( int16_t \) )?(?:\( [^;?]+ \) \? N : )?\(?in -> {f}\)? ;".replace(
    "N", NUMBER
)
LOOKED_UP = (
    r"now -> {f} = (?:\( int16_t \) ?)?(?:\( )?(?:\( [^;?]+ \) \? N : )?(conversion_\w+)(?: \))? ;"
).replace("N", NUMBER)


@dataclass(frozen=True)
class LookUp:
    """A table: what its lines give over what is looked up, rounded to integers."""

    name: str
    low: int
    high: int
    """What is looked up is limited to these."""
    bits: int
    first: tuple[int, ...]
    nodes: tuple[int, ...]
    shift: int
    lowest: int
    highest: int


@dataclass(frozen=True)
class FieldConversion:
    """How a field of the inputs becomes the code that the model reads."""

    table: LookUp | None
    """None: the code is what is given."""
    junction: LookUp | None = None
    """Of a thermocouple's cold junction."""
    junction_field: str = ""
    factor: int = 1
    """Of the raw code in the sum with the junction's voltage."""


@dataclass(frozen=True)
class _LookUpNumbers:
    """The numbers that stand in a look-up; those that stand there twice have a 2 behind."""

    low: int
    high: int
    base: int
    bits: int
    bits2: int
    most: int
    mask: int
    mask2: int
    last: int
    half: int
    width: int
    shift: int
    lowest: int
    highest: int


def read_conversions(
    words: Sequence[str], prefix: str, constants: Mapping[str, object]
) -> dict[str, FieldConversion]:
    """Return field -> its conversion; empty where the model is given its codes as they are.

    Args:
        words: the tokens of the C.
        prefix: of the model.
        constants: name -> block of numbers.

    Raises:
        NotUnderstoodError: a statement that is written in another way.
    """
    text = " ".join(words)
    given = f"{prefix}_codes_t * now , const {prefix}_input_t * in"
    head = f"static void {prefix}_convert ( {given} ) {{ "
    begin = text.find(head)
    if begin < 0:
        if f" {prefix}_convert " in text:
            raise NotUnderstoodError("codes are converted in another way")
        return {}
    body = text[begin + len(head) : text.index(" }", begin + len(head)) + 1]
    found: dict[str, FieldConversion] = {}
    for field in re.findall(r"now -> (\w+) = ", body):
        found[field] = _read_field(body, field, constants)
    return found


def _read_field(body: str, field: str, constants: Mapping[str, object]) -> FieldConversion:
    if body.count(f"now -> {field} = ") != 1:
        raise NotUnderstoodError(f"{field} is converted twice")
    if re.search(PLAIN.format(f=field), body):
        return FieldConversion(None)
    at = re.search(LOOKED_UP.format(f=field), body)
    if at is None:
        raise NotUnderstoodError(f"{field} is converted in another way")
    name = at[1]
    given, table = _read_table(body, name, constants)
    if given == f"in -> {field}":
        return FieldConversion(table)
    summed = re.search(SUM.format(n=name, f=field), body)
    if given != f"{name}_sum" or summed is None:
        raise NotUnderstoodError(f"{name} looks up something else")
    cold, junction = _read_table(body, summed[2], constants)
    if not cold.startswith("now -> ") or body.index(f"{cold} = ") > body.index(f"{summed[2]}_code"):
        raise NotUnderstoodError(f"{name}: its cold junction is not converted before")
    return FieldConversion(table, junction, cold.removeprefix("now -> "), int(summed[1]))


def _read_table(body: str, name: str, constants: Mapping[str, object]) -> tuple[str, LookUp]:
    """Return what is looked up, and the table."""
    match = re.search(LOOK_UP.replace("{n}", name), body)
    if match is None or body.count(f"const int32_t {name} = ") != 1:
        raise NotUnderstoodError(f"{name} is looked up in another way")
    numbers = {key: _read(text) for key, text in match.groupdict().items() if key != "given"}
    told = _LookUpNumbers(**numbers)
    first, nodes = (_cells(constants, f"{name}_{part}") for part in ("first", "nodes"))
    bits, parts = told.bits, [after - before for before, after in pairwise(first)]
    blocks = (told.high - told.low >> bits) + 1
    sound = (
        told.base == told.low <= told.high
        and told.bits2 == bits <= 31
        and told.mask == told.mask2 == told.width - 1 == (1 << bits) - 1
        and told.half == 1 << told.shift >> 1
        and told.shift >= bits
        and len(first) == blocks + 1
        and first[0] == 0
        and min(parts) >= 1
        and max(parts) <= told.most
        and max(parts) << bits <= 1 << 32
        and first[-1] == told.last + 1 == len(nodes) - 1
    )
    if not sound:
        raise NotUnderstoodError(f"{name}: its numbers make no table")
    limits = (told.lowest, told.highest)
    table = LookUp(name, told.low, told.high, bits, first, nodes, told.shift, *limits)
    return match["given"], table


def _read(text: str) -> int:
    return -(2**31) if text.startswith("(") else int(text.replace(" ", ""))


def _cells(constants: Mapping[str, object], name: str) -> tuple[int, ...]:
    block = constants.get(name)
    if not isinstance(block, Block):
        raise NotUnderstoodError(f"no table {name}")
    cells = tuple(cell for cell in block.cells if isinstance(cell, int))
    if len(cells) != block.count:
        raise NotUnderstoodError(f"{name} is no table of numbers")
    return cells


CELLS = 24
HALF = Decimal("0.5")
FEW = 2 * CELLS
"""A line of fewer codes is gone through code by code."""
STEPS = 200
FAR = 8
"""Counts within which a formula's inverse is looked for around the chip's value."""


class ConversionCheck:
    """The errors of all fields of a model's inputs."""

    def __init__(
        self,
        told: object,
        words: Sequence[str],
        prefix: str,
        constants: Mapping[str, object],
    ) -> None:
        """Read what the C does, and what the certificate says that it stands for."""
        with localcontext(CONTEXT):
            self._formulas = read_told(told)
        self._fields = read_conversions(words, prefix, constants)
        self._known: dict[str, Fraction] = {}

    def bound(self, field: str, lsb: Fraction, offset: Fraction) -> Fraction:
        """Return how far the code of a field is from the exact quantity, in its unit.

        Args:
            field: of the C's input.
            lsb: one code, in the quantity's unit.
            offset: the quantity at code 0.
        """
        conversion = self._fields.get(field)
        if conversion is None or conversion.table is None:
            return Fraction(0)
        if field not in self._formulas:
            raise NotUnderstoodError(f"{field} is converted, and nothing says by what formula")
        if field not in self._known:
            with localcontext(CONTEXT):
                found = self._derive(field, conversion, _decimal(lsb), _decimal(offset))
            self._known[field] = Fraction(found) * (1 + Fraction(OPEN)) + Fraction(OPEN)
        return self._known[field]

    def _derive(
        self, field: str, conversion: FieldConversion, lsb: Decimal, offset: Decimal
    ) -> Decimal:
        assert conversion.table is not None
        told = self._formulas[field]
        formula, junction = SensorFormula(told), told.junction
        if (conversion.junction is None) != (junction is None):
            raise NotUnderstoodError(f"{field}: a cold junction that is not stated, or not there")
        error, steepest = _bound_table(conversion.table, formula, lsb, offset)
        if conversion.junction is None or junction is None:
            return error
        if junction.input != conversion.junction_field:
            raise NotUnderstoodError(f"{field}: its cold junction is another input")
        # the table is of sums, whose formula is stated: one raw code is `factor` of them
        worth = formula.scale * conversion.factor
        if told.raw_scale is None or abs(told.raw_scale - worth) > OPEN * abs(worth):
            raise NotUnderstoodError(f"{field}: a raw code is worth another voltage in the sum")
        if formula.offset != told.raw_offset or formula.added:
            raise NotUnderstoodError(f"{field}: its sum begins at another voltage")
        scales = (junction.scale, junction.offset)
        cold = SensorFormula(ToldConversion(junction.input, "forward", *scales, pieces=told.pieces))
        cold.times = ONE / formula.scale
        in_sum, steep = _bound_table(conversion.junction, cold, ONE, ZERO)
        own = self.bound(junction.input, Fraction(junction.scale), Fraction(junction.offset))
        in_sum += steep / abs(cold.scale) * _decimal(own)
        if in_sum * steepest > FAR * lsb:
            raise NotUnderstoodError(f"{field}: its cold junction is too coarse")
        return error + in_sum * steepest


def _decimal(x: Fraction) -> Decimal:
    return Decimal(x.numerator) / Decimal(x.denominator)


def _list_lines(table: LookUp) -> list[tuple[Decimal, Decimal, Decimal, Decimal]]:
    """Return (begin, end, value there, value there) of every line, in counts of the result."""
    width, unit = 1 << table.bits, Decimal(1 << (table.shift - table.bits))
    found = []
    for block in range(len(table.first) - 1):
        parts = table.first[block + 1] - table.first[block]
        for k in range(parts):
            i = table.first[block] + k
            begin = Decimal(table.low + block * width) + Decimal(k * width) / parts
            end = Decimal(table.low + block * width) + Decimal((k + 1) * width) / parts
            at = [Decimal(node) / unit for node in table.nodes[i : i + 2]]
            if begin > table.high:
                continue
            if end > table.high:  # beyond, nothing is looked up
                at[1] = at[0] + (at[1] - at[0]) * (table.high - begin) / (end - begin)
                end = Decimal(table.high)
            if end > begin or begin == table.high:
                found.append((begin, end, at[0], at[1]))
    return found


def _bound_table(
    table: LookUp, formula: SensorFormula, lsb: Decimal, offset: Decimal
) -> tuple[Decimal, Decimal]:
    """Return the largest error in the quantity's unit, rounding and limits included, and the
    formula's steepest slope, over all that is looked up.
    """
    worst = steepest = ZERO
    ends: list[Decimal] = []
    for begin, end, first, last in _list_lines(table):
        values = (first * lsb + offset, last * lsb + offset)
        if formula.kind == "inverse":
            error, slope, exact = _bound_inverse(formula, begin, end, values, lsb)
        else:
            error, slope, exact = _bound_direct(formula, begin, end, values)
        worst, steepest = max(worst, error), max(steepest, slope)
        ends += exact
    # q is limited to lowest .. highest; where these are within half a code of what the formula
    # reaches, a limit is no further off than rounding
    low, high = (one * lsb + offset for one in (table.lowest, table.highest))
    return max(worst + HALF * lsb, low - min(ends), max(ends) - high), steepest


def _bound_direct(
    formula: SensorFormula, begin: Decimal, end: Decimal, values: Sequence[Decimal]
) -> tuple[Decimal, Decimal, list[Decimal]]:
    """Return error, slope and reach over a line, of a formula that states the quantity."""
    cells = _Cells(begin, end, formula.corners(begin, end))
    exact = [formula.at(x) for x in cells.places]
    off = [abs(cells.follow(values, x) - y) for x, y in zip(cells.places, exact, strict=True)]
    bend = formula.bend(begin, end) if end > begin else ZERO
    worst, largest = max(off, default=ZERO), ZERO
    for k, width in enumerate(cells.widths):
        chord = bend * width * width / EIGHT + formula.kink(*cells.places[k : k + 2])
        worst = max(worst, off[k] + chord, off[k + 1] + chord)
        largest = max(largest, chord)
    slope = ZERO
    if end > begin:
        slope = abs(formula.at(end) - formula.at(begin)) / (end - begin) + bend * (end - begin)
    return worst, slope, [y + sign * largest for y in exact for sign in (1, -1)]


def _bound_inverse(
    formula: SensorFormula,
    begin: Decimal,
    end: Decimal,
    values: Sequence[Decimal],
    lsb: Decimal,
) -> tuple[Decimal, Decimal, list[Decimal]]:
    """Return as above, of a quantity whose function is stated, not its inverse.

    The chip's value t at x is off by |function(t) - given(x)| over the least slope around it.
    """
    function = formula.pieces
    assert function is not None
    cells = _Cells(begin, end, [])
    chip = [cells.follow(values, x) for x in cells.places]
    pairs = zip(cells.places, chip, strict=True)
    off = [abs(function.at(t) - formula.given(x)) for x, t in pairs]
    bend, given = function.bend(*sorted(values)), formula.given_bend(begin, end)

    def find_least(one: Decimal, other: Decimal) -> Decimal:
        low, high = sorted((one, other))
        least = function.least_slope(low - FAR * lsb, high + FAR * lsb)
        if least <= 0:
            raise NotUnderstoodError("a sensor's function that does not rise")
        return least

    if not cells.widths:  # code by code
        least = find_least(*values)
        error, slope = max(off, default=ZERO) / least, formula.given_slope(begin, end) / least
    else:
        error = slope = ZERO
    for k, width in enumerate(cells.widths):
        near = sorted(chip[k : k + 2])
        step, least = near[1] - near[0], find_least(*near)
        chord = (bend * step * step + given * width * width) / EIGHT
        chord += function.kink(near[0], near[1], step)
        error = max(error, (max(off[k : k + 2]) + chord) / least)
        slope = max(slope, formula.given_slope(*cells.places[k : k + 2]) / least)
    if error > FAR * lsb:
        raise NotUnderstoodError(f"a table that is off its function by {error:.3g}")
    ends = cells.places[:1] + cells.places[-1:]
    return error, slope, [_invert(formula, x, cells.follow(values, x)) for x in ends]


def _invert(formula: SensorFormula, x: Decimal, near: Decimal) -> Decimal:
    """Return the quantity at x, from the chip's value near it."""
    function, given = formula.pieces, formula.given(x)
    assert function is not None
    for _ in range(STEPS):
        off, slope = function.at(near) - given, function.slope(near)
        if abs(off) <= OPEN * slope:
            return near
        near -= off / slope
    raise NotUnderstoodError("a sensor's function that is not inverted")


class _Cells:
    """The places of a line at which it is held against the formula."""

    def __init__(self, begin: Decimal, end: Decimal, corners: Sequence[Decimal]) -> None:
        self._begin, self._span = begin, end - begin if end > begin else ONE
        first, last = math.ceil(begin), math.floor(end)
        if last - first < FEW:
            self.places = [Decimal(code) for code in range(first, last + 1)]
            self.widths: list[Decimal] = []
            """Of the cells; none where every code is a place."""
            return
        cells = [begin + (end - begin) * k / CELLS for k in range(CELLS + 1)]
        self.places = sorted({*cells, *corners})
        self.widths = [after - before for before, after in pairwise(self.places)]

    def follow(self, values: Sequence[Decimal], x: Decimal) -> Decimal:
        """Return what a line with values at both ends has at x."""
        return values[0] + (values[1] - values[0]) * (x - self._begin) / self._span
