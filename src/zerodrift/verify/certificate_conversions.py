"""What the certificate says of conversions: the formulas that the chip's tables stand for."""

from zerodrift.base.conversion_config import ConversionConfig
from zerodrift.codegen.names import name_channels
from zerodrift.dataset.conversions import PLATINUM
from zerodrift.dataset.raw_codes import find_linear
from zerodrift.dataset.thermocouples import COUPLES
from zerodrift.export.integer_model import Channel, IntegerModel

Row = dict[str, object]
PLATINUM_SPAN_DEGC = (-200.0, 850.0)
"""Over which IEC 60751 states its equations."""


def describe_conversions(model: IntegerModel) -> list[Row]:
    """Return a row for each input whose raw codes a table converts.

    `kind` is of value `scale` + `offset`, through the `divider` where there is one: "line" is that
    itself; "beta" and "steinhart" a thermistor in ohm; "table" and "polynomial"; "inverse" the
    temperature whose function, in `pieces` of polynomials (with a0 exp(a1 (t - a2)^2) beside some),
    has the value. With a `junction` the value is a sum of raw code and junction's voltage.
    """
    names = name_channels(model)
    rows = []
    for name, channel in zip(names, model.channels, strict=True):
        by = channel.conversion
        if by is None or by.is_plain:
            continue
        row: Row = {"input": name, "unit": channel.unit, **_describe(by.by_sum)}
        if by.junction is not None:
            of = model.channels[by.junction.channel]
            junction = _describe_junction(names[by.junction.channel], of)
            row |= {"raw_scale": by.formula.scale, "raw_offset": by.formula.offset}
            row |= {"junction": junction}
        rows.append(row)
    return rows


def _describe_junction(name: str, channel: Channel) -> Row:
    return {"input": name, "scale": channel.lsb, "offset": channel.offset}


def _describe(by: ConversionConfig) -> Row:
    row: Row = {"kind": by.kind, "scale": by.scale, "offset": by.offset}
    if by.divider is not None:
        side = "low" if by.divider.is_low else "high"
        ends = {"series_ohm": by.divider.series_ohm, "counts": by.divider.counts}
        row |= {"divider": {**ends, "side": side}}
    if by.kind == "ntc" and by.steinhart:
        return row | {"kind": "steinhart", "coefficients": list(by.steinhart)}
    if by.kind == "ntc":
        return row | {"kind": "beta", "r25_ohm": by.r25_ohm, "beta_K": by.beta_K}
    if by.kind in ("pt100", "pt1000"):
        r0 = 100.0 if by.kind == "pt100" else 1000.0
        return row | {"kind": "inverse", "pieces": _describe_platinum(r0)}
    if by.kind == "thermocouple":
        couple = by.couple or ""
        row |= {"kind": "inverse", "pieces": _describe_couple(couple)}
        return row if not by.junction_degC else row | {"junction_degC": by.junction_degC}
    if by.kind == "table":
        return row | {"points": [list(point) for point in by.points]}
    if by.kind == "polynomial":
        return row | {"coefficients": list(by.coefficients)}
    linear = find_linear(by)
    assert linear is not None
    return {"kind": "line", "scale": linear[0], "offset": linear[1]}


def _describe_platinum(r0_ohm: float) -> list[Row]:
    """Return the resistance over the temperature (IEC 60751:2022, equations 1 and 2), in ohm."""
    a, b, c = PLATINUM
    warm = [r0_ohm, r0_ohm * a, r0_ohm * b]
    cold = [*warm, -100.0 * r0_ohm * c, r0_ohm * c]
    low, high = PLATINUM_SPAN_DEGC
    return [
        {"low": low, "high": 0.0, "coefficients": cold},
        {"low": 0.0, "high": high, "coefficients": warm},
    ]


def _describe_couple(couple: str) -> list[Row]:
    """Return the voltage over the temperature, in V."""
    rows = []
    for piece in COUPLES[couple]:
        row: Row = {"low": piece.low_degC, "high": piece.high_degC}
        row |= {"coefficients": [c * 1e-3 for c in piece.coefficients]}
        if piece.bump:
            row |= {"bump": [piece.bump[0] * 1e-3, *piece.bump[1:]]}
        rows.append(row)
    return rows
