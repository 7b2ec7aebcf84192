"""From a logged value to the quantity: scales, dividers, thermometers, thermocouples."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import FACTORS, ConversionConfig

# Voltages of thermocouples: the reference functions of ITS-90, and their inverses.
#
# Source: NIST Monograph 175 (Burns et al., 1993), as in NIST's ITS-90 Thermocouple Database (SRD
# 60); the same functions as IEC 60584-1:2013: degC to mV, the other junction at 0 degC.

GRID = 1 << 14
NEWTON_STEPS = 6
LEAST_SLOPE_V_PER_K = 1e-7
"""Below it a thermocouple does not tell the temperature: type B below some 40 degC."""
BUMP_OF_K = (0.118597600000e00, -0.118343200000e-03, 0.126968600000e03)
"""Above 0 degC type K has a0 exp(a1 (t - a2)**2) beside the polynomial."""


@dataclass(frozen=True)
class CouplePiece:
    """A polynomial over a range of temperatures."""

    low_degC: float
    high_degC: float
    coefficients: tuple[float, ...]
    """c0, c1, ... of the powers of the temperature in degC, in mV / K**k."""
    bump: tuple[float, ...] = ()
    """a0, a1, a2 of K."""


COUPLES: dict[str, tuple[CouplePiece, ...]] = {
    "B": (
        CouplePiece(
            0.0,
            630.615,
            (
                0.0,
                -0.00024650818346,
                5.9040421171e-06,
                -1.3257931636e-09,
                1.5668291901e-12,
                -1.694452924e-15,
                6.2990347094e-19,
            ),
        ),
        CouplePiece(
            630.615,
            1820.0,
            (
                -3.8938168621,
                0.02857174747,
                -8.4885104785e-05,
                1.5785280164e-07,
                -1.6835344864e-10,
                1.1109794013e-13,
                -4.4515431033e-17,
                9.8975640821e-21,
                -9.3791330289e-25,
            ),
        ),
    ),
    "E": (
        CouplePiece(
            -270.0,
            0.0,
            (
                0.0,
                0.058665508708,
                4.5410977124e-05,
                -7.7998048686e-07,
                -2.5800160843e-08,
                -5.9452583057e-10,
                -9.3214058667e-12,
                -1.0287605534e-13,
                -8.0370123621e-16,
                -4.3979497391e-18,
                -1.6414776355e-20,
                -3.9673619516e-23,
                -5.5827328721e-26,
                -3.4657842013e-29,
            ),
        ),
        CouplePiece(
            0.0,
            1000.0,
            (
                0.0,
                0.05866550871,
                4.5032275582e-05,
                2.8908407212e-08,
                -3.3056896652e-10,
                6.502440327e-13,
                -1.9197495504e-16,
                -1.2536600497e-18,
                2.1489217569e-21,
                -1.4388041782e-24,
                3.5960899481e-28,
            ),
        ),
    ),
    "J": (
        CouplePiece(
            -210.0,
            760.0,
            (
                0.0,
                0.050381187815,
                3.047583693e-05,
                -8.568106572e-08,
                1.3228195295e-10,
                -1.7052958337e-13,
                2.0948090697e-16,
                -1.2538395336e-19,
                1.5631725697e-23,
            ),
        ),
        CouplePiece(
            760.0,
            1200.0,
            (
                296.45625681,
                -1.4976127786,
                0.0031787103924,
                -3.1847686701e-06,
                1.5720819004e-09,
                -3.0691369056e-13,
            ),
        ),
    ),
    "K": (
        CouplePiece(
            -270.0,
            0.0,
            (
                0.0,
                0.039450128025,
                2.3622373598e-05,
                -3.2858906784e-07,
                -4.9904828777e-09,
                -6.7509059173e-11,
                -5.7410327428e-13,
                -3.1088872894e-15,
                -1.0451609365e-17,
                -1.9889266878e-20,
                -1.6322697486e-23,
            ),
        ),
        CouplePiece(
            0.0,
            1372.0,
            (
                -0.017600413686,
                0.038921204975,
                1.8558770032e-05,
                -9.9457592874e-08,
                3.1840945719e-10,
                -5.6072844889e-13,
                5.6075059059e-16,
                -3.2020720003e-19,
                9.7151147152e-23,
                -1.2104721275e-26,
            ),
            BUMP_OF_K,
        ),
    ),
    "N": (
        CouplePiece(
            -270.0,
            0.0,
            (
                0.0,
                0.026159105962,
                1.0957484228e-05,
                -9.3841111554e-08,
                -4.6412039759e-11,
                -2.6303357716e-12,
                -2.2653438003e-14,
                -7.6089300791e-17,
                -9.3419667835e-20,
            ),
        ),
        CouplePiece(
            0.0,
            1300.0,
            (
                0.0,
                0.025929394601,
                1.571014188e-05,
                4.3825627237e-08,
                -2.5261169794e-10,
                6.4311819339e-13,
                -1.0063471519e-15,
                9.9745338992e-19,
                -6.0863245607e-22,
                2.0849229339e-25,
                -3.0682196151e-29,
            ),
        ),
    ),
    "R": (
        CouplePiece(
            -50.0,
            1064.18,
            (
                0.0,
                0.00528961729765,
                1.39166589782e-05,
                -2.38855693017e-08,
                3.56916001063e-11,
                -4.62347666298e-14,
                5.00777441034e-17,
                -3.73105886191e-20,
                1.57716482367e-23,
                -2.81038625251e-27,
            ),
        ),
        CouplePiece(
            1064.18,
            1664.5,
            (
                2.95157925316,
                -0.00252061251332,
                1.59564501865e-05,
                -7.64085947576e-09,
                2.05305291024e-12,
                -2.93359668173e-16,
            ),
        ),
        CouplePiece(
            1664.5,
            1768.1,
            (
                152.232118209,
                -0.268819888545,
                0.000171280280471,
                -3.45895706453e-08,
                -9.34633971046e-15,
            ),
        ),
    ),
    "S": (
        CouplePiece(
            -50.0,
            1064.18,
            (
                0.0,
                0.00540313308631,
                1.2593428974e-05,
                -2.32477968689e-08,
                3.22028823036e-11,
                -3.31465196389e-14,
                2.55744251786e-17,
                -1.25068871393e-20,
                2.71443176145e-24,
            ),
        ),
        CouplePiece(
            1064.18,
            1664.5,
            (
                1.32900444085,
                0.00334509311344,
                6.54805192818e-06,
                -1.64856259209e-09,
                1.29989605174e-14,
            ),
        ),
        CouplePiece(
            1664.5,
            1768.1,
            (
                146.628232636,
                -0.258430516752,
                0.000163693574641,
                -3.30439046987e-08,
                -9.43223690612e-15,
            ),
        ),
    ),
    "T": (
        CouplePiece(
            -270.0,
            0.0,
            (
                0.0,
                0.038748106364,
                4.4194434347e-05,
                1.1844323105e-07,
                2.0032973554e-08,
                9.0138019559e-10,
                2.2651156593e-11,
                3.6071154205e-13,
                3.8493939883e-15,
                2.8213521925e-17,
                1.4251594779e-19,
                4.8768662286e-22,
                1.079553927e-24,
                1.3945027062e-27,
                7.9795153927e-31,
            ),
        ),
        CouplePiece(
            0.0,
            400.0,
            (
                0.0,
                0.038748106364,
                3.329222788e-05,
                2.0618243404e-07,
                -2.1882256846e-09,
                1.0996880928e-11,
                -3.0815758772e-14,
                4.547913529e-17,
                -2.7512901673e-20,
            ),
        ),
    ),
}
"""Type -> its pieces, in rising order."""


def emf(couple: str, degc: Array) -> Array:
    """Return the voltage [n] in V of a thermocouple against 0 degC; NaN beyond its function."""
    return _evaluate(couple, degc, 0)


def measure_slope(couple: str, degc: Array) -> Array:
    """Return the Seebeck coefficient [n] in V/K; NaN beyond the function."""
    return _evaluate(couple, degc, 1)


def find_span(couple: str) -> tuple[float, float]:
    """Return the temperatures in degC between which the function is known."""
    pieces = COUPLES[couple]
    return pieces[0].low_degC, pieces[-1].high_degC


@cache
def find_sure_span(couple: str) -> tuple[float, float]:
    """Return the temperatures in degC between which the voltage determines the temperature."""
    low, high = find_span(couple)
    grid = np.linspace(low, high, GRID + 1)
    flat = np.flatnonzero(measure_slope(couple, grid) < LEAST_SLOPE_V_PER_K)
    return (low if not flat.size else float(grid[flat[-1] + 1])), high


def invert(couple: str, volts: Array) -> Array:
    """Return the temperature [n] in degC whose voltage against 0 degC is given in V.

    By Newton steps on the function itself, to 1e-9 K; NaN beyond `find_sure_span`.
    """
    low, high = find_sure_span(couple)
    nodes, known = _tabulate(couple)
    with np.errstate(all="ignore"):
        inside = (volts >= known[0]) & (volts <= known[-1])
        given = np.where(inside, volts, known[0])
        found = np.interp(given, known, nodes)
        for _ in range(NEWTON_STEPS):
            step = (emf(couple, found) - given) / measure_slope(couple, found)
            found = np.clip(found - step, low, high)
        return np.where(inside, found, np.nan)


@cache
def _tabulate(couple: str) -> tuple[Array, Array]:
    """Return the temperatures in degC and voltages in V from which the Newton steps start."""
    nodes = np.linspace(*find_sure_span(couple), GRID + 1)
    return nodes, emf(couple, nodes)


def _evaluate(couple: str, degc: Array, order: int) -> Array:
    """Return the function, or its derivative, in V."""
    found = np.full(degc.shape, np.nan)
    for piece in COUPLES[couple]:
        own = (degc >= piece.low_degC) & (degc <= piece.high_degC)
        if not own.any():
            continue
        t = degc[own]
        polynomial = np.polynomial.Polynomial(np.array(piece.coefficients))
        values = (polynomial.deriv() if order else polynomial)(t)
        if piece.bump:
            a0, a1, a2 = piece.bump
            bump = a0 * np.exp(a1 * (t - a2) ** 2)
            values = values + (2.0 * a1 * (t - a2) * bump if order else bump)
        found[own] = values * 1e-3
    return found


# From a logged value to the quantity: scale, divider, thermometers, table, polynomial.

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
