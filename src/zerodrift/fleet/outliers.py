"""Which sensors are unlike the others, by errors and by fitted values, and in what."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.outliers import NORMAL_OF_MAD
from zerodrift.fleet.result import SensorResult

FEWEST = 8
"""With fewer sensors there is no telling what is usual."""
"""Standard deviation of a normal distribution over its median absolute deviation."""
TAILS = (0.1, 0.9)
"""What lies beyond one of these shares of the fleet is no outlier but a second population."""
NORMAL_TAILS = 2.5631
"""Distance of these two quantiles of a normal distribution, in standard deviations."""
SMALL_SPREAD = 1e-9
"""Share of the median below which a spread is rounding."""


@dataclass(frozen=True)
class Outlier:
    """One value of one sensor that is far from the others'."""

    sensor: str
    quantity: str
    """`Fz rmse`, `Fz ratio`, `thermal_lag.tau_s`, `Fz dark_current`."""
    value: float
    median: float
    """Of the fleet."""
    z: float
    """Robust z-score, signed."""
    unit: str

    def __str__(self) -> str:
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        return (
            f"{self.quantity} = {self.value:.4g}{unit}, the fleet's median is {self.median:.4g}"
            f" (z = {self.z:+.1f})"
        )


def find_outliers(results: Sequence[SensorResult], limit: float) -> dict[str, list[Outlier]]:
    """Return the outliers by sensor, the farthest value of each first.

    The z-score is robust: distance from the median over the median absolute deviation, or over the
    distance of the outer tenths where that is larger (two populations, such as two batches of a
    part, are no outliers of each other), either scaled to a standard deviation. Errors, and
    parameters that are searched in their logarithm, are compared by their logarithm. An error that
    is unusually small is no outlier; a parameter may be off either way, and its distance counts
    only as far as it exceeds the fit's own standard error.

    Args:
        results: of all sensors that went through.
        limit: robust z-score from which a value is an outlier.

    Source: Iglewicz and Hoaglin, "How to detect and handle outliers", 1993.
    """
    found: dict[str, list[Outlier]] = {}
    if len(results) < FEWEST:
        return found
    for quantity in _list_quantities(results):
        for sensor, outlier in quantity.judge(limit):
            found.setdefault(sensor, []).append(outlier)
    for outliers in found.values():
        outliers.sort(key=lambda o: -abs(o.z))
    return found


@dataclass(frozen=True)
class _Quantity:
    """One value of all sensors that have it."""

    name: str
    unit: str
    sensors: Sequence[str]
    values: Array
    std_errors: Array
    is_log: bool
    only_large: bool

    def judge(self, limit: float) -> list[tuple[str, Outlier]]:
        """Return the sensors whose value is an outlier."""
        usable = np.isfinite(self.values) & ((self.values > 0.0) | (not self.is_log))
        if usable.sum() < FEWEST:
            return []
        x = np.log(np.where(usable, self.values, 1.0)) if self.is_log else self.values
        middle, spread = measure_spread(x[usable])
        size = 1.0 if self.is_log else max(abs(middle), float(np.abs(x[usable]).max()))
        if spread <= SMALL_SPREAD * size:
            return []
        errors = np.where(np.isfinite(self.std_errors), self.std_errors, 0.0)
        if self.is_log:
            errors = errors / np.where(usable, self.values, 1.0)
        z = (x - middle) / np.hypot(spread, errors)
        median = float(np.median(self.values[usable]))
        return [
            (name, Outlier(name, self.name, float(value), median, float(score), self.unit))
            for name, value, score, ok in zip(self.sensors, self.values, z, usable, strict=True)
            if ok and (score > limit or (score < -limit and not self.only_large))
        ]


def measure_spread(x: Array) -> tuple[float, float]:
    """Return the median of values [n] and their robust spread, as a standard deviation."""
    middle = float(np.median(x))
    low, high = np.quantile(x, TAILS)
    mad = float(np.median(np.abs(x - middle)))
    return middle, max(NORMAL_OF_MAD * mad, float(high - low) / NORMAL_TAILS)


def _list_quantities(results: Sequence[SensorResult]) -> list[_Quantity]:
    """Return errors, then parameters, each over the sensors that have it."""
    quantities = []
    for name, first in results[0].outputs.items():
        for what, unit in (("rmse", first.unit), ("ratio to the floor", "")):
            values = [
                r.outputs[name].judged if what == "rmse" else r.outputs[name].ratio for r in results
            ]
            quantities.append(
                _Quantity(
                    f"{name} {what}",
                    unit,
                    [r.sensor for r in results],
                    np.array(values, dtype=np.float64),
                    np.zeros(len(values)),
                    is_log=True,
                    only_large=True,
                )
            )
    for name in dict.fromkeys(name for r in results for name in r.parameters):
        have = [r for r in results if name in r.parameters]
        parameters = [r.parameters[name] for r in have]
        quantities.append(
            _Quantity(
                name,
                parameters[0].unit,
                [r.sensor for r in have],
                np.array([p.value for p in parameters], dtype=np.float64),
                np.array([p.std_error for p in parameters], dtype=np.float64),
                is_log=parameters[0].is_log,
                only_large=False,
            )
        )
    return quantities
