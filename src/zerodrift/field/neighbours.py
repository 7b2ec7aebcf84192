"""The model in the forms that other programs take: a polynomial in the temperature, no more.

Sources, read in their own texts: PX4, src/modules/temperature_compensation, in it
TemperatureCompensation.cpp and temp_comp_params_*.yaml (offset = X0 + X1 d + X2 d^2 + X3 d^3, a
barometer's up to X5, d the temperature, held within TMIN and TMAX, less TREF; it is subtracted);
ArduPilot, libraries/AP_InertialSensor/AP_InertialSensor_tempcal.cpp (a cubic without constant
around 35 degC, coefficients times 1e6, subtracted; its value at the temperature at which the
accelerometer was calibrated is added again); chrony.conf(5), tempcomp (comp = k0 + (T - T0) k1 +
(T - T0)^2 k2 in ppm, or points joined by lines; within -10 .. 10; positive: the clock runs faster).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial

from zerodrift.base.arrays import Array
from zerodrift.base.csv_text import render_rows
from zerodrift.base.errors import InputError

PX4_ACCEL, PX4_GYRO, PX4_BARO = ("px4-accel", "px4-gyro", "px4-baro")
ARDUPILOT_ACCEL, ARDUPILOT_GYRO = ("ardupilot-accel", "ardupilot-gyro")
CHRONY, CHRONY_POINTS, POLYNOMIAL = ("chrony", "chrony-points", "polynomial")
ARDUPILOT_DEGC = 35.0
ARDUPILOT_SCALE = 1e6
CHRONY_LIMIT_PPM = 10.0
CHRONY_POINTS_COUNT = 33
CHRONY_FILE = "/sys/class/hwmon/hwmon0/temp1_input"
CHRONY_PER_DEGC = 1000.0
"""A file of hwmon holds thousandths of a degree."""
_ACCELERATION = {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "g": 9.80665, "mg": 9.80665e-3}
_RATE = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "dps": np.pi / 180.0, "°/s": np.pi / 180.0}
_PRESSURE = {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0}


@dataclass(frozen=True)
class Kind:
    """The form that a neighbour program takes."""

    order: int
    outputs: int
    """At most."""
    units: dict[str, float]
    """Unit -> factor to the neighbour's own; empty: any unit, as it is."""
    file: str
    """Its name."""
    free_constant: bool = False
    """Whether the neighbour finds the constant by itself."""


KINDS = {
    PX4_ACCEL: Kind(3, 3, _ACCELERATION, "px4-accel.params"),
    PX4_GYRO: Kind(3, 3, _RATE, "px4-gyro.params"),
    PX4_BARO: Kind(5, 1, _PRESSURE, "px4-baro.params"),
    ARDUPILOT_ACCEL: Kind(3, 3, _ACCELERATION, "ardupilot-accel.param", free_constant=True),
    ARDUPILOT_GYRO: Kind(3, 3, _RATE, "ardupilot-gyro.param", free_constant=True),
    CHRONY: Kind(2, 1, {"ppm": 1.0, "ppb": 1e-3}, "chrony-tempcomp.conf", free_constant=True),
    CHRONY_POINTS: Kind(
        9, 1, {"ppm": 1.0, "ppb": 1e-3}, "chrony-tempcomp.points", free_constant=True
    ),
    POLYNOMIAL: Kind(3, 16, {}, "polynomial.csv"),
}


@dataclass(frozen=True)
class FullAnswers:
    """Answers of the full model at some steps."""

    temperature_degC: Array
    """[n] inside the calibrated range, no flag."""
    drift: Array
    """[n, K] in the outputs' units."""


@dataclass(frozen=True)
class Polynomial:
    """A polynomial in the temperature for each output, in the neighbour's unit."""

    around_degC: float
    low_degC: float
    high_degC: float
    coefficients: Array
    """[order + 1, K], that of the constant first."""


@dataclass(frozen=True)
class Lost:
    """What an output loses against the full model, in its own unit."""

    unit: str
    rms_logs: float | None
    """Over the logs; null without any."""
    worst_logs: float | None
    rms_range: float
    """Over a sweep of the calibrated range."""
    worst_range: float
    rms_drift: float
    """RMS of the full model's drift over the sweep: the loss of no compensation at all."""


def find_factors(kind: str, units: Sequence[str]) -> list[float]:
    """Return what takes each output's unit to the neighbour's.

    Raises:
        InputError: too many outputs, or a unit that the neighbour does not have.
    """
    stated = KINDS[kind]
    if len(units) > stated.outputs:
        most = f"{stated.outputs} output{'s' if stated.outputs > 1 else ''}"
        raise InputError(
            f"{kind}: takes {most} at most, found {len(units)}."
            " Name those to be written by --output."
        )
    unknown = [unit for unit in units if stated.units and unit not in stated.units]
    if unknown:
        raise InputError(
            f"{kind}: has no use for the unit {unknown[0]!r}; expected one of"
            f" {', '.join(stated.units)}. Correct [outputs] unit, or take `polynomial`."
        )
    return [stated.units.get(unit, 1.0) for unit in units]


def fit_polynomial(
    kind: str, logs: FullAnswers | None, sweep: FullAnswers, factors: Sequence[float], order: int
) -> Polynomial:
    """Return the polynomial nearest to the full model, logs and sweep weighed alike.

    Coefficients are those that the neighbour keeps: float32 where it does.
    """
    low, high = float(sweep.temperature_degC.min()), float(sweep.temperature_degC.max())
    around = (
        ARDUPILOT_DEGC
        if kind in (ARDUPILOT_ACCEL, ARDUPILOT_GYRO)
        else round(0.5 * (low + high), 1)
    )
    half = max(high - low, 1e-9) / 2.0
    parts = [part for part in (logs, sweep) if part is not None and part.temperature_degC.size]
    rows, targets = [], []
    for part in parts:
        weight = 1.0 / np.sqrt(part.temperature_degC.size)
        scaled = (part.temperature_degC - around) / half
        rows.append(weight * polynomial.polyvander(scaled, order))
        targets.append(weight * part.drift * np.asarray(factors))
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    coefficients = found / half ** np.arange(order + 1)[:, None]
    if kind not in (CHRONY, CHRONY_POINTS, POLYNOMIAL):
        scale = ARDUPILOT_SCALE if "ardupilot" in kind else 1.0
        coefficients = (coefficients * scale).astype(np.float32).astype(np.float64) / scale
    return Polynomial(around, low, high, coefficients)


def evaluate(kind: str, fitted: Polynomial, temperature_degC: Array) -> Array:
    """Return what the neighbour subtracts [n, K], in its unit, as it computes it."""
    held = np.clip(temperature_degC, fitted.low_degC, fitted.high_degC)
    if kind == CHRONY_POINTS:
        degrees, values = list_points(fitted)
        return np.interp(held, degrees, values)[:, None]
    return np.asarray(polynomial.polyval(held - fitted.around_degC, fitted.coefficients).T)


def list_points(fitted: Polynomial) -> tuple[Array, Array]:
    """Return temperatures and drifts of points that chrony joins by lines."""
    degrees = np.round(np.linspace(fitted.low_degC, fitted.high_degC, CHRONY_POINTS_COUNT), 3)
    values = polynomial.polyval(degrees - fitted.around_degC, fitted.coefficients[:, 0])
    return degrees, np.asarray(values)


def measure_lost(
    kind: str,
    fitted: Polynomial,
    units: Sequence[str],
    logs: FullAnswers | None,
    sweep: FullAnswers,
) -> list[Lost]:
    """Return what each output loses; a constant that the neighbour finds by itself is no loss."""
    factors = find_factors(kind, units)
    lost = []
    for k, unit in enumerate(units):

        def compare(answers: FullAnswers, k: int = k) -> tuple[float, float]:
            own = evaluate(kind, fitted, answers.temperature_degC)[:, k] / factors[k]
            apart = own - answers.drift[:, k]
            if KINDS[kind].free_constant:
                apart = apart - np.mean(apart)
            return float(np.sqrt(np.mean(apart**2))), float(np.abs(apart).max())

        rms_logs, worst_logs = compare(logs) if logs is not None else (None, None)
        rms_range, worst_range = compare(sweep)
        size = sweep.drift[:, k]
        if KINDS[kind].free_constant:
            size = size - np.mean(size)
        rms_drift = float(np.sqrt(np.mean(size**2)))
        lost.append(Lost(unit, rms_logs, worst_logs, rms_range, worst_range, rms_drift))
    return lost


def render(kind: str, fitted: Polynomial, names: Sequence[str], device: int, head: str) -> str:
    """Return the neighbour's file.

    Args:
        kind: which neighbour.
        fitted: the polynomial.
        names: of the outputs.
        device: the number of the sensor: PX4 counts from 0, ArduPilot from 1.
        head: lines for a comment.

    Raises:
        InputError: chrony would ignore such compensations.
    """
    comment = "".join(f"# {line}\n" for line in head.splitlines())
    if kind == POLYNOMIAL:
        return comment + _render_table(fitted, names)
    if kind in (CHRONY, CHRONY_POINTS):
        return _render_chrony(kind, fitted, comment)
    lines = []
    limits = (fitted.low_degC, fitted.high_degC)
    if kind in (ARDUPILOT_ACCEL, ARDUPILOT_GYRO):
        letters, prefix = ("ACC" if kind == ARDUPILOT_ACCEL else "GYR"), f"INS_TCAL{device}_"
        lines = [f"{prefix}ENABLE,1", f"{prefix}TMIN,{limits[0]:.2f}"]
        lines.append(f"{prefix}TMAX,{limits[1]:.2f}")
        for order in (1, 2, 3):
            for letter, column in zip("XYZ", fitted.coefficients.T, strict=False):
                lines.append(f"{prefix}{letters}{order}_{letter},{column[order] * 1e6:.9g}")
        return comment + "\n".join(lines) + "\n"
    sensor = {PX4_ACCEL: "A", PX4_GYRO: "G", PX4_BARO: "B"}[kind]
    stem = f"TC_{sensor}{device}_"
    values = [(f"TC_{sensor}_ENABLE", "1", 6)]
    for order, row in enumerate(fitted.coefficients):
        for axis, value in enumerate(row):
            suffix = f"X{order}" if kind == PX4_BARO else f"X{order}_{axis}"
            values.append((stem + suffix, f"{value:.9g}", 9))
    for name, value in zip(("TREF", "TMIN", "TMAX"), (fitted.around_degC, *limits), strict=True):
        values.append((stem + name, f"{value:.6g}", 9))
    # QGroundControl's text: vehicle, component, name, value, MAVLink's type (6 int32, 9 float)
    lines = [f"1\t1\t{name}\t{value}\t{number}" for name, value, number in values]
    return comment + "\n".join(lines) + "\n"


def _render_table(fitted: Polynomial, names: Sequence[str]) -> str:
    orders = len(fitted.coefficients)
    head = ["output", "around_degC", "low_degC", "high_degC", *(f"c{i}" for i in range(orders))]
    rows = []
    limits = (fitted.around_degC, fitted.low_degC, fitted.high_degC)
    for name, column in zip(names, fitted.coefficients.T, strict=True):
        rows.append([name, *(f"{x:.17g}" for x in (*limits, *column))])
    return render_rows(head, rows)


def _render_chrony(kind: str, fitted: Polynomial, comment: str) -> str:
    degrees, drift = list_points(fitted)
    middle = 0.5 * float(drift.max() + drift.min())  # chrony finds a constant by itself
    if float(drift.max()) - middle > CHRONY_LIMIT_PPM:
        raise InputError(
            f"{kind}: the clock drifts by {drift.max() - drift.min():.3g} ppm over its range;"
            f" expected {2 * CHRONY_LIMIT_PPM:g} at most, as chrony ignores compensations beyond"
            f" {CHRONY_LIMIT_PPM:g}. Narrow the calibrated range."
        )
    if kind == CHRONY_POINTS:
        pairs = zip(degrees * CHRONY_PER_DEGC, middle - drift, strict=True)
        return comment + "".join(f"{t:.0f} {value:.6f}\n" for t, value in pairs)
    zero, slope, bend = -fitted.coefficients[:, 0]
    numbers = (zero + middle, slope / CHRONY_PER_DEGC, bend / CHRONY_PER_DEGC**2)
    text = " ".join(f"{number:.9g}" for number in numbers)
    return (
        comment + f"tempcomp {CHRONY_FILE} 30 {fitted.around_degC * CHRONY_PER_DEGC:.0f} {text}\n"
    )
