"""Units in D-SI, the notation of digital calibration certificates: mN is `\\milli\\newton`.

Source: SmartCom D-SI, https://doi.org/10.5281/zenodo.3522631; SI Brochure, 9th edition.
"""

import re
from collections.abc import Mapping

from zerodrift.base.errors import InputError

BASES = {
    **{"m": "metre", "g": "gram", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole"},
    **{"cd": "candela", "N": "newton", "Pa": "pascal", "J": "joule", "W": "watt", "V": "volt"},
    **{"ohm": "ohm", "Ω": "ohm", "F": "farad", "C": "coulomb", "H": "henry", "T": "tesla"},
    **{"Wb": "weber", "S": "siemens", "Hz": "hertz", "lx": "lux", "lux": "lux", "lm": "lumen"},
    **{"rad": "radian", "deg": "degree", "°": "degree", "degC": "degreecelsius"},
    **{"°C": "degreecelsius", "bar": "bar", "t": "tonne", "L": "litre", "l": "litre"},
    **{"min": "minute", "h": "hour", "%": "percent", "ppm": "ppm", "1": "one"},
    **{"strain": "one", "LSB": "one", "counts": "one"},
}
PREFIXES = {
    **{"p": "pico", "n": "nano", "u": "micro", "µ": "micro", "μ": "micro", "m": "milli"},
    **{"c": "centi", "d": "deci", "h": "hecto", "k": "kilo", "M": "mega", "G": "giga"},
}
PREFIXED = {"m", "g", "s", "A", "K", "mol", "N", "Pa", "J", "W", "V", "ohm", "Ω", "F", "C", "H"}
PREFIXED |= {"T", "Wb", "S", "Hz", "rad", "bar", "L", "l", "strain"}
LATE = {"²": "2", "³": "3"}


def write_unit(unit: str, known: Mapping[str, str] | None = None) -> str:
    """Return a unit in D-SI.

    Args:
        unit: as an output has it: products by ` `, `*` or `·`, one `/`, exponents as `m2` or
            `m^2`, a prefix before a symbol.
        known: further units, in D-SI already.

    Raises:
        InputError: the unit is not known.
    """
    if known and unit in known:
        return known[unit]
    over, *under = unit.strip().split("/")
    parts = [(part, 1) for part in _split(over)] + [(p, -1) for one in under for p in _split(one)]
    written = [_write_factor(part, sign) for part, sign in parts]
    if len(under) > 1 or not written or None in written:
        raise InputError(
            f"unit '{unit}' is not known in D-SI; expected one such as N, mV, Nm or m/s2. State "
            f"what it is: [calibration.units] \"{unit}\" = '\\newton' (in D-SI)."
        )
    return "".join(one for one in written if one is not None)


def _split(text: str) -> list[str]:
    bare = "".join(f"^{LATE[c]}" if c in LATE else c for c in text)
    parts = [part for part in re.split(r"[\s*·.()]+", bare) if part]
    return [inner for part in parts for inner in _split_torque(part)]


def _split_torque(part: str) -> list[str]:
    """Return the factors of a symbol: Nm, mNm and kNm are written without a sign."""
    match = re.fullmatch(r"([munkM]?N)(m{1,2})", part)
    return [match.group(1), match.group(2)] if match else [part]


def _write_factor(part: str, sign: int) -> str | None:
    match = re.fullmatch(r"(.*?)\^?(-?[1-9])?", part)
    symbol, exponent = (match.group(1), int(match.group(2) or 1)) if match else ("", 1)
    if part in BASES:  # also 1 itself
        symbol, exponent = part, 1
    power = sign * exponent
    named = _name(symbol)
    if named is None:
        return None
    return named if power == 1 else f"{named}\\tothe{{{power}}}"


def _name(symbol: str) -> str | None:
    if symbol == "kg":
        return "\\kilogram"
    if symbol in BASES:
        return f"\\{BASES[symbol]}"
    if symbol[:1] in PREFIXES and symbol[1:] in PREFIXED:
        return f"\\{PREFIXES[symbol[0]]}\\{BASES[symbol[1:]]}"
    return None
