"""The formats in which logs write dates and times, told from their texts."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl

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
