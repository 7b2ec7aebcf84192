"""The chip's conversion of raw codes: its table in the C, and its distance from the formula.

The tables by which the C converts raw codes, read out of its text for the error bound.

A statement that is not written as the generator writes it is refused, so that what stands here is
what the C computes.

For the check of the error bound: the table as the C has it, the formula as the
certificate states it (`formulas`). Each line of the table is held against the formula at the
ends of `CELLS` cells, between which both are within what the second derivative allows beside a
chord; a line of few codes at each of its codes. So no code is left out. Needs the standard library
only.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import pairwise

from zerodrift_proof.bound.formulas import (
    CONTEXT,
    EIGHT,
    ONE,
    OPEN,
    ZERO,
    SensorFormula,
    ToldConversion,
    read_told,
)
from zerodrift_proof.certificate.values import Block, NotUnderstoodError

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
