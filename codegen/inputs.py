"""The header's text on an input that the chip converts."""

from textwrap import wrap

from zerodrift.base.conversion_config import ConversionConfig
from zerodrift.export.encoding import find_held
from zerodrift.export.integer_model import Channel

WIDTH = 76


def describe_conversion(channel: Channel) -> list[str]:
    """Return lines about an input with a table: codes, quantity, range, error, no reading."""
    by = channel.conversion
    if by is None or by.is_plain:
        return []
    unit = channel.unit
    low, high = find_held(channel)
    ends = (by.lowest, by.highest) if by.nodes[-1] >= by.nodes[0] else (by.highest, by.lowest)
    first, last = (f"{end * channel.lsb + channel.offset:.6g}" for end in ends)
    what = "codes" if by.junction is None else "sums of code and cold junction"
    told = [
        f"{channel.name}: {by.raw} codes of the hardware, {describe_formula(by.formula)}.",
        f"Converted to {channel.lsb:g} {unit} per count over {what} {by.low} .. {by.high}, which"
        f" are {first} to {last} {unit}, within {by.error:.3g} {unit}; beyond, the nearest of"
        " these.",
    ]
    if by.none is not None:
        told.append(f"No reading: {describe_missing(channel)}.")
    told.append(f"The codes that are readings stand for {low:.6g} to {high:.6g} {unit}.")
    if by.junction is not None:
        ends = (by.junction.low, by.junction.high)
        told.append(
            f"The cold junction counts within codes {ends[0]} .. {ends[1]} of its own; beyond, as"
            " the nearest of these."
        )
    if by.worth[1] > channel.lsb:
        told.append(
            f"One code is worth {by.worth[0]:.3g} to {by.worth[1]:.3g} {unit}, more than a count:"
            " the hardware resolves no finer there."
        )
    return [line for text in told for line in wrap(text, WIDTH)]


def describe_missing(channel: Channel) -> str:
    """Return in words which codes are no readings."""
    by = channel.conversion
    assert by is not None
    told = []
    if by.junction is not None:
        told = ["sums beyond the thermocouple's function", "a cold junction without a reading"]
        return " and ".join(told if by.lacks is None else [f"code {by.lacks}", *told])
    if by.begin > by.least:
        told.append(f"codes below {by.begin}")
    if by.end < by.most:
        told.append(f"codes above {by.end}")
    if by.lacks is not None and by.begin <= by.lacks <= by.end:
        told.append(f"code {by.lacks}")
    return " and ".join(told) or "no code"


def describe_formula(by: ConversionConfig) -> str:
    """Return in words what codes are converted by."""
    told = []
    if by.scale != 1.0 or by.offset:
        told.append(f"times {by.scale:g} plus {by.offset:g}")
    if by.divider is not None:
        side = "low" if by.divider.is_low else "high"
        told.append(
            f"a divider of {by.divider.counts:g} counts with {by.divider.series_ohm:g} ohm, the"
            f" sensor on the {side} side"
        )
    if by.kind == "ntc" and by.steinhart:
        told.append("a thermistor by Steinhart and Hart, " + ", ".join(map(repr, by.steinhart)))
    elif by.kind == "ntc":
        told.append(f"a thermistor of {by.r25_ohm:g} ohm at 25 degC, beta {by.beta_K:g} K")
    elif by.kind in ("pt100", "pt1000"):
        told.append(f"a {by.kind} (IEC 60751)")
    elif by.kind == "thermocouple":
        cold = (
            f"at {by.junction_degC:g} degC" if by.junction is None else f"measured by {by.junction}"
        )
        told.append(
            f"V of a thermocouple of type {by.couple} (IEC 60584-1), its cold junction {cold}"
        )
    elif by.kind == "table":
        told.append(f"a table of {len(by.points)} points")
    elif by.kind == "polynomial":
        told.append(f"a polynomial of degree {len(by.coefficients) - 1}")
    return "; ".join(told)
