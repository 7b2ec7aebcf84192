"""The channels that a model reads, and the tables by which the chip converts raw codes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.column_config import ConversionConfig, junction_formula, sum_formula
from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError
from zerodrift.dataset.chip_codes import (
    CLOCK,
    MEASURED,
    RANGE_MARGIN,
    RAW_LIMITS,
    TEMPERATURE,
    ChipCodes,
    RawCover,
    choose_codes,
    find_junction_span,
)
from zerodrift.dataset.conversions import convert, find_span, measure_slope
from zerodrift.dataset.runs import Run
from zerodrift.export.float_model import LOAD
from zerodrift.export.integer_model import Channel, OutputFormat
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.conversion import MOST_LINES, IntegerConversion
from zerodrift.operations.operation import Node, list_nodes

# Chooses the table by which the chip converts raw codes: as small as its error allows.

Exact = Callable[[Array], Array]

TOLERANCE_LSB = 0.48
"""What lines may be off the formula, beside the rounding of the result: together one code."""
BETWEEN_SAMPLES = 1.02
"""What lines may be off between the codes at which they are held against it, as a multiple."""
MOST_TABLE_BYTES = 4096
MOST_SAMPLES = 1 << 17
"""Codes at which lines are held against the formula; all of them where there are no more."""
MOST_BLOCKS_BITS = 7
FRACTION_BITS, NODE_LIMIT = 8, 2**30
MOST_ROUNDS = 24


@dataclass(frozen=True)
class _Lines:
    """A segmentation: blocks of 2**block_bits codes with so many lines each."""

    block_bits: int
    parts: IntArray
    nodes: Array
    """In the quantity's unit."""

    @property
    def table_bytes(self) -> int:
        """Size of the tables in flash, in bytes."""
        return 2 * (len(self.parts) + 1) + 4 * len(self.nodes)


@dataclass(frozen=True)
class JunctionCodes:
    """The channel of a cold junction: codes of temperature that become a voltage."""

    channel: int
    bits: int
    lsb: float
    offset: float
    none: int | None
    low: int
    high: int
    """Codes that the table covers; beyond them they are limited."""
    error: float = 0.0
    """Error of its own conversion, in K."""


@lru_cache(maxsize=64)
def design_conversion(
    index: int,
    cover: RawCover,
    formula: ConversionConfig,
    lsb: float,
    offset: float,
    none: int | None,
    junction: JunctionCodes | None = None,
) -> IntegerConversion:
    """Return the conversion of a channel, its error measured over the codes that it covers.

    Args:
        index: of the channel.
        cover: the raw codes that are readings, and those to be converted.
        formula: raw code -> quantity; monotone over the codes that are covered.
        lsb: one code of the quantity, in its unit.
        offset: the quantity at its code 0.
        none: the quantity's code for no reading.
        junction: the cold junction of a thermocouple, where a channel measures it.

    Raises:
        CheckError: no table of a reasonable size meets the error.
    """
    name = f"conversion_{index}"
    if junction is not None:
        assert cover.fraction_bits is not None
        bits = cover.fraction_bits
        of_sum = replace(cover, raw="int32", fraction_bits=None)
        made = _design(name, index, of_sum, sum_formula(formula, bits), lsb, offset, none)
        cold = _design_junction(name, formula, bits, junction)
        cold_degC = np.linspace(junction.low, junction.high, 1025) * junction.lsb + junction.offset
        steepest = measure_slope(formula.couple or "", cold_degC).max()
        own = junction.error * float(steepest) * 2.0**bits / abs(formula.scale) * BETWEEN_SAMPLES
        worth = tuple(2.0**bits * one for one in made.worth)
        return replace(
            made,
            raw=cover.raw,
            formula=formula,
            lacks=cover.lacks,
            junction=cold,
            fraction_bits=bits,
            worth=(worth[0], worth[1]),
            error=made.error + (cold.error + own) * made.worth[1] * BETWEEN_SAMPLES,
        )
    return _design(name, index, cover, formula, lsb, offset, none)


def _design_junction(
    name: str, formula: ConversionConfig, bits: int, junction: JunctionCodes
) -> IntegerConversion:
    """Return the table of the voltage that the cold junction adds, in counts of the sum."""
    by = junction_formula(formula, bits, junction.lsb, junction.offset)
    raw = f"int{junction.bits}"
    limits = RAW_LIMITS[raw]
    cover = RawCover(raw, *limits, junction.none, junction.low, junction.high)
    return _design(f"{name}_junction", junction.channel, cover, by, 1.0, 0.0, None)


def _design(
    name: str,
    index: int,
    cover: RawCover,
    formula: ConversionConfig,
    lsb: float,
    offset: float,
    none: int | None,
) -> IntegerConversion:
    """Return a table, its error measured over the codes that it covers."""
    given = (name, (), index, cover.raw, formula, cover.begin, cover.end, cover.lacks)
    if cover.is_plain:
        return IntegerConversion(*given, None, cover.least, cover.most, worth=(lsb, lsb))

    def exact(places: Array) -> Array:
        """Return the quantity at places counted from cover.low; straight on beyond the codes."""
        span = float(cover.high - cover.low)
        inside = np.clip(places, 0.0, span)
        found = convert(inside + cover.low, formula)
        last = convert(np.array([cover.high - 1.0, cover.high]), formula)
        return np.asarray(found + np.maximum(places - span, 0.0) * (last[1] - last[0]))

    span = cover.high - cover.low
    places = np.unique(np.linspace(0, span, min(span + 1, MOST_SAMPLES)).round().astype(np.int64))
    wanted = exact(places.astype(np.float64))
    lines = _choose_lines(exact, places, wanted, span, TOLERANCE_LSB * lsb)
    if lines is None or lines.table_bytes > MOST_TABLE_BYTES:
        raise CheckError(
            f"the conversion of codes {cover.low} .. {cover.high} to within {TOLERANCE_LSB * lsb:g}"
            f" needs a table of more than {MOST_TABLE_BYTES} bytes. Take a larger lsb, a narrower "
            "range, or a table of points without sharp bends."
        )
    in_codes = (lines.nodes - offset) / lsb
    bits = FRACTION_BITS
    while bits and np.abs(in_codes).max() * 2.0**bits > NODE_LIMIT:
        bits -= 1
    ends = [round(float((end - offset) / lsb)) for end in (wanted.min(), wanted.max())]
    made = IntegerConversion(
        *given,
        none,
        cover.low,
        cover.high,
        block_bits=lines.block_bits,
        first=(0, *(int(n) for n in np.cumsum(lines.parts))),
        nodes=tuple(int(n) for n in np.round(in_codes * 2.0**bits)),
        shift=lines.block_bits + bits,
        lowest=ends[0],
        highest=ends[1],
    )
    return _measure(made, places, wanted, lsb, offset)


def _measure(
    made: IntegerConversion, places: IntArray, wanted: Array, lsb: float, offset: float
) -> IntegerConversion:
    """Return the conversion with its error over all codes, and what one of them is worth.

    The error is for any number between codes too, as the check of the error bound derives it: the
    lines' largest distance from the formula, a little more for what lies between the codes at
    which they are compared, and half a code for the rounding of the result.
    """
    codes = places + made.low
    readings = ~made.find_missing(codes)
    bits = made.shift - made.block_bits
    fine = replace(made, shift=made.block_bits, lowest=INT32_MIN, highest=INT32_MAX, none=None)
    lines = fine.convert(codes) * 2.0**-bits * lsb + offset
    error = np.abs(lines - wanted)[readings].max() * BETWEEN_SAMPLES + (0.5 + 2.0**-bits) * lsb
    steps = np.abs(np.diff(wanted)) / np.diff(places)
    return replace(
        made,
        error=float(error),
        worth=(float(steps.min()), float(steps.max())),
    )


def _choose_lines(
    exact: Exact, places: IntArray, wanted: Array, span: int, tolerance: float
) -> _Lines | None:
    """Return the smallest table of all sizes of blocks that stays within the tolerance."""
    widest = max(span.bit_length(), 1)
    best: _Lines | None = None
    for block_bits in range(min(widest, 31), max(widest - MOST_BLOCKS_BITS, 0) - 1, -1):
        found = _fit_lines(exact, places, wanted, span, block_bits, tolerance)
        if found is not None and (best is None or found.table_bytes < best.table_bytes):
            best = found
    return best


def _fit_lines(
    exact: Exact, places: IntArray, wanted: Array, span: int, block_bits: int, tolerance: float
) -> _Lines | None:
    """Return lines within the tolerance in blocks of a size; None where there are none."""
    blocks = (span >> block_bits) + 1
    parts = np.ones(blocks, dtype=np.int64)
    most = min(1 << block_bits, 1 << max(32 - block_bits, 0), MOST_LINES)
    for _ in range(MOST_ROUNDS):
        if parts.sum() > min(MOST_LINES, MOST_TABLE_BYTES // 4):
            return None
        nodes, errors = _place_nodes(exact, places, wanted, block_bits, parts)
        wrong = errors > tolerance
        if not wrong.any():
            return _Lines(block_bits, parts, nodes)
        if (parts[wrong] >= most).any():
            return None
        more = np.ceil(parts * np.minimum(np.sqrt(errors / tolerance), 4.0)).astype(np.int64)
        parts = np.where(wrong, np.minimum(np.maximum(more, parts + 1), most), parts)
    return None


def _place_nodes(
    exact: Exact, places: IntArray, wanted: Array, block_bits: int, parts: IntArray
) -> tuple[Array, Array]:
    """Return the ends of all lines, and the largest error in each block.

    A chord lies on one side of a curve; ends moved by half of what its middle is off halve that.
    """
    first = np.concatenate([[0], np.cumsum(parts)])
    line_block = np.repeat(np.arange(len(parts)), parts)
    within = (np.arange(first[-1]) - first[line_block]) / parts[line_block]
    begins = (line_block + within) * 2.0**block_bits
    nodes = exact(np.append(begins, len(parts) * 2.0**block_bits))
    block = places >> block_bits
    at = (places & ((1 << block_bits) - 1)) * parts[block]
    line = first[block] + (at >> block_bits)
    share = (at & ((1 << block_bits) - 1)) / 2.0**block_bits

    def deviate() -> Array:
        return np.asarray(wanted - nodes[line] - (nodes[line + 1] - nodes[line]) * share)

    starts = np.flatnonzero(np.diff(line, prepend=-1))
    off = deviate()
    middle = np.zeros(first[-1])
    low, high = np.minimum.reduceat(off, starts), np.maximum.reduceat(off, starts)
    middle[line[starts]] = np.minimum(low, 0.0) + np.maximum(high, 0.0)
    nodes[1:-1] += (middle[:-1] + middle[1:]) / 4.0
    nodes[0] += middle[0] / 2.0
    nodes[-1] += middle[-1] / 2.0
    errors = np.zeros(len(parts))
    np.maximum.at(errors, block, np.abs(deviate()))
    return nodes, errors


# The channels that a model reads: which there are, and how each one's codes are converted.

JUNCTION_MARGIN_K = 5.0
"""How far, at least, a cold junction's table goes beyond what was logged."""


def list_channels(
    roots: Sequence[Node],
    config: Config,
    runs: Sequence[Run],
    outputs: Sequence[OutputFormat],
) -> tuple[tuple[Channel, ...], dict[str, int]]:
    """Return the raw inputs that the graph needs; the temperature is always the first."""
    found = [choose_codes(config, TEMPERATURE, runs, 0.0)]
    sources = {TEMPERATURE: 0}
    places = {TEMPERATURE: 0}
    for node in list_nodes(roots):
        if node.op != "input" or node.source in sources:
            continue
        codes = _find_codes(node.source, config, runs, outputs)
        if codes is None:
            continue
        if codes.source not in places:
            places[codes.source] = len(found)
            found.append(codes)
        sources[node.source] = places[codes.source]
    for codes in tuple(found):
        name = find_junction(codes)
        if name is not None and name not in places:
            places[name] = len(found)
            found.append(choose_codes(config, name, runs, 0.0))
    cold = {
        name: _cover_junction(config, places[name], found[places[name]], runs)
        for name in filter(None, map(find_junction, found))
    }
    channels = [
        make_channel(index, codes, cold.get(find_junction(codes) or ""))
        for index, codes in enumerate(found)
    ]
    return tuple(channels), sources


def find_junction(codes: ChipCodes) -> str | None:
    """Return the input that measures the cold junction of a thermocouple which the chip reads."""
    return None if codes.by is None or codes.held is None else codes.by.junction


def _cover_junction(
    config: Config, index: int, codes: ChipCodes, runs: Sequence[Run]
) -> JunctionCodes:
    """Return the codes of a cold junction that its thermocouple's table covers."""
    low, high = find_junction_span(config, codes.source, runs)
    beyond = max(JUNCTION_MARGIN_K, 1.5 * RANGE_MARGIN * (high - low))
    users = [c.by for c in (config.temperature_codes, *config.input_codes.values()) if c.by]
    spans = [find_span(by.couple) for by in users if by.couple and by.junction == codes.source]
    ends = (
        max([low - beyond, *(span[0] for span in spans)]),
        min([high + beyond, *(span[1] for span in spans)]),
    )
    first, last = (round((end - codes.offset) / codes.lsb) for end in ends)
    first, last = (min(max(code, codes.codes[0]), codes.codes[1]) for code in (first, last))
    by = make_channel(index, codes).conversion
    return JunctionCodes(
        channel=index,
        bits=codes.bits,
        lsb=codes.lsb,
        offset=codes.offset,
        none=codes.no_reading,
        low=first,
        high=last,
        error=0.0 if by is None else by.error,
    )


def _find_codes(
    source: str, config: Config, runs: Sequence[Run], outputs: Sequence[OutputFormat]
) -> ChipCodes | None:
    """Return the codes behind a signal of the graph, or None where it needs none."""
    if source.startswith(LOAD):
        name = source.removeprefix(LOAD)
        output = next(o for o in outputs if o.name == name)
        lsb = 1.0 / output.lsb_per_unit
        return choose_codes(config, f"{MEASURED}{name}", runs, lsb)
    name = CLOCK if source == "clock_s" else source
    if not all(name in run.inputs for run in runs):
        return None
    return choose_codes(config, name, runs, 0.0)


def make_channel(index: int, codes: ChipCodes, junction: JunctionCodes | None = None) -> Channel:
    """Return a channel of the model.

    Args:
        index: its place.
        codes: its codes.
        junction: those of a thermocouple's cold junction, where a channel measures it.

    Raises:
        CheckError: no table converts the raw codes within the allowed error.
    """
    conversion = None
    if codes.cover is not None and codes.by is not None:
        is_same = codes.cover.is_plain and codes.cover.raw == f"int{codes.bits}"
        given = (codes.cover, codes.by, codes.lsb, codes.offset, codes.no_reading)
        conversion = None if is_same else design_conversion(index, *given, junction)
    return Channel(
        name=codes.name,
        unit=codes.unit,
        lsb=codes.lsb,
        offset=codes.offset,
        bits=codes.bits,
        source=codes.source,
        no_reading=codes.no_reading,
        conversion=conversion,
    )
