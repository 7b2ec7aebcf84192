"""Reads the times of logs as seconds: formats, zones, midnight.

Seconds count from 1970 where the log says or implies which instant is meant (a zone in the text,
`zone` in zerodrift.toml, Unix time); on a local clock of unknown zone, from 1970 as that clock
shows it; for a time of day, from the first midnight.
"""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo, available_timezones

import numpy as np
import polars as pl

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import TIME_UNITS, TimeConfig, read_fixed_zone
from zerodrift.base.errors import InputError
from zerodrift.dataset.units import read_time_unit, write_local

# The formats in which logs write dates and times, told from their texts.

_DATES = (
    (r"(?P<y>\d{4})(?P<s>[-/.])\d{1,2}(?P=s)\d{1,2}", ("%Y{s}%m{s}%d",)),
    (r"\d{1,2}(?P<s>\.)\d{1,2}\.\d{4}", ("%d.%m.%Y",)),
    (r"\d{1,2}(?P<s>\.)\d{1,2}\.\d{2}", ("%d.%m.%y",)),
    (r"\d{1,2}(?P<s>[-/])\d{1,2}(?P=s)\d{4}", ("%d{s}%m{s}%Y", "%m{s}%d{s}%Y")),
    (r"\d{1,2}(?P<s>/)\d{1,2}/\d{2}", ("%d/%m/%y", "%m/%d/%y")),
    (r"\d{1,2}(?P<s>-)\d{1,2}-\d{2}", ("%d-%m-%y", "%m-%d-%y", "%y-%m-%d")),
    (r"\d{1,2}(?P<s>[- ])[A-Za-z]{3}(?P=s)\d{4}", ("%d{s}%b{s}%Y",)),
    (r"\d{1,2}(?P<s>[- ])[A-Za-z]{3}(?P=s)\d{2}", ("%d{s}%b{s}%y",)),
    (r"(?P<s>)\d{8}(?=[T _-])", ("%Y%m%d",)),
    (r"(?P<s>)\d{4}-\d{3}(?=T)", ("%Y-%j",)),
)
"""Pattern of a date -> its formats; with points a date is day-first everywhere."""
_TIME = re.compile(
    r"(?P<between>T|[ ,;_-]+|)(?P<h>\d{1,2})(?::(?P<m>\d\d)(?P<sec>:\d\d(?P<f>[.,]\d+)?)?"
    r"|(?P<c>\d{4}(?:\d\d)?))(?P<ampm> ?[AaPp][Mm])?(?P<zone> ?(?:Z|UTC|[+-]\d\d:?(?:\d\d)?))?"
)
OF_DAY = re.compile(r"\d+:\d\d(:\d\d([.,]\d+)?)?( ?[AaPp][Mm])?")


@dataclass(frozen=True)
class TimeFormat:
    """One way in which text can be read as a time."""

    format: str
    """As Polars takes it."""
    kind: str
    """zoned | local | day."""

    @property
    def written(self) -> str:
        """Return the format as zerodrift.toml writes it."""
        return self.format.replace("%.f", ".%f").replace("%#z", "%z")

    @property
    def words(self) -> str:
        """Return in words what distinguishes it from the other formats."""
        places = [self.format.find(code) for code in ("%d", "%m", "%y")]
        day, month, year = places
        if 0 <= year < min(day, month):
            return "year first"
        return "day first" if day < month else "month first"


def list_formats(text: str) -> list[TimeFormat]:
    """Return the ways in which a text of this look may be read as a time; none if it is no time."""
    bare = text.strip()
    if OF_DAY.fullmatch(bare):
        has_half = bare[-1] in "mM"
        seconds = ":%S%.f" if bare.count(":") == 2 else ""
        space = " " if " " in bare else ""
        return [TimeFormat(f"%I:%M{seconds}{space}%p" if has_half else "%H:%M:%S", "day")]
    for pattern, dates in _DATES:
        match = re.match(pattern, bare)
        time = None if match is None else _write_time_format(bare[match.end() :])
        if match is not None and time is not None:
            suffix, kind = time
            return [TimeFormat(date.format(s=match["s"]) + suffix, kind) for date in dates]
    return []


def agree_on_formats(texts: Sequence[str]) -> list[TimeFormat]:
    """Return the formats that read the most of the texts, at least nine in ten."""
    looks = dict.fromkeys(each for text in texts[:16] for each in list_formats(text))
    series = pl.Series(texts, dtype=pl.String).str.strip_chars()
    counts = {each: _count_read(series, each) for each in looks}
    most = max(counts.values(), default=0)
    found = [each for each, count in counts.items() if count == most]
    return found if most >= 0.9 * len(texts) and most > 0 else []


def _count_read(texts: pl.Series, known: TimeFormat) -> int:
    """Return how many of the texts can be read by a format."""
    if known.kind == "day":
        return int(texts.str.contains(f"^(?:{OF_DAY.pattern})$").sum())
    bare = texts.str.strip_suffix(" UTC")
    if ".f" in known.format:
        bare = bare.str.replace(r",(\d+)", ".$1")
    try:
        read = bare.str.to_datetime(known.format, strict=False, time_unit="us")
    except pl.exceptions.PolarsError:
        return 0
    return len(read) - read.null_count()


def _write_time_format(rest: str) -> tuple[str, str] | None:
    """Return the format of what follows a date, and the kind of time it makes; None: none."""
    if not rest:
        return "", "local"
    match = _TIME.fullmatch(rest)
    if match is None:
        return None
    hour = "%I" if match["ampm"] else "%H"
    if match["c"]:
        clock = f"{hour}%M%S" if len(match["c"]) == 4 else f"{hour}%M"
    else:
        clock = f"{hour}:%M" + (":%S%.f" if match["sec"] else "")
    if match["ampm"]:
        clock += " %p" if match["ampm"].startswith(" ") else "%p"
    zone = match["zone"] or ""
    if zone.strip() == "UTC":
        return match["between"] + clock, "zoned"
    space = " " if zone.startswith(" ") else ""
    return match["between"] + clock + (f"{space}%#z" if zone else ""), "zoned" if zone else "local"


# Reads the times of logs as seconds: formats, zones, midnight.

DAY_S = 86400.0
HALF_DAY_S = DAY_S / 2
MINUTE_S = 60.0
_SECONDS = "%S%.f"
_SECONDS_AT = 17
_EVEN = re.compile(r"(\d{4}[-/.]\d\d[-/.]\d\d|\d\d[-/.]\d\d[-/.]\d{4})[T ]\d\d:\d\d:\d\d([.,]\d+)?")
SAMPLE = 64
_EPOCH = datetime(1970, 1, 1)


@dataclass(frozen=True)
class Clock:
    """How one log's column of times is read."""

    columns: tuple[str, ...]
    kind: str
    """number | zoned | local | day | rows."""
    name: str
    """What the times are called among the table's columns."""
    format: str = ""
    """For text, as Polars takes it; empty for a column of dates and times as such."""
    has_comma: bool = False
    """For text: the fractions of seconds are written with a comma."""
    is_even: bool = False
    """For text: ends in two-digit seconds at the same place in every row, as far as was seen."""
    unit_s: float = 1.0
    """For numbers: seconds per count."""
    zone: str = ""
    """Time zone of a local clock; empty: not known."""
    period_s: float = 0.0
    """For rows without times: the interval between them, in s."""
    offset_s: float = 0.0
    """Added to the times, in s, as zerodrift.toml states."""

    @property
    def is_absolute(self) -> bool | None:
        """Tell whether the seconds are of one time scale with those of other logs.

        None: they are numbers; only their size can show it.
        """
        if self.kind == "number":
            return None
        return self.kind == "zoned" or (self.kind == "local" and bool(self.zone))

    def read(self, schema: pl.Schema) -> pl.Expr:
        """Return the expression of the times in seconds, as float64; null where there is none."""
        first = pl.col(self.columns[0])
        if self.kind == "number":
            return first.cast(pl.Float64).alias(self.name)
        dtype = schema[self.columns[0]]
        if dtype == pl.Time:
            return (first.cast(pl.Int64) / 1e9).alias(self.name)
        if dtype == pl.Duration:
            return (first.dt.total_microseconds() / 1e6).alias(self.name)
        if dtype.is_temporal():
            ticks = {"ms": 1e3, "us": 1e6, "ns": 1e9}[getattr(dtype, "time_unit", None) or "us"]
            at = first if isinstance(dtype, pl.Datetime) else first.cast(pl.Datetime("us"))
            return (at.cast(pl.Int64) / ticks).alias(self.name)
        text = first.str.strip_chars()
        if len(self.columns) == 2:
            text = pl.concat_str(text, pl.col(self.columns[1]).str.strip_chars(), separator=" ")
        if self.kind == "day" and "%I" not in self.format:
            return _read_time_of_day(text).alias(self.name)
        if self.has_comma:
            text = text.str.replace(r",(\d+)", ".$1")
        if self.kind == "day":
            read = ("2000-01-01 " + text).str.to_datetime(
                f"%Y-%m-%d {self.format}", strict=False, time_unit="us", cache=False
            )
            return (read.cast(pl.Int64) / 1e6 % DAY_S).alias(self.name)
        if self.kind == "zoned" and "z" not in self.format:
            text = text.str.strip_suffix(" UTC")
        if self.is_even:
            # What comes before the seconds is the same in many rows, and so is read once.
            minute = text.str.slice(0, _SECONDS_AT).str.to_datetime(
                self.format.removesuffix(_SECONDS), strict=False, time_unit="us"
            )
            seconds = text.str.slice(_SECONDS_AT).cast(pl.Float64, strict=False)
            within = pl.when((seconds >= 0) & (seconds < MINUTE_S)).then(seconds)
            return (minute.cast(pl.Int64) / 1e6 + within).alias(self.name)
        # Times of a log are all different: a cache of them costs more than it saves.
        read = text.str.to_datetime(self.format, strict=False, time_unit="us", cache=False)
        return (read.cast(pl.Int64) / 1e6).alias(self.name)

    def settle(self, values: Array, label: str) -> Array:
        """Return the times [n] of a log as read, on its time scale: unit, midnight, zone.

        Raises:
            InputError: a time does not exist in its zone, or exists twice and the order of rows
                does not decide which is meant.
        """
        if self.kind == "number":
            values *= self.unit_s
        elif self.kind == "day":
            values = _unwrap_midnight(values)
        elif self.kind == "local" and self.zone:
            values = place_in_zone(values, self.zone, label, self.name)
        if self.offset_s:
            values += self.offset_s
        return values


def find_clock(
    time: TimeConfig,
    values: Sequence[pl.Series],
    label: str,
    find_all: Callable[[], Sequence[pl.Series]] | None = None,
) -> Clock:
    """Find out how a log's times are written.

    Args:
        time: what zerodrift.toml states of them.
        values: the first values of each of its columns.
        label: how messages name the log.
        find_all: returns all different values, looked at where the first leave a choice.

    Raises:
        InputError: the text is no known form of time, or can be read in two ways.
    """
    usual = Clock(time.columns, "number", time.name, zone=time.zone)
    first = values[0].drop_nulls()
    if first.dtype.is_numeric() and len(time.columns) == 1:
        unit = time.unit or read_time_unit(time.columns[0]) or "s"
        return replace(usual, unit_s=TIME_UNITS[unit])
    if first.dtype.is_temporal():
        is_zoned = isinstance(first.dtype, pl.Datetime) and first.dtype.time_zone is not None
        of_day = first.dtype in (pl.Time, pl.Duration)
        return replace(usual, kind="zoned" if is_zoned else "day" if of_day else "local")
    texts = join_texts([series.cast(pl.String) for series in values])
    if time.format:
        written = _translate(time.format)
        has_date = any(code in written for code in ("%d", "%j", "%F", "%x", "%c", "%D"))
        kind = "zoned" if "%z" in written or "%#z" in written else "local" if has_date else "day"
        return replace(usual, kind=kind, format=written, has_comma=_have_comma(texts))
    if not texts or (len(time.columns) == 1 and _are_numbers(texts)):
        unit = time.unit or read_time_unit(time.columns[0]) or "s"
        return replace(usual, unit_s=TIME_UNITS[unit])
    formats = agree_on_formats(texts)
    if len(formats) > 1 and find_all is not None:
        formats = agree_on_formats(join_texts([series.cast(pl.String) for series in find_all()]))
    table = f'[sensor] time = {{ column = "{time.columns[0]}", format = "%d.%m.%Y %H:%M:%S" }}'
    if not formats:
        raise InputError(
            f"{label}: column '{time.name}' holds '{texts[0][:40]}', which is no number and no "
            f"time that is known; expected seconds, ISO 8601, or a format that is stated. Write "
            f"{table}, with the codes of strftime for what stands there."
        )
    if len(formats) > 1:
        ways = " or ".join(f'"{each.written}" ({each.words})' for each in formats)
        raise InputError(
            f"{label}: column '{time.name}' holds '{texts[0][:40]}', which reads as {ways}; "
            f"expected one meaning. State it: [sensor] time = {{ column = "
            f'"{time.columns[0]}", format = "{formats[0].written}" }}, or the other.'
        )
    (known,) = formats
    is_even = known.format.endswith(_SECONDS) and all(map(_EVEN.fullmatch, texts))
    return replace(
        usual,
        kind=known.kind,
        format=known.format,
        has_comma=_have_comma(texts),
        is_even=is_even,
    )


def place_in_zone(local_s: Array, zone: str, label: str, column: str) -> Array:
    """Return local times [n], in the order of the log, as seconds from 1970 in UTC.

    The hour that a zone has twice is taken as its first pass up to the row where the clock goes
    back, and as its second from there.

    Raises:
        InputError: no such zone, a time that it does not have, or a repeated hour that the order of
            rows does not resolve.
    """
    fixed = read_fixed_zone(zone)
    if fixed is not None:
        return local_s - fixed
    finite = np.isfinite(local_s)
    ticks = pl.Series(np.where(finite, local_s * 1e6, 0).astype(np.int64)).cast(pl.Datetime("us"))
    try:
        early, late = (
            ticks.dt.replace_time_zone(zone, ambiguous=which, non_existent="null")
            for which in ("earliest", "latest")
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(
            f"{label}: there is no time zone '{zone}'; expected a name such as Europe/Berlin, or "
            "a difference to UTC such as +02:00. Correct zone in [sensor] time."
        ) from error
    missing = early.is_null().to_numpy() & finite
    if missing.any():
        row = int(np.argmax(missing))
        raise InputError(
            f"{label}: row {row + 1}: {column} is {write_local(local_s[row])}, which {zone} does "
            "not have, as its clocks go forward there; expected times that exist. If the log's "
            "clock was not put forward, state a fixed zone such as +01:00."
        )
    first, second = (each.dt.epoch("us").to_numpy() / 1e6 for each in (early, late))
    shown = local_s - local_s.round()
    first, second = first.round() + shown, second.round() + shown
    twice = (second != first) & finite
    if not twice.any():
        return np.where(finite, first, np.nan)
    return np.where(finite, _order_repeated(local_s, first, second, twice, zone, label), np.nan)


def find_zone(local_s: Array) -> str:
    """Return a zone whose clocks were put back where a local clock goes back; "" without any.

    Of several the machine's own, then those of Berlin and New York, then the first by name.

    Args:
        local_s: times [n] by the log's clock, in s since 1970 as if it were UTC.
    """
    known = local_s[np.isfinite(local_s)]
    back = np.flatnonzero(np.diff(known) < 0)
    if not back.size:
        return ""
    ends = [_EPOCH + timedelta(seconds=float(known[at])) for at in (back[0], back[0] + 1)]
    names = [*_list_own_zone(), "Europe/Berlin", "America/New_York", *sorted(available_timezones())]
    return next((name for name in names if all(_is_twice(name, end) for end in ends)), "")


def _list_own_zone() -> list[str]:
    """Return the name of this machine's zone, where it has one."""
    name = os.environ.get("TZ", "")
    link = Path("/etc/localtime")
    if not name and link.is_symlink():
        name = os.fspath(link.readlink()).partition("zoneinfo/")[2]
    return [name] if name in available_timezones() else []


def _is_twice(name: str, local: datetime) -> bool:
    """Tell whether a zone has a local time twice, before and after its clocks are put back."""
    zone = ZoneInfo(name)
    first, second = (local.replace(tzinfo=zone, fold=fold).utcoffset() for fold in (0, 1))
    return first is not None and second is not None and first > second


def _order_repeated(
    local_s: Array, first: Array, second: Array, twice: np.ndarray, zone: str, label: str
) -> Array:
    """Return the times, each repeated hour resolved by the order of its rows."""
    found = first.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], twice.astype(np.int8), [0]])))
    usual_s = float(np.median(np.diff(first))) if first.size > 1 else 0.0
    near_s = max(3 * usual_s, 60.0)
    for begin, end in edges.reshape(-1, 2):
        back = begin + 1 + np.flatnonzero(np.diff(local_s[begin:end]) < 0)
        if back.size == 1:
            found[back[0] : end] = second[back[0] : end]
            continue
        if back.size > 1:
            raise InputError(_explain_repeated(label, zone, local_s[begin], "more than once"))
        follows = begin > 0 and first[begin] - first[begin - 1] <= near_s
        precedes = end < first.size and first[end] - second[end - 1] <= near_s
        if follows == precedes:
            how = "not at all, and rows stand before and after it" if follows else "not at all"
            raise InputError(_explain_repeated(label, zone, local_s[begin], how))
        if precedes:
            found[begin:end] = second[begin:end]
    return found


def _explain_repeated(label: str, zone: str, local_s: float, how: str) -> str:
    return (
        f"{label}: the hour from {write_local(local_s)} on is there twice in {zone}, and the log's "
        f"clock goes back in it {how}; expected it to go back once, which shows which is which. If "
        "the clock was not put back, state a fixed zone such as +01:00; else split the log there."
    )


def _unwrap_midnight(values: Array) -> Array:
    """Return times of day [n] that go on over midnight."""
    finite = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[finite])
    days = np.zeros(values.size)
    wraps = np.concatenate([[0], np.cumsum(steps < -HALF_DAY_S)])
    days[finite] = wraps[: finite.size]
    return values + DAY_S * days


def _read_time_of_day(text: pl.Expr) -> pl.Expr:
    """Return HH:MM or HH:MM:SS.f, the hours of any size, as seconds."""
    parts = text.str.replace(",", ".", literal=True).str.split(":")
    number = [parts.list.get(k, null_on_oob=True).cast(pl.Float64, strict=False) for k in range(3)]
    return 3600 * number[0] + 60 * number[1] + number[2].fill_null(0.0)


def _translate(stated: str) -> str:
    """Return a format by strftime's codes as Polars takes it."""
    written = stated.replace(".%f", "%.f").replace(",%f", "%.f").replace("%z", "%#z")
    return written if "%.f" in written or "%S" not in written else written.replace("%S", "%S%.f")


def _have_comma(texts: Sequence[str]) -> bool:
    """Tell whether fractions of seconds are written with a comma."""
    return any(re.search(r":\d\d,\d", text) is not None for text in texts)


def _are_numbers(texts: Sequence[str]) -> bool:
    """Tell whether most of the texts are numbers, so that the others are mistakes."""
    read = pl.Series(texts).str.strip_chars().str.replace(",", ".", literal=True)
    return read.cast(pl.Float64, strict=False).null_count() <= len(texts) / 2


def join_texts(columns: Sequence[pl.Series]) -> list[str]:
    """Return the texts of one column, or of a date and a time of day, that are not empty."""
    rows = zip(*(series.to_list() for series in columns), strict=True)
    return [
        " ".join(part.strip() for part in row)
        for row in rows
        if all(part is not None and part.strip() for part in row)
    ]
