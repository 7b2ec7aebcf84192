"""Units of measure, as column names carry them, and units of time."""

import re

import numpy as np

from zerodrift.base.column_config import TIME_UNITS
from zerodrift.base.errors import InputError

# Units of time: as a column's name or zerodrift.toml states, and as the times suggest.

_WORDS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "millisecond", "milliseconds"),
    "us": ("us", "usec", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosecond", "nanoseconds"),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("h", "hr", "hrs", "hour", "hours"),
}
_UNIT_OF = {word: unit for unit, words in _WORDS.items() for word in words}
UNIX_S = (1e8, 1e11)
"""Seconds of this size count from 1970: 1973 to 5138."""
_EPOCHS = (("ns", 1e17, 1e20), ("us", 1e14, 1e17), ("ms", 1e11, 1e14))
"""Times as large as this count from 1970 in these units: 1973 to 5138."""
SLOWEST_S = 500.0
FASTEST_S = 0.002
"""A row less often or more often than this is not believed without the unit stated."""
ALIKE = 0.02


def is_unix(time_s: float) -> bool:
    """Return whether seconds of this size count from 1970, and not from a log's begin."""
    return UNIX_S[0] < time_s < UNIX_S[1]


def write_local(time_s: float) -> str:
    """Return seconds from 1970 as the date and time that they stand for."""
    return str(np.datetime64(round(time_s), "s")).replace("T", " ")


def write_time(time_s: float) -> str:
    """Return a time in seconds with enough digits to be unambiguous; a Unix time as a date."""
    if is_unix(time_s):
        return write_local(time_s)
    return f"{time_s:.6g}" if abs(time_s) < 1e5 else f"{time_s:.1f}".removesuffix(".0")


def tell_time(time_s: float) -> str:
    """Return the same with its unit."""
    return write_time(time_s) + ("" if is_unix(time_s) else " s")


def write_duration(seconds: float) -> str:
    """Return a time as people say it."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def read_time_unit(column: str) -> str:
    """Return the unit that a time column's name states (`t_ms`, `Time (min)`), or nothing."""
    match = re.search(r"(?:^|[\s_\[(])([A-Za-z]+)[\])]?$", column.strip())
    return _UNIT_OF.get(match.group(1).lower(), "") if match else ""


def guess_time_unit(first: float, period: float) -> str:
    """Return the unit that times without one are likely in; nothing where seconds are believed.

    Args:
        first: a time of the column, as logged.
        period: the median interval between rows, as logged.
    """
    for unit, low, high in _EPOCHS:
        if low <= abs(first) < high:
            return unit
    if period >= SLOWEST_S:
        return next(unit for unit in ("ms", "us", "ns") if period * TIME_UNITS[unit] < SLOWEST_S)
    return "h" if period < FASTEST_S else ""


def refuse_unit(
    who: str, column: str, stated: str, first_s: float, median_s: float, period_s: float, where: str
) -> None:
    """Raise InputError where the times and sample_period_s differ by a unit of time.

    Args:
        who: the run, for messages.
        column: the time column.
        stated: the unit that its name or zerodrift.toml states; nothing for none.
        first_s: the run's first time, converted.
        median_s: the median interval between rows, converted.
        period_s: `sample_period_s`.
        where: place of `sample_period_s`, for messages.
    """
    if stated:
        raw = median_s / TIME_UNITS[stated]
        if stated != "s" and abs(raw / period_s - 1) < ALIKE:
            raise InputError(
                f"{who}: a row every {raw:.4g} {stated} in '{column}', which is {median_s:.4g} s, "
                f"but {where} sets sample_period_s = {period_s:g}; expected seconds there. Set "
                f"sample_period_s = {median_s:.4g}."
            )
    unit = ""
    for known, factor in TIME_UNITS.items():
        # Stated seconds are taken as such where finer logs are averaged to the step.
        is_odd = known in ("ms", "us", "ns") or (median_s < 0.1 and not stated)
        if known != "s" and is_odd and abs(median_s * factor / period_s - 1) < ALIKE:
            unit = known
    guessed = guess_time_unit(first_s, 1.0)
    if stated not in ("", "s") or (stated and not unit):
        return
    if unit or guessed:
        unit = guessed or unit
        says = f"says {stated}" if stated else "states no unit"
        raise InputError(
            f"{who}: '{column}' {says}, and a row every {median_s:.4g} s is not what "
            f"{where} sets, sample_period_s = {period_s:g}; the times look like {unit}, which "
            f"makes it a row every {median_s * TIME_UNITS[unit]:.4g} s. Write [sensor] time = "
            f'{{ column = "{column}", unit = "{unit}" }}, or unit = "s" if they are seconds.'
        )


# Units as column names carry them: `Fz_N`, `temperature_degC`, `Fz [N]`.

TEMPERATURE_UNITS = ("degC", "degF", "K")
PLAIN_UNITS = (
    *TEMPERATURE_UNITS,
    *("N", "kN", "Nm", "mNm", "kg", "g", "mg", "Pa", "kPa", "MPa", "mbar", "bar", "psi"),
    *("V", "mV", "uV", "A", "mA", "uA", "ohm", "ppm", "ppb", "m", "mm", "um", "strain"),
    *("deg", "Hz", "pF", "nT", "uT", "lux", "LSB", "counts", "s", "ms", "us"),
)
#: Suffix in lower case -> unit as written for people.
UNITS = {unit.lower(): unit for unit in PLAIN_UNITS} | {
    "c": "degC",
    "mps2": "m/s2",
    "degps": "deg/s",
    "dps": "deg/s",
    "radps": "rad/s",
    "pct": "%",
    "percent": "%",
    "%": "%",
    "°c": "degC",
    "°f": "degF",
    "ω": "ohm",
    "kω": "kohm",
    "ohms": "ohm",
    "µv": "uV",
    "μv": "uV",
    "µa": "uA",
    "μa": "uA",
    "m/s²": "m/s2",
}


_THERMAL = re.compile(
    r"temp(?!(erature)?[ _]?co)|therm|oven|chamber|ambient|room|(^|[^a-z])t[0-9]*$", re.IGNORECASE
)
_WRITTEN = r"[A-Za-z0-9%°µμΩ/²]"
"""What units are written with."""


def are_alike(one: str, other: str) -> bool:
    """Tell whether two spellings mean one unit: `Nm`, `N m` and `N*m` do."""
    bare = [re.sub(r"[^a-z0-9%]", "", unit.lower()) for unit in (one, other)]
    return bare[0] == bare[1]


def read_unit(name: str) -> str:
    """Return the unit that a column's name ends in (`Fz_N`, `Fz [N]`), or an empty string."""
    match = re.search(rf"(?:_|[\[(])({_WRITTEN}+)[\])]?$", name.strip())
    return normalise_unit(match.group(1), name[: match.start()], "") if match else ""


def normalise_unit(text: str, name: str = "", unknown: str | None = None) -> str:
    """Return a unit by the name that zerodrift has for it.

    Args:
        text: as it is written.
        name: the quantity's name: F is degF for a temperature, and no known unit otherwise.
        unknown: returned for a unit that is not known; None: as it is written.
    """
    bare = text.strip()
    if bare.upper() == "F" and _THERMAL.search(name):
        return "degF"
    return UNITS.get(bare.lower(), bare if unknown is None else unknown)


def strip_unit(name: str) -> str:
    """Return a column's name without its unit; the whole name where nothing would be left."""
    bare = re.sub(rf"[\s_]*[\[(_]{_WRITTEN}+[\])]?$", "", name) if read_unit(name) else name
    return bare.strip() or name
