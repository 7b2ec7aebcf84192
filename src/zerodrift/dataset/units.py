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
