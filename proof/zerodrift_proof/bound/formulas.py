"""Sensors' formulas: as the certificate tells them, in decimal numbers.

The formulas of conversions in certificate.json as the checker reads them, by itself.

For the check of the error bound: what a raw code stands for, from the numbers that the certificate
states. Fifty digits are carried; `OPEN` is far above what they leave open. Shares no code with what
chose the chip's table and needs the standard library only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from itertools import pairwise

from zerodrift_proof.certificate.values import NotUnderstoodError


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
