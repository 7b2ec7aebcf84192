"""From a logged value to the quantity: scale, divider, thermometers, table, polynomial."""

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.conversion_config import FACTORS, ConversionConfig
from zerodrift.dataset.thermocouples import emf, invert

KELVIN = 273.15
T25_K = 298.15
PLATINUM = (3.9083e-3, -5.775e-7, -4.183e-12)
"""Callendar-Van Dusen coefficients A, B, C (IEC 60751:2022, section 5.2)."""
COLDEST_PLATINUM_DEGC = -200.0


def convert(values: Array, by: ConversionConfig, junction_degC: Array | None = None) -> Array:
    """Return logged values [n] as the quantity; NaN where the conversion has none.

    Args:
        values: [n] as logged.
        by: the steps. With `kind` the result is in degC, or in the unit of the table's y or of the
            polynomial; else in `unit`, temperatures in degC.
        junction_degC: [n] of a thermocouple's cold junction, where an input measures it.
    """
    with np.errstate(all="ignore"):
        found = values * by.scale + by.offset
        if by.lacks is not None:
            found = np.where(values == by.lacks, np.nan, found)
        if by.divider is not None:
            share, rail = found / by.divider.counts, by.divider.rail
            inside = (share > 0) & (share < 1)
            if rail:
                inside &= (found >= rail) & (found <= by.divider.counts - 1 - rail)
            ratio = share / (1 - share) if by.divider.is_low else (1 - share) / share
            found = np.where(inside, by.divider.series_ohm * ratio, np.nan)
        if by.kind == "ntc":
            return convert_ntc(found, by)
        if by.kind in ("pt100", "pt1000"):
            return convert_platinum(found, 100.0 if by.kind == "pt100" else 1000.0)
        if by.kind == "thermocouple":
            return convert_couple(found, by, junction_degC)
        if by.kind == "emf":
            return np.asarray(emf(by.couple or "", found) * (by.times or 1.0))
        if by.kind == "table":
            x, y = np.array(by.points).T
            return np.where((found >= x[0]) & (found <= x[-1]), np.interp(found, x, y), np.nan)
        if by.kind == "polynomial":
            polynomial: Array = np.polynomial.polynomial.polyval(found, np.array(by.coefficients))
            return polynomial
        if by.unit == "degF":
            return np.asarray((found - 32) / 1.8)
        if by.unit == "K":
            return np.asarray(found - KELVIN)
        return np.asarray(found)


def convert_couple(values: Array, by: ConversionConfig, junction_degC: Array | None) -> Array:
    """Return the temperature [n] in degC of a thermocouple, from its voltage and cold junction.

    The voltage between 0 degC and the cold junction is added; `by.unit` is that of the values, V
    where it is empty.
    """
    couple = by.couple or ""
    cold = np.array(by.junction_degC or 0.0) if junction_degC is None else junction_degC
    volts = values * FACTORS.get(by.unit, ("V", 1.0))[1]
    if np.any(cold != 0.0):
        volts = volts + emf(couple, np.atleast_1d(cold))
    return invert(couple, volts)


def convert_ntc(ohm: Array, by: ConversionConfig) -> Array:
    """Return the temperature [n] in degC of a thermistor, by beta or by Steinhart and Hart."""
    log = np.log(np.where(ohm > 0, ohm, np.nan))
    if by.steinhart:
        a, b, c = by.steinhart
        inverse_per_K = a + b * log + c * log**3
    else:
        inverse_per_K = 1 / T25_K + (log - np.log(by.r25_ohm)) / by.beta_K
    found: Array = 1 / inverse_per_K - KELVIN
    return found


def convert_platinum(ohm: Array, r0_ohm: float) -> Array:
    """Return the temperature [n] in degC of a platinum resistor (IEC 60751).

    Limits: from -200 degC on; below 0 degC by Newton steps, to 1e-9 K.
    """
    a, b, c = PLATINUM
    ratio = ohm / r0_ohm
    found = (-a + np.sqrt(a * a - 4 * b * (1 - ratio))) / (2 * b)
    cold = ratio < 1
    if np.any(cold):
        t = found[cold]
        for _ in range(6):
            left = 1 + a * t + b * t**2 + c * (t - 100) * t**3 - ratio[cold]
            t = t - left / (a + 2 * b * t + c * (4 * t**3 - 300 * t**2))
        found[cold] = t
    return np.where(found >= COLDEST_PLATINUM_DEGC - 1, found, np.nan)
