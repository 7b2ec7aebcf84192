"""The raw codes of a converted input that are readings, and those that the chip's table covers."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import ConversionConfig
from zerodrift.dataset.conversions import convert, emf, find_sure_span

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
