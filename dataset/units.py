"""Units as column names carry them: `Fz_N`, `temperature_degC`, `Fz [N]`."""

import re

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


_WRITTEN = r"[A-Za-z0-9%°µμΩ/²]"
"""What units are written with."""


def are_alike(one: str, other: str) -> bool:
    """Tell whether two spellings mean one unit: `Nm`, `N m` and `N*m` do."""
    bare = [re.sub(r"[^a-z0-9%]", "", unit.lower()) for unit in (one, other)]
    return bare[0] == bare[1]


def read_unit(name: str) -> str:
    """Return the unit that a column's name ends in (`Fz_N`, `Fz [N]`), or an empty string."""
    match = re.search(rf"(?:_|[\[(])({_WRITTEN}+)[\])]?$", name.strip())
    return UNITS.get(match.group(1).lower(), "") if match else ""


def normalise_unit(text: str) -> str:
    """Return a unit by the name that zerodrift has for it, or as it is written."""
    return UNITS.get(text.strip().lower(), text.strip())


def strip_unit(name: str) -> str:
    """Return a column's name without its unit; the whole name where nothing would be left."""
    bare = re.sub(rf"[\s_]*[\[(_]{_WRITTEN}+[\])]?$", "", name) if read_unit(name) else name
    return bare.strip() or name
