"""Surveys a log's file: kind, unit, range and changes of each column."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import TIME_UNITS, TimeConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import (
    PARSER_ERRORS,
    RUN_COLUMN,
    Source,
    mend_source,
    write_text,
)
from zerodrift.dataset.text_format import UNNAMED
from zerodrift.dataset.times import (
    Clock,
    TimeFormat,
    agree_on_formats,
    find_clock,
    join_texts,
    list_formats,
)
from zerodrift.dataset.units import guess_time_unit, normalise_unit, read_time_unit, read_unit

HEAD_ROWS = 1000
SAMPLE_ROWS = 20_000
"""Rows, evenly spaced, by which columns are held against each other."""


@dataclass(frozen=True)
class SurveyedColumn:
    """A column of numbers."""

    name: str
    unit: str
    """As its name or the row of units says; empty: neither does."""
    low: float
    high: float
    median: float
    distinct: int
    """Different values, about."""
    changes: float
    """Share of the rows whose value differs from the row before."""
    rises: bool
    """Every row is above the one before."""

    @property
    def is_constant(self) -> bool:
        """Tell whether it never moves."""
        return self.low == self.high


@dataclass(frozen=True)
class Times:
    """A column, or two, that can be a log's times."""

    config: TimeConfig
    """As zerodrift.toml is to name it; `unit` or `format` only where they have to be stated."""
    alternatives: tuple[TimeFormat, ...]
    """Other ways in which the text can be read."""
    clock: Clock
    seconds: Array
    """[n] as read, all rows."""
    is_unit_guessed: bool = False

    @property
    def period_s(self) -> float:
        """Return the median interval between rows whose times rise."""
        steps = np.diff(self.seconds)
        rising = steps[steps > 0]
        return float(np.median(rising)) if rising.size else 0.0


@dataclass(frozen=True)
class Survey:
    """One file."""

    source: Source
    rows: int
    columns: tuple[SurveyedColumn, ...]
    """Numbers, those of `times` left out."""
    texts: dict[str, tuple[str, ...]]
    """Columns of text -> their first different values."""
    times: Times | None
    runs: tuple[str, ...]
    """Values of the `run` column; empty without one."""
    sample: dict[str, Array]
    """Column -> values [m] at some rows."""

    def column(self, name: str) -> SurveyedColumn:
        """Return a column by its name."""
        return next(column for column in self.columns if column.name == name)


TIME_NAMES = ("time_s", "t_s", "elapsed_s", "time", "t", "elapsed", "seconds", "timestamp_s")
TIME_WORDS = {
    "time",
    "timestamp",
    "elapsed",
    "zeit",
    "datetime",
    "date",
    "datum",
    "temps",
    "hora",
    "ts",
}
CLOCK_WORDS = {"clock", "unix", "epoch", "utc"}
UNIT_WORDS = {"t", "sec", "secs", "millis", "micros", "nanos", "minutes", "hours"}
"""With a unit of time these are the time; alone `t` may be a temperature."""
UNIX_S = (1e9, 4e9)
"""Numbers of this size, or 10**3, 10**6 or 10**9 times as large, that rise from row to row may be
Unix times by whatever name: 2001 to 2096."""


def survey_source(source: Source) -> Survey:
    """Look at a file's columns.

    Raises:
        InputError: it is damaged or has no row.
    """
    try:
        return _survey(source)
    except PARSER_ERRORS as error:
        return survey_source(mend_source(source, error))


def _survey(source: Source) -> Survey:
    names = [name for name in source.names if not name.startswith(UNNAMED)]
    head = source.sample(names, HEAD_ROWS)
    if not head or not len(head[0]):
        raise InputError(f"{source.label}: there is a header but no row; expected one per sample.")
    has_comma = source.text is not None and source.text.decimal_comma
    numeric = [series.name for series in head if _is_numeric(series, has_comma)]
    columns, rows, sample = _measure(source, numeric)
    others = [name for name in names if name not in numeric and name != RUN_COLUMN]
    texts = {name: list_values(source, name) for name in others}
    times = _find_times(source, head, columns)
    used = () if times is None else times.config.columns
    return Survey(
        source,
        rows,
        tuple(column for column in columns if column.name not in used),
        {name: values for name, values in texts.items() if name not in used},
        times,
        list_values(source, RUN_COLUMN) if RUN_COLUMN in names else (),
        {name: values for name, values in sample.items() if name not in used},
    )


def write_range(low: float, high: float) -> str:
    """Return `low to high` with enough digits to distinguish them, also for Unix times."""
    apart, largest = abs(high - low), max(abs(low), abs(high))
    digits = 6
    if apart > 0 and np.isfinite(largest):
        needed = int(np.ceil(np.log10(largest / apart))) + 4
        if needed > digits:
            digits = min(max(needed, int(np.log10(max(largest, 1.0))) + 1), 16)
    return f"{low:.{digits}g} to {high:.{digits}g}"


def words(name: str) -> set[str]:
    """Return the words of a column's name, in lower case."""
    return {word.lower() for word in re.split(r"[^A-Za-z0-9]+", name) if word}


def _is_numeric(series: pl.Series, has_comma: bool) -> bool:
    """Tell whether nine in ten values of a column, and at least one, are numbers."""
    if series.dtype.is_numeric():
        return True
    if series.dtype != pl.String:
        return False
    bare = series.drop_nulls().str.strip_chars()
    bare = bare.filter(bare != "")
    if has_comma:
        bare = bare.str.replace(",", ".", literal=True)
    read = bare.cast(pl.Float64, strict=False)
    return len(bare) > 0 and len(bare) - read.null_count() >= 0.9 * len(bare)


def _measure(
    source: Source, numeric: Sequence[str]
) -> tuple[list[SurveyedColumn], int, dict[str, Array]]:
    """Return what the columns of numbers hold, in one pass."""
    frame = source.scan(numeric).select(pl.col(name).cast(pl.Float64) for name in numeric)
    wanted = [pl.len().alias("rows")]
    for i, name in enumerate(numeric):
        value = pl.col(name).fill_nan(None)
        known = value.drop_nulls()
        wanted += [
            value.min().alias(f"{i} low"),
            value.max().alias(f"{i} high"),
            value.median().alias(f"{i} median"),
            value.approx_n_unique().alias(f"{i} distinct"),
            (known.diff() != 0).mean().alias(f"{i} changes"),
            (known.diff() > 0).all().alias(f"{i} rises"),
        ]
    found = frame.select(wanted).collect().row(0, named=True)
    rows = int(found["rows"])
    some = frame.gather_every(max(1, rows // SAMPLE_ROWS)).collect()
    columns = [
        SurveyedColumn(
            name,
            normalise_unit(source.units.get(name, ""), name) or read_unit(name),
            float(found[f"{i} low"]),
            float(found[f"{i} high"]),
            float(found[f"{i} median"]),
            int(found[f"{i} distinct"]),
            float(found[f"{i} changes"] or 0.0),
            bool(found[f"{i} rises"]),
        )
        for i, name in enumerate(numeric)
        if found[f"{i} low"] is not None
    ]
    sample = {name: some[name].fill_null(np.nan).to_numpy() for name in numeric}
    return columns, rows, sample


def list_values(source: Source, column: str) -> tuple[str, ...]:
    """Return the different values of a column of text, in the order of appearance."""
    frame = source.scan()
    values = frame.select(write_text(column, frame).unique(maintain_order=True))
    return tuple(values.collect().to_series().drop_nulls())


def _find_times(
    source: Source, head: Sequence[pl.Series], columns: Sequence[SurveyedColumn]
) -> Times | None:
    """Return the column most likely to be the times; None: none is."""
    by_name = {series.name: series for series in head}
    numbers = [column.name for column in columns]
    lower = {name.lower(): name for name in reversed(numbers)}
    named = [lower[name] for name in TIME_NAMES if name in lower]
    if not named:
        for config, alternatives in _list_texts(source, by_name):
            return _read_times(source, config, alternatives)
    clocks = [name for name in numbers if words(name) & CLOCK_WORDS]
    loose = [name for name in numbers if words(name) & TIME_WORDS]
    loose += [name for name in numbers if read_time_unit(name) and words(name) & UNIT_WORDS]
    candidates = [*named, *(name for name in loose if name not in clocks), *clocks]
    if not candidates:
        candidates = [c.name for c in columns if c.rises and _may_be_unix(c.low)][:1]
    if source.text is not None and source.text.header_line == 0:
        # Without names, what rises from row to row, unlike a counter of rows by more than one.
        candidates = [column.name for column in columns if column.rises and column.low != 1][:1]
    return _read_times(source, TimeConfig((candidates[0],)), ()) if candidates else None


def _may_be_unix(value: float) -> bool:
    return any(UNIX_S[0] * per <= value <= UNIX_S[1] * per for per in (1.0, 1e3, 1e6, 1e9))


def _list_texts(
    source: Source, head: dict[str, pl.Series]
) -> list[tuple[TimeConfig, tuple[TimeFormat, ...]]]:
    """Return the columns of text, or of dates as such, that are times; those with a date first."""
    dated: list[tuple[TimeConfig, tuple[TimeFormat, ...]]] = []
    of_day: list[tuple[TimeConfig, tuple[TimeFormat, ...]]] = []
    dates: list[str] = []
    for name, series in head.items():
        if series.dtype.is_temporal():
            (of_day if series.dtype in (pl.Time, pl.Duration) else dated).append(
                (TimeConfig((name,)), ())
            )
            continue
        if series.dtype != pl.String:
            continue
        texts = join_texts([series])
        formats = agree_on_formats(texts) if texts and list_formats(texts[0]) else []
        if not formats:
            continue
        if len(formats) > 1:
            formats = agree_on_formats(join_texts(source.sample([name], None)))
        if formats[0].kind == "day":
            of_day.append((TimeConfig((name,)), ()))
        elif "%H" in formats[0].format or "%I" in formats[0].format:
            dated.append(_state_format(name, formats, source))
        else:
            dates.append(name)
    if not dated and dates and of_day:
        both = (dates[0], of_day[0][0].columns[0])
        formats = agree_on_formats(join_texts([head[name] for name in both]))
        if len(formats) > 1:
            formats = agree_on_formats(join_texts(source.sample(both, None)))
        config, others = _state_format(dates[0], formats, source)
        return [(TimeConfig(both, format=config.format), others)]
    return [*dated, *of_day]


def _state_format(
    name: str, formats: Sequence[TimeFormat], source: Source
) -> tuple[TimeConfig, tuple[TimeFormat, ...]]:
    """Return a column of times; where it can be read in two ways, in the one of the shorter log."""
    if len(formats) == 1:
        return TimeConfig((name,)), ()
    ordered = sorted(formats, key=lambda each: _measure_span(source, name, each))
    return TimeConfig((name,), format=ordered[0].written), tuple(ordered[1:])


def _measure_span(source: Source, name: str, known: TimeFormat) -> float:
    clock = Clock((name,), known.kind, name, format=known.format)
    (series,) = source.sample([name], None)
    frame = pl.DataFrame({name: series})
    seconds = frame.select(clock.read(frame.schema)).to_series().drop_nulls()
    span = seconds.max(), seconds.min()
    return float(span[0]) - float(span[1]) if len(seconds) else np.inf  # type: ignore[arg-type]


def _read_times(
    source: Source, config: TimeConfig, alternatives: tuple[TimeFormat, ...]
) -> Times | None:
    values = source.sample(config.columns, HEAD_ROWS)
    try:
        clock = find_clock(
            config, values, source.label, lambda: source.sample(config.columns, None)
        )
        frame = source.scan(config.columns if clock.kind == "number" else ())
        expression = clock.read(frame.collect_schema())
        seconds = frame.select(expression).collect().to_series().fill_null(np.nan).to_numpy()
        seconds = clock.settle(np.array(seconds, dtype=np.float64), source.label)
    except (InputError, *PARSER_ERRORS) as error:
        if isinstance(error, OSError) or isinstance(error.__cause__, OSError):
            raise
        return None
    seconds = seconds[np.isfinite(seconds)]
    if seconds.size < 2:
        return None
    found = Times(config, alternatives, clock, seconds)
    if clock.kind == "number" and not read_time_unit(config.columns[0]):
        written = source.units.get(config.columns[0], "").strip()
        if written in TIME_UNITS and written != "s":  # stated by the row of units, or by the format
            stated = TimeConfig(config.columns, unit=written)
            return Times(stated, (), clock, seconds * TIME_UNITS[written])
        if written in TIME_UNITS:
            return found
        unit = guess_time_unit(float(seconds[0]), found.period_s)
        if unit:
            stated = TimeConfig(config.columns, unit=unit)
            return Times(stated, (), clock, seconds * TIME_UNITS[unit], is_unit_guessed=True)
    return found
