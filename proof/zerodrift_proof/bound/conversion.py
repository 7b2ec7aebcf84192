"""Bounds the distance of the chip's conversion of raw codes from its formula, for all real numbers.

For the check of the error bound: the table as the C has it (`bound_lookup`), the formula as the
certificate states it (`bound_formulas`). Each line of the table is held against the formula at the
ends of `CELLS` cells, between which both are within what the second derivative allows beside a
chord; a line of few codes at each of its codes. So no code is left out. Needs the standard library
only.
"""

import math
from collections.abc import Mapping, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import pairwise

from zerodrift_proof.bound.formulas import CONTEXT, EIGHT, ONE, OPEN, ZERO, SensorFormula
from zerodrift_proof.bound.lookup import FieldConversion, LookUp, read_conversions
from zerodrift_proof.bound.told import ToldConversion, read_told
from zerodrift_proof.certificate.values import NotUnderstoodError

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
