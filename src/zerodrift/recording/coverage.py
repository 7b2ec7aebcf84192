"""What a recording has covered so far: ranges, rates, and the share of what was planned."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift.recording.sources import Values

RATE_OVER_S = 60.0
"""A rate is the difference over this time; shorter ones are the thermometer's noise."""
SHARE = 0.95
"""Of a planned range or time that has to be covered."""
RATE_SHARE = 0.8
"""Of a planned rate: the sensor follows the chamber slowly."""


@dataclass(frozen=True)
class Wanted:
    """What a recording should cover."""

    temperature_degC: tuple[float, float] | None = None
    heating_K_per_min: float | None = None
    cooling_K_per_min: float | None = None
    columns: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges of loads and inputs, by column, in the column's unit."""
    seconds: float | None = None
    why: str = ""
    """Where this comes from: the plan, or the logs of the model."""


@dataclass(frozen=True)
class RecordedColumn:
    """One column of a recording."""

    name: str
    low: float | None
    """Least value; null before the first reading."""
    high: float | None
    last: float | None
    """Value of the last row; null: no reading."""
    missing: int
    """Rows without a reading."""


@dataclass(frozen=True)
class CoveredRange:
    """How much of a wanted range is covered."""

    what: str
    """A column, `heating`, `cooling` or `time`."""
    unit: str
    low: float
    high: float
    """What was reached, as `low`."""
    wanted_low: float
    wanted_high: float
    share: float
    """Of the wanted range, 0 to 1."""
    enough: bool


@dataclass(frozen=True)
class Covered:
    """A recording so far."""

    rows: int
    seconds: float
    columns: tuple[RecordedColumn, ...]
    heating_K_per_min: float | None
    """Fastest over a minute; null before one was recorded."""
    cooling_K_per_min: float | None
    wanted: tuple[CoveredRange, ...]
    enough: bool | None
    """Whether all that is wanted is covered; null where nothing is."""


class Coverage:
    """Follows a recording row by row.

    Args:
        temperature: the thermometer's column, degC; "" without one.
        wanted: what should be covered.
    """

    def __init__(self, temperature: str, wanted: Wanted) -> None:
        self._temperature, self._wanted = temperature, wanted
        self._columns: dict[str, _Range] = {}
        self._rows = 0
        self._first_s: float | None = None
        self._last_s = 0.0
        self._minute: deque[tuple[float, float]] = deque()
        self._heating: float | None = None
        self._cooling: float | None = None

    def add(self, at_s: float, values: Values) -> None:
        """Take one row, at a time that does not run backwards."""
        self._first_s = at_s if self._first_s is None else self._first_s
        self._last_s = at_s
        for name in [name for name in values if name not in self._columns]:
            self._columns[name] = _Range(missing=self._rows)
        for name, column in self._columns.items():
            column.add(values.get(name, math.nan))
        self._rows += 1
        warm = values.get(self._temperature, math.nan)
        if math.isfinite(warm):
            self._follow(at_s, warm)

    def _follow(self, at_s: float, warm: float) -> None:
        self._minute.append((at_s, warm))
        while len(self._minute) > 2 and at_s - self._minute[1][0] >= RATE_OVER_S:
            self._minute.popleft()
        since_s, before = self._minute[0]
        if at_s - since_s < RATE_OVER_S:
            return
        rate = (warm - before) / (at_s - since_s) * 60.0
        self._heating = max(rate, self._heating or 0.0)
        self._cooling = max(-rate, self._cooling or 0.0)

    def describe(self) -> Covered:
        """Return the recording so far."""
        seconds = 0.0 if self._first_s is None else self._last_s - self._first_s
        wanted = tuple(self._list_wanted(seconds))
        return Covered(
            rows=self._rows,
            seconds=round(seconds, 3),
            columns=tuple(column.describe(name) for name, column in self._columns.items()),
            heating_K_per_min=None if self._heating is None else round(self._heating, 3),
            cooling_K_per_min=None if self._cooling is None else round(self._cooling, 3),
            wanted=wanted,
            enough=all(one.enough for one in wanted) if wanted else None,
        )

    def _list_wanted(self, seconds: float) -> list[CoveredRange]:
        ranges = dict(self._wanted.columns)
        if self._wanted.temperature_degC is not None and self._temperature:
            ranges = {self._temperature: self._wanted.temperature_degC} | ranges
        found = []
        for name, (low, high) in ranges.items():
            unit = "degC" if name == self._temperature else ""
            found.append(self._compare_range(name, unit, low, high))
        for what, reached, rate in (
            ("heating", self._heating, self._wanted.heating_K_per_min),
            ("cooling", self._cooling, self._wanted.cooling_K_per_min),
        ):
            if rate:
                found.append(_compare_size(what, "K/min", reached or 0.0, rate, RATE_SHARE))
        if self._wanted.seconds:
            found.append(_compare_size("time", "s", seconds, self._wanted.seconds, SHARE))
        return found

    def _compare_range(self, name: str, unit: str, low: float, high: float) -> CoveredRange:
        column = self._columns.get(name)
        if column is None or column.low > column.high:
            return CoveredRange(name, unit, 0.0, 0.0, low, high, 0.0, enough=False)
        within = max(0.0, min(column.high, high) - max(column.low, low))
        share = within / (high - low) if high > low else 1.0
        return CoveredRange(
            name, unit, column.low, column.high, low, high, round(share, 4), share >= SHARE
        )


def _compare_size(
    what: str, unit: str, reached: float, wanted: float, least: float
) -> CoveredRange:
    share = min(reached / wanted, 1.0)
    reached = round(reached, 3)
    return CoveredRange(what, unit, 0.0, reached, 0.0, wanted, round(share, 4), share >= least)


class _Range:
    def __init__(self, missing: int) -> None:
        self.low, self.high, self.last = math.inf, -math.inf, math.nan
        self.missing = missing

    def add(self, value: float) -> None:
        self.last = value
        if math.isfinite(value):
            self.low, self.high = min(self.low, value), max(self.high, value)
        else:
            self.missing += 1

    def describe(self, name: str) -> RecordedColumn:
        some = self.low <= self.high
        return RecordedColumn(
            name,
            self.low if some else None,
            self.high if some else None,
            self.last if math.isfinite(self.last) else None,
            self.missing,
        )
