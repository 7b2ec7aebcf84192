"""The codes of each input of the chip, chosen to hold the logs; else the row they cannot hold."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import (
    RAW_CODES,
    TEMPERATURES,
    CodesConfig,
    ConversionConfig,
    sum_formula,
)
from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError
from zerodrift.base.files import show_path
from zerodrift.dataset.checks import guess_temperature_unit, locate_row
from zerodrift.dataset.conversions import convert, emf, find_span, find_sure_span
from zerodrift.dataset.logs import read_log
from zerodrift.dataset.runs import Dataset, Run

# The raw codes of a converted input that are readings, and those that the chip's table covers.

RAW_LIMITS = {
    "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "int32": (-(2**31), 2**31 - 1),
}
GRID = 1 << 16
FINER = 4.0
"""By how much a sum of voltages is finer than a code of the temperature."""
MOST_FRACTION_BITS = 12
SUM_LIMITS = (-(2**30), 2**30)
"""Of sums of a thermocouple's raw codes and its junction's voltage."""


@dataclass(frozen=True)
class RawCover:
    """The raw codes of a type that are readings, and those of them that are converted."""

    raw: str
    begin: int
    end: int
    """Codes beyond are no readings."""
    lacks: int | None
    """One more code that is no reading."""
    low: int
    high: int
    """Converted; readings beyond are limited to these."""
    is_plain: bool = False
    """The quantity's code is the raw code."""
    fraction_bits: int | None = None
    """Of a thermocouple whose cold junction is measured: begin, end, low and high are sums of the
    raw code and the junction's voltage, in raw codes with so many fractional bits."""

    @property
    def least(self) -> int:
        """The lowest code of the type."""
        return RAW_LIMITS[self.raw][0]

    @property
    def most(self) -> int:
        """The highest code of the type."""
        return RAW_LIMITS[self.raw][1]


@dataclass(frozen=True)
class RawRange:
    """The raw codes that a conversion makes a quantity of, without those at a rail."""

    begin: int
    end: int
    values: tuple[float, float]
    """The quantity at both."""
    rises: bool


def find_linear(by: ConversionConfig) -> tuple[float, float] | None:
    """Return the LSB and the quantity at code 0; None where the conversion is not linear."""
    if by.kind or by.divider is not None:
        return None
    at = convert(np.array([0.0, 1.0]), by)
    return float(at[1] - at[0]), float(at[0])


def choose_fraction_bits(by: ConversionConfig, span: tuple[float, float], lsb: float) -> int:
    """Return the fractional bits at which a sum of voltages is finer than a code of the result."""
    low, high = find_sure_span(by.couple or "")
    degc = np.clip(np.linspace(*span, 257), low, high)
    steepest = np.abs(np.diff(degc) / np.maximum(np.diff(emf(by.couple or "", degc)), 1e-12)).max()
    wanted = np.ceil(np.log2(max(float(steepest) * abs(by.scale) * FINER / lsb, 1.0)))
    return int(min(wanted, MOST_FRACTION_BITS))


def find_range(
    by: ConversionConfig,
    raw: str,
    span: tuple[float, float],
    limits: tuple[int, int] | None = None,
) -> RawRange | str:
    """Return the raw codes that have a quantity, or a text that says why they cannot be used.

    They exclude the rails; over them the quantity rises or falls throughout. Of several such ranges
    the one that holds most of the span is taken.

    Args:
        by: raw code -> quantity.
        raw: the type of the codes.
        span: the quantity that is needed.
        limits: the lowest and highest code, where these are not those of the type.
    """
    least, most = limits or RAW_LIMITS[raw]
    if by.divider is not None and by.scale == 1.0 and by.offset == 0.0:
        least, most = max(least, 0), min(most, int(by.divider.counts))
    least, most = _narrow(by, least, most)
    codes = np.unique(np.linspace(least, most, min(most - least, GRID) + 1).round())
    values = convert(codes, by)
    sections = _find_sections(values)
    if not sections:
        return "no two raw codes have quantities that differ"
    low, high = span

    def share(section: tuple[int, int]) -> float:
        ends = sorted((values[section[0]], values[section[1]]))
        return float(min(ends[1], high) - max(ends[0], low))

    first, last = max(sections, key=share)
    begin = _find_edge(by, codes, first, first - 1)
    end = _find_edge(by, codes, last, last + 1)
    at = convert(np.array([begin, end], dtype=np.float64), by)
    found = RawRange(begin, end, (float(at[0]), float(at[1])), bool(at[1] > at[0]))
    inside = values[first : last + 1]
    beyond = [v for s in sections if s[0] >= last or s[1] <= first for v in values[s[0] : s[1] + 1]]
    if beyond and (
        (low < inside.min() and min(beyond) < inside.min())
        or (high > inside.max() and max(beyond) > inside.max())
    ):
        turn = codes[last] if last + 1 < len(codes) else codes[first]
        return f"the quantity does not rise or fall throughout: it turns at code {turn:.0f}"
    return found


def _find_sections(values: Array) -> list[tuple[int, int]]:
    """Return (first, last) of stretches over which values [n] are finite and rise, or fall."""
    signs = np.sign(np.diff(values))
    known = np.flatnonzero(signs != 0)
    if not known.size:
        return []
    before = np.maximum.accumulate(np.where(signs != 0, np.arange(signs.size), known[0]))
    signs = signs[before]  # where the value does not change, the direction stays
    edges = np.flatnonzero(np.concatenate([[True], signs[1:] != signs[:-1], [True]]))
    return [(int(a), int(b)) for a, b in pairwise(edges) if np.isfinite(signs[a])]


def _narrow(by: ConversionConfig, least: int, most: int) -> tuple[int, int]:
    """Return the codes within the ends of a table or of a thermocouple's function."""
    if by.kind not in ("table", "thermocouple") or by.scale == 0.0 or by.junction is not None:
        return least, most
    if by.kind == "table":
        given = [by.points[0][0], by.points[-1][0]]
    else:
        cold = emf(by.couple or "", np.array([by.junction_degC or 0.0]))[0]
        given = [v - cold for v in emf(by.couple or "", np.array(find_sure_span(by.couple or "")))]
    ends = sorted((x - by.offset) / by.scale for x in given)
    low, high = int(np.ceil(ends[0])), int(np.floor(ends[1]))
    return min(max(least, low), most), max(min(most, high), least)


def _find_edge(by: ConversionConfig, codes: Array, inside: int, outside: int) -> int:
    """Return the last code that has a quantity, from one that has towards one that has none."""
    good = int(codes[inside])
    if not 0 <= outside < len(codes):
        return good
    bad = int(codes[outside])
    while abs(good - bad) > 1:
        middle = (good + bad) // 2
        if np.isfinite(convert(np.array([float(middle)]), by)[0]):
            good = middle
        else:
            bad = middle
    return good


def find_code(by: ConversionConfig, found: RawRange, values: Array) -> Array:
    """Return the raw codes [n], as whole numbers, whose quantities are the nearest to values [n].

    Values beyond the range get its nearest end.
    """
    low = np.full(values.shape, float(found.begin))
    high = np.full(values.shape, float(found.end))
    sign = 1.0 if found.rises else -1.0
    while np.any(high - low > 1.0):
        middle = np.floor((low + high) / 2.0)
        below = sign * convert(middle, by) <= sign * values
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    left, right = convert(low, by), convert(high, by)
    return np.where(np.abs(right - values) < np.abs(left - values), high, low)


def cover_range(
    by: ConversionConfig,
    found: RawRange,
    raw: str,
    span: tuple[float, float],
    lacks: int | None,
    fraction_bits: int | None = None,
) -> RawCover:
    """Return the cover of a span of the quantity, as far as the codes go."""
    codes = sorted(int(c) for c in find_code(by, found, np.array(span)))
    cover = RawCover(raw, found.begin, found.end, lacks, codes[0], codes[1])
    return replace(cover, fraction_bits=fraction_bits)


# Codes of one input of the chip, and the values that they can hold.

TEMPERATURE, MEASURED, CLOCK = "temperature_degC", "measured:", "clock"
"""Sources of codes: the thermometer, `measured:Fz` of an output, or an input; one is the clock."""
AS_LOGGED = "as logged"
"""Unit of an input that has none of its own."""


@dataclass(frozen=True)
class ChipCodes:
    """The codes of one input: value = offset + code * lsb; or raw codes that become such codes."""

    name: str
    """`temperature`, `measured_Fz`, or the input's name."""
    source: str
    """`temperature_degC`, `measured:Fz`, or the input's name."""
    column: str
    """The column of the logs."""
    unit: str
    bits: int
    lsb: float
    no_reading: int | None
    """The code that means that there is no reading; None: there is no such code."""
    remedy: str
    """What a user can change where a log leaves the range of these codes."""
    offset: float = 0.0
    cover: RawCover | None = None
    """The raw codes that the chip is given; None: it is given these codes."""
    by: ConversionConfig | None = None
    """From raw code to value."""
    held: RawRange | None = None
    """Raw codes that have a value, where a table converts them."""

    @property
    def codes(self) -> tuple[int, int]:
        """The lowest and highest code that is a reading."""
        low, high = -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        if self.cover is not None and self.cover.is_plain:
            low, high = self.cover.least, self.cover.most
        return low + (self.no_reading == low), high - (self.no_reading == high)

    def holds(self, low: float, high: float) -> bool:
        """Tell whether codes hold both values, with one to spare on either side."""
        lowest, highest = self.codes
        return lowest < self._round(low) and self._round(high) < highest

    def _round(self, value: float) -> int:
        return round((value - self.offset) / self.lsb)

    def find_outside(self, values: Array) -> int | None:
        """Return the first position of values [n] that no code represents; None: there is none."""
        if self.held is not None:
            low, high = sorted(self.held.values)
            beyond = ~((values >= low) & (values <= high))
            return int(beyond.argmax()) if beyond.any() else None
        codes = np.round((values - self.offset) / self.lsb)
        lowest, highest = self.codes
        outside = ~((codes >= lowest) & (codes <= highest)) | (codes == self.no_reading)
        return int(outside.argmax()) if outside.any() else None

    def explain(self, place: str, run: Run, value: float) -> InputError:
        """Return the error about a value of a run that no code represents."""
        held = hint = ""
        if self.source == TEMPERATURE:
            hint = guess_temperature_unit(self.column, run.temperature_degC)
        if self.held is None and self._round(value) == self.no_reading:
            held = f", and {self.no_reading} means no reading"
        return InputError(
            f"{place}: run '{run.name}': {self.column} is {self.show(value)}; {self.describe()}"
            f"{held}.{hint} {self.remedy}"
        )

    def describe(self) -> str:
        """Return in words what the codes hold."""
        if self.held is not None and self.cover is not None and self.by is not None:
            low, high = (self.show(value) for value in sorted(self.held.values))
            codes = f"{self.cover.begin} .. {self.cover.end} of {self.cover.raw}"
            if self.by.junction is not None:
                codes = f"{self.cover.raw}, whatever '{self.by.junction}' is"
            kind = self.by.kind or "scaled"
            return f"the raw codes of '{self.name}' ({codes}, {kind}) hold {low} to {high}"
        low, high = (self.show(code * self.lsb + self.offset) for code in self.codes)
        kind = f"int{self.bits}" if self.cover is None else self.cover.raw
        kind = f"{kind}, {self.show(self.lsb)} each"
        return f"the codes of '{self.name}' ({kind}) hold {low} to {high}"

    def show(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.10g}" if self.unit == AS_LOGGED else f"{value:.10g} {self.unit}"


# The LSB of an input by zerodrift.toml alone: the same for every unit of a design.
#
# In projects of format 1 each unit's training logs decide it; from format 2 on they do not.

DESIGN_FORMAT = 2
"""`format` in zerodrift.toml from which on codes do not follow from a unit's logs."""
TEMPERATURE_LSB_DEGC = 0.0078125
"""One count of the TMP117, 2**-7 K (Texas Instruments, TMP117 data sheet, temperature register)."""
CLOCK_LSB_S = 1.0
FILLED = {16: 2.0**14, 32: 2.0**30}
"""Bits of a code -> the code that the largest value is given, at most; twice it is held."""
THERMOMETERS = ("ntc", "pt100", "pt1000", "thermocouple")
"""`convert` that ends in degC."""


def find_design_lsb(config: Config, name: str) -> float | None:
    """Return the LSB of an input, in its unit; None: zerodrift.toml does not state it.

    As stated; else 1 s for the clock, the slope of a linear conversion, 2**-7 K for a thermometer,
    or the power of two by which the stated range fills 15 of 16 bits (31 of 32).
    """
    stated = config.input_codes.get(name, CodesConfig())
    if stated.lsb is not None:
        return stated.lsb
    if name == CLOCK:
        return CLOCK_LSB_S
    linear = None if stated.by is None else find_linear(stated.by)
    if linear is not None:
        return abs(linear[0])
    if is_thermometer(name, config.inputs[name], stated.by or config.conversions.get(name)):
        return TEMPERATURE_LSB_DEGC
    if stated.range is not None:
        return fill_codes(max(map(abs, stated.range)), stated.bits or 16)
    return None


def is_thermometer(name: str, column: str, by: ConversionConfig | None = None) -> bool:
    """Tell whether an input is a temperature in degC, by its name, column or conversion."""
    if by is not None and (by.kind in THERMOMETERS or by.unit in TEMPERATURES):
        return True
    return "temperature" in name or column.endswith("degC")


def fill_codes(largest: float, bits: int) -> float:
    """Return the power-of-two LSB at which the largest value fills at most half the range."""
    return float(2.0 ** math.ceil(math.log2(max(largest, 1e-30) / FILLED[bits])))


def propose_codes(
    name: str, column: str, low: float, high: float, is_degc: bool
) -> tuple[str, float]:
    """Return `raw` and `lsb` for a new project's input whose logs reach from low to high.

    Args:
        name: the input's.
        column: its column.
        low: lowest value of all logs.
        high: highest value of all logs.
        is_degc: it is known to be a thermometer in degC.
    """
    largest = max(abs(low), abs(high))
    if is_degc or is_thermometer(name, column):
        is_short = largest < (2.0**15 - 1) * TEMPERATURE_LSB_DEGC / 1.25
        return ("int16" if is_short else "int32"), TEMPERATURE_LSB_DEGC
    return "int16", fill_codes(largest, 16)


def require_design_lsb(config: Config, name: str) -> float:
    """Return `find_design_lsb`.

    Raises:
        InputError: zerodrift.toml does not state it.
    """
    found = find_design_lsb(config, name)
    if found is not None:
        return found
    raise InputError(
        f"{locate_key(config.path, 'inputs', name)}: '{name}' states neither lsb nor range; "
        f"expected one of them, as from format = {DESIGN_FORMAT} on a code is worth the same for "
        "every unit of the design, whatever its logs hold. `zerodrift init --upgrade` writes one "
        f'that holds the logs, or write {name} = {{ column = "{config.inputs[name]}", range = '
        "[LOWEST, HIGHEST] }."
    )


def list_unstated(config: Config) -> list[str]:
    """Return the inputs whose LSB zerodrift.toml does not state."""
    return [name for name in config.inputs if not explain_stated(config, name)]


def explain_stated(config: Config, name: str) -> str:
    """Return how zerodrift.toml states the LSB; empty: the logs decide it, in format 1."""
    stated = config.input_codes.get(name, CodesConfig())
    linear = None if stated.by is None else find_linear(stated.by)
    if name == CLOCK:
        return "whole seconds"
    if linear is not None:
        return "the hardware's own codes"
    if stated.lsb is not None and (stated.bits is not None or stated.raw):
        return "it states raw and lsb"
    if config.format >= DESIGN_FORMAT and find_design_lsb(config, name) is not None:
        return f"format = {DESIGN_FORMAT} says what a code is worth"
    return ""


# The codes of each input of the chip, chosen to hold the logs; else the row they cannot hold.

FLAG_MARGIN_K = 2.0
"""The temperature is flagged when it is further than this from the calibrated range."""
RANGE_MARGIN = 0.25
"""Share of the calibrated span by which other inputs may go beyond it before they are flagged, and
all inputs before they are limited. A little extrapolation beats none; a lot is worth nothing."""


def choose_codes(config: Config, source: str, runs: Sequence[Run], lsb: float) -> ChipCodes:
    """Return the codes of any input of the firmware.

    Args:
        config: the project.
        source: `temperature_degC`, `measured:Fz`, or the input's name.
        runs: of the training logs.
        lsb: of a raw output, in its unit.

    Raises:
        InputError: the stated codes do not hold the logs or the stated range.
    """
    if source == TEMPERATURE:
        return choose_temperature_codes(config, runs)
    if not source.startswith(MEASURED):
        return choose_input_codes(config, source, runs)
    output = next(o for o in config.outputs if o.name == source.removeprefix(MEASURED))
    remedy = f"Correct the row, or [outputs.{output.name}] full_scale, of which a code is a part."
    name = f"measured_{output.name}"
    return ChipCodes(name, source, output.measured, output.unit, 32, lsb, -(2**31), remedy)


def choose_temperature_codes(config: Config, runs: Sequence[Run]) -> ChipCodes:
    """Return the thermometer's codes: those of a TMP117, wider where these do not hold the logs.

    Args:
        config: the project, which may state the codes.
        runs: of the training logs.

    Raises:
        InputError: the stated codes do not hold the logs or the stated range.
    """
    stated = config.temperature_codes
    spans = [(float(r.temperature_degC.min()), float(r.temperature_degC.max())) for r in runs]
    low, high = _join(spans, stated)
    if stated.raw:
        beyond = max(1.5 * FLAG_MARGIN_K, RANGE_MARGIN * _measure_span(spans) + 0.5)
        need = (low - FLAG_MARGIN_K, high + FLAG_MARGIN_K)
        return _convert(config, TEMPERATURE, (low, high), need, beyond, TEMPERATURE_LSB_DEGC, runs)
    options = _list_options(stated, TEMPERATURE_LSB_DEGC)
    if stated.bits == 16 and stated.lsb is None:  # coarser, as it may not be wider
        options = [(16, TEMPERATURE_LSB_DEGC * 2.0**step) for step in range(64)]
        if config.format >= DESIGN_FORMAT:  # the finest that holds the range, whatever was logged
            low_end, high_end = stated.range or (0.0, 0.0)
            span = (low_end - FLAG_MARGIN_K, high_end + FLAG_MARGIN_K)
            fitting = (o for o in options if _make(config, TEMPERATURE, *o).holds(*span))
            options = [next(fitting, options[-1])]
    found = [
        _make(config, TEMPERATURE, bits, lsb) for bits, lsb in options if _fits_type(stated, bits)
    ]
    margin = FLAG_MARGIN_K
    return _choose(config, found, runs, (low - margin, high + margin), "2 degC on either side")


def choose_input_codes(config: Config, name: str, runs: Sequence[Run]) -> ChipCodes:
    """Return the codes of one of `[inputs]`: as stated, or with an LSB that fills 15 of 16 bits.

    A clock counts whole seconds in 32 bits. From format 2 on the logs do not decide the LSB.

    Raises:
        InputError: as `choose_temperature_codes`; or the LSB is stated nowhere.
    """
    stated = config.input_codes.get(name, CodesConfig())
    spans = [(float(r.inputs[name].min()), float(r.inputs[name].max())) for r in runs]
    low, high = _join(spans, stated)
    largest = max(abs(low), abs(high), 1e-30)
    margin = RANGE_MARGIN * _measure_span(spans)
    is_fixed = config.format >= DESIGN_FORMAT
    if stated.raw:
        need = (low - margin, high + margin)
        usual = require_design_lsb(config, name) if is_fixed else _choose_lsb(need, 2.0**14)
        return _convert(config, name, (low, high), need, 1.5 * margin, usual, runs)
    if name == CLOCK:
        second = 2.0 ** max(0, math.ceil(math.log2(largest / 2.0**30)) - 1)
        usual = CLOCK_LSB_S if is_fixed else second
        options = [(stated.bits or 32, stated.lsb or usual)]
        need = (low, high)  # its limits are far beyond what was logged, and beyond the codes
    else:
        bits = stated.bits or 16
        need = (low - margin, high + margin)
        if is_fixed:
            options = [(bits, require_design_lsb(config, name))]
        else:
            options = _list_options(stated, fill_codes(largest, bits))
    found = [_make(config, name, *option) for option in options if _fits_type(stated, option[0])]
    return _choose(config, found, runs, need, "a quarter of the span on either side")


def _measure_span(spans: Sequence[tuple[float, float]]) -> float:
    """Return the difference between the highest and the lowest logged value."""
    return max(high for _, high in spans) - min(low for low, _ in spans)


def _convert(
    config: Config,
    source: str,
    span: tuple[float, float],
    need: tuple[float, float],
    beyond: float,
    usual: float,
    runs: Sequence[Run],
) -> ChipCodes:
    """Return the codes of an input whose raw codes the chip is given.

    Args:
        config: the project.
        source: `temperature_degC`, or the input's name.
        span: what the training logs and the stated range hold.
        need: the same with what is flagged.
        beyond: how far from the span the table goes.
        usual: what one code is worth where nothing is stated.
        runs: of the training logs.

    Raises:
        InputError: the raw codes do not hold the span.
    """
    is_temperature = source == TEMPERATURE
    stated = config.temperature_codes if is_temperature else config.input_codes[source]
    by = stated.by or ConversionConfig(scale=stated.lsb or usual)
    made = _make(config, source, 32, usual)
    least, _ = RAW_CODES[stated.raw]
    lacks = None if stated.always_read else stated.no_reading
    if lacks is None and least < 0 and not stated.always_read:
        lacks = least
    linear = find_linear(by)
    if linear is not None and linear[0] > 0.0:
        made = replace(
            made,
            bits=16 if stated.raw == "int16" else 32,
            lsb=linear[0],
            offset=linear[1],
            no_reading=lacks,
            cover=RawCover(stated.raw, *RAW_CODES[stated.raw], None, *RAW_CODES[stated.raw], True),
            by=by,
        )
        ends = [code * made.lsb + made.offset for code in made.codes]
        if made.holds(*need) or (least == 0 and ends[0] <= span[0] and span[1] <= ends[1]):
            return made  # nothing lies below 0, so that nothing there is flagged
        low, high = map(made.show, need)
        raise InputError(
            f"{_locate(config, made)}: {made.describe()}; expected {low} to {high}: the training "
            "logs and the range, with what is flagged beyond them. Correct scale, offset or range, "
            'or take raw = "int32".'
        )
    lsb = stated.lsb or usual
    bits, limits = None, None
    if by.junction is not None:
        bits = choose_fraction_bits(by, span, lsb)
        limits = _reach_sums(config, made, by, bits, runs)
        by_sum = sum_formula(by, bits)
    else:
        by_sum = by
    found = find_range(by_sum, stated.raw, span, limits)
    if isinstance(found, str):
        raise InputError(
            f"{_locate(config, made)}: {made.name} is converted from raw codes, but {found}; "
            "expected one quantity for each code from the lowest to the highest that is needed. "
            "Correct the conversion, or convert what the firmware is given beforehand."
        )
    wide = (span[0] - beyond, span[1] + beyond)
    cover = cover_range(by_sum, found, stated.raw, wide, lacks, bits)
    every = (cover.begin, cover.end) == RAW_CODES[stated.raw] and lacks is None
    if bits is not None:  # no code can lie beyond the possible sums
        every = lacks is None
    made = replace(made, lsb=lsb, cover=cover, by=by, held=found, no_reading=None)
    width = 16 if replace(made, bits=16).holds(*wide) else 32
    none = None if stated.always_read or every else -(1 << (width - 1))
    made = replace(made, bits=width, no_reading=none)
    ends = sorted(found.values)
    if ends[0] <= span[0] and span[1] <= ends[1]:
        return made
    low, high = map(made.show, span)
    raise InputError(
        f"{_locate(config, made)}: {made.describe()}; expected {low} to {high}: the training logs "
        "and the range. Correct the conversion or the range, or leave out what no code stands for."
    )


def _reach_sums(
    config: Config, made: ChipCodes, by: ConversionConfig, bits: int, runs: Sequence[Run]
) -> tuple[int, int]:
    """Return the sums of code and junction's voltage that occur at any junction temperature.

    Raises:
        InputError: there are none, or the junction leaves the range of its thermocouple.
    """
    name, couple = by.junction or "", by.couple or ""
    cold = find_junction_span(config, name, runs)
    known = find_span(couple)
    if not known[0] <= cold[0] <= cold[1] <= known[1]:
        raise InputError(
            f"{_locate(config, made)}: the cold junction '{name}' is {cold[0]:.10g} to"
            f" {cold[1]:.10g} degC in the training logs and its range; type {couple} is known from"
            f" {known[0]:g} to {known[1]:g} degC. Correct the column, or leave these rows out."
        )
    ends = emf(couple, np.array(cold)) / by.scale * 2.0**bits
    stated = config.temperature_codes if made.source == TEMPERATURE else None
    raw = (stated or config.input_codes[made.source]).raw
    least, most = (code << bits for code in RAW_CODES[raw])
    low, high = least + math.ceil(max(ends)), most + math.floor(min(ends))
    return max(low, SUM_LIMITS[0]), min(high, SUM_LIMITS[1])


def find_junction_span(config: Config, name: str, runs: Sequence[Run]) -> tuple[float, float]:
    """Return the lowest and highest temperature of a cold junction, in degC."""
    stated = config.input_codes.get(name, CodesConfig())
    return _join([(float(r.inputs[name].min()), float(r.inputs[name].max())) for r in runs], stated)


def _choose_lsb(span: tuple[float, float], filled: float) -> float:
    """Return the smallest power of two that puts the larger end of a span within `filled` codes."""
    largest = max(abs(span[0]), abs(span[1]), 1e-30)
    return float(2.0 ** math.ceil(math.log2(largest / filled)))


def _join(spans: Sequence[tuple[float, float]], stated: CodesConfig) -> tuple[float, float]:
    """Return the lowest and highest value of logs and stated range."""
    every = [*spans, *([stated.range] if stated.range else [])]
    return min(low for low, _ in every), max(high for _, high in every)


def _list_options(stated: CodesConfig, usual: float) -> list[tuple[int, float]]:
    """Return bits and lsb in the order of preference."""
    lsb = stated.lsb or usual
    return [(bits, lsb) for bits in ((stated.bits,) if stated.bits else (16, 32))]


def _fits_type(stated: CodesConfig, bits: int) -> bool:
    """Tell whether the stated code of no reading is one of so many bits."""
    code = stated.no_reading or 0
    return -(1 << (bits - 1)) <= code < 1 << (bits - 1)


def _make(config: Config, source: str, bits: int, lsb: float) -> ChipCodes:
    is_temperature = source == TEMPERATURE
    stated = config.temperature_codes if is_temperature else config.input_codes.get(source)
    stated = stated or CodesConfig()
    column = config.temperature_column if is_temperature else config.inputs.get(source, source)
    none = -(1 << (bits - 1)) if stated.no_reading is None else stated.no_reading
    key = ("sensor", "temperature") if is_temperature else ("inputs", source)
    way = f'{key[1]} = {{ column = "{column}", {_show_way(stated, lsb)} }}'
    return ChipCodes(
        name="temperature" if is_temperature else source,
        source=source,
        column=column,
        unit="degC" if is_temperature else "s" if source == CLOCK else AS_LOGGED,
        bits=bits,
        lsb=lsb,
        no_reading=None if stated.always_read else none,
        remedy=f"Correct the row, or write {way} at {locate_key(config.path, *key)}.",
    )


def _show_way(stated: CodesConfig, lsb: float) -> str:
    """Return the keys of the table in the remedy."""
    if stated.bits == 16:
        return f'raw = "int32", lsb = {lsb:.10g}'
    if stated.lsb:
        return f"lsb = {4.0 * lsb:.10g}"
    return "range = [LOWEST, HIGHEST]"


def _choose(
    config: Config,
    options: Sequence[ChipCodes],
    runs: Sequence[Run],
    need: tuple[float, float],
    margin: str,
) -> ChipCodes:
    """Return the first codes that hold what is needed."""
    for codes in options:
        if codes.holds(*need):
            return codes
    widest = options[-1]
    refuse_outside(config, [widest], runs)
    low, high = map(widest.show, need)
    raise InputError(
        f"{_locate(config, widest)}: {widest.describe()}; expected {low} to {high}: the training "
        f'logs and the range, with {margin} for the flags. Take a larger lsb or raw = "int32", '
        "or correct the range."
    )


def _locate(config: Config, codes: ChipCodes) -> str:
    is_temperature = codes.source == TEMPERATURE
    return locate_key(config.path, "sensor" if is_temperature else "inputs", codes.name)


def read_source(outputs: Sequence[str], source: str, run: Run) -> Array:
    """Return the values [n] of a run, in the source's unit, before they become codes.

    Args:
        outputs: their names, in the order of the run.
        source: `temperature_degC`, `measured:Fz`, or the input's name.
        run: any.
    """
    if source == TEMPERATURE:
        return run.temperature_degC
    if source.startswith(MEASURED):
        return np.asarray(run.measured[:, list(outputs).index(source.removeprefix(MEASURED))])
    return run.inputs[source]


def refuse_outside(config: Config, codes: Sequence[ChipCodes], runs: Sequence[Run]) -> None:
    """Refuse runs with a value that no code represents.

    Raises:
        InputError: names file and line, run, value, what the codes hold, and what to do.
    """
    outputs = [output.name for output in config.outputs]
    for run in runs:
        for one in codes:
            row = one.find_outside(read_source(outputs, one.source, run))
            if row is not None:
                raise _explain_row(config, one, run, row)


def refuse_unsayable(config: Config, dataset: Dataset) -> None:
    """Refuse logs outside the codes of the thermometer and the stated inputs, before any training.

    Raises:
        InputError: as `refuse_outside`.
    """
    codes = [choose_temperature_codes(config, dataset.train)]
    stated = [
        name
        for name, given in config.input_codes.items()
        if given != CodesConfig() or config.format >= DESIGN_FORMAT
    ]
    codes += [choose_input_codes(config, name, dataset.train) for name in stated]
    refuse_outside(config, codes, [*dataset.train, *dataset.test, *dataset.dwell])


def _explain_row(config: Config, codes: ChipCodes, run: Run, row: int) -> InputError:
    """Return the error about a run's value, at the row of its log that no code stands for."""
    columns = {config.time_column: "[sensor] time", codes.column: "a channel of the chip"}
    tables = read_log(config, run.files or (run.source,), columns)
    if len(tables) > 1:  # a thermocouple and its cold junction; its quantity is in no one file
        outputs = [output.name for output in config.outputs]
        value = float(read_source(outputs, codes.source, run)[row])
        where = show_path(run.source, config.directory)
        return codes.explain(f"{where}: at {run.time_s[row]:g} s", run, value)
    (table,) = tables
    source = table.source
    values = table.columns[codes.column]
    time_s = table.columns[config.time_column]
    if codes.held is not None:
        low, high = sorted(codes.held.values)
        outside = (values < low) | (values > high)
    else:
        raw = np.round((values - codes.offset) / codes.lsb)
        lowest, highest = codes.codes
        outside = (raw < lowest) | (raw > highest) | (raw == codes.no_reading)
    # among a run's rows, the one beside the step that no code stands for
    away = np.where(outside, np.abs(time_s - run.time_s[row]), np.inf)
    if table.run_of_row is not None:
        own = [i for i, name in enumerate(table.runs) if run.group.endswith(name)]
        others = ~np.isin(table.run_of_row, own)
        away = np.where(others & outside, away + float(np.ptp(time_s)) + 1.0, away)
    if not outside.any():  # a mean of rows that codes stand for
        place = f"{source.label}: at {run.time_s[row]:g} s"
        outputs = [output.name for output in config.outputs]
        return codes.explain(place, run, float(read_source(outputs, codes.source, run)[row]))
    nearest = int(np.nanargmin(away))
    place = locate_row(source, table.position(nearest)).text
    return codes.explain(place, run, float(values[nearest]))
