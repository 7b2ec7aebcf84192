"""Five folds in time, and simple fits by least squares that see four of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.real.records import Array, Record

Rows = NDArray[np.bool_]
FOLDS = 5
LAGS = 16
"""Time constants that are tried, from the sample period to a sixth of the record, geometrically."""


def list_folds(rows: int) -> list[Rows]:
    """Return which rows [n] are in each fold: contiguous, disjoint, alike in number within one."""
    numbers = np.arange(rows)
    return [np.isin(numbers, part) for part in np.array_split(numbers, FOLDS)]


def delay(record: Record, known: Rows, tau_s: float) -> Array:
    """Return the temperature [n] behind one lag, from rest; straight lines where it is unknown.

    Args:
        record: its temperature is read in the known rows alone.
        known: [n] rows whose temperature may be used.
        tau_s: time constant; 0: none.
    """
    steps = np.arange(record.place[0], record.place[-1] + 1)
    line = np.interp(steps, record.place[known], record.temperature_degC[known])
    if tau_s > 0.0:
        a = float(np.exp(-record.period_s / tau_s))
        line = line[0] + lfilter([1.0 - a], [1.0, -a], line - line[0])
    return np.asarray(line[record.place - record.place[0]])


@dataclass(frozen=True)
class Fit:
    """A sum of powers of temperatures behind lags."""

    taus_s: tuple[float, ...]
    degree: int
    centre_degC: float
    coefficients: Array
    squares: float
    """Sum of the squared errors on the rows that it was fitted to."""

    def predict(self, record: Record, known: Rows) -> Array:
        """Return the drift [n]; right in the known rows, whose temperatures alone are read."""
        return (
            _tabulate(record, known, self.taus_s, self.degree, self.centre_degC) @ self.coefficients
        )


def _tabulate(
    record: Record, known: Rows, taus_s: tuple[float, ...], degree: int, centre_degC: float
) -> Array:
    table = [np.ones(record.drift.size)]
    for tau_s in taus_s:
        delayed = delay(record, known, tau_s) - centre_degC
        table += [delayed**power for power in range(1, degree + 1)]
    return np.stack(table, axis=1)


def fit_powers(record: Record, train: Rows, taus_s: tuple[float, ...], degree: int) -> Fit:
    """Return the least-squares fit to some rows, which alone are read.

    Args:
        record: the log.
        train: [n] rows.
        taus_s: a lag for each set of powers; none: a constant.
        degree: the highest power of each.
    """
    centre_degC = float(np.mean(record.temperature_degC[train]))
    table = _tabulate(record, train, taus_s, degree, centre_degC)[train]
    drift = record.drift[train]
    coefficients: Array = np.linalg.lstsq(table, drift, rcond=None)[0].astype(np.float64)
    squares = float(np.sum((drift - table @ coefficients) ** 2))
    return Fit(taus_s, degree, centre_degC, coefficients, squares)


def _list_taus(record: Record) -> list[float]:
    longest = float(record.place[-1] - record.place[0]) / 6.0
    return [float(tau) for tau in record.period_s * np.geomspace(1.0, max(longest, 1.0), LAGS)]


def _fit_lag(record: Record, train: Rows) -> Fit:
    fits = (fit_powers(record, train, (tau_s,), 3) for tau_s in _list_taus(record))
    return min(fits, key=lambda fit: fit.squares)


def _fit_two_lags(record: Record, train: Rows) -> Fit:
    pairs = combinations(_list_taus(record), 2)
    return min((fit_powers(record, train, pair, 1) for pair in pairs), key=lambda fit: fit.squares)


SIMPLE: Mapping[str, Callable[[Record, Rows], Fit]] = {
    "constant": lambda record, train: fit_powers(record, train, (), 0),
    "line": lambda record, train: fit_powers(record, train, (0.0,), 1),
    "cubic": lambda record, train: fit_powers(record, train, (0.0,), 3),
    "cubic + lag": _fit_lag,
    "two lags": _fit_two_lags,
}
"""Simple fits: powers of the temperature; a cubic in that behind one lag; a line in that behind
each of two. Time constants are those with the least squares on the rows that are fitted."""


@dataclass(frozen=True)
class Error:
    """Of one prediction of one fold, in the output's unit."""

    rms: float
    scatter: float
    """RMS about the errors' own mean."""


def measure_error(errors: Array) -> Error:
    """Return the RMS of errors [n], with and without their mean."""
    return Error(float(np.sqrt(np.mean(errors**2))), float(np.std(errors)))


def predict_simple(record: Record, train: Rows, fold: Rows) -> dict[str, Error]:
    """Return each simple fit's error on a fold that it did not see."""
    known = train | fold
    return {
        name: measure_error((record.drift - fit(record, train).predict(record, known))[fold])
        for name, fit in SIMPLE.items()
    }


def choose_simple(record: Record, folds: list[Rows]) -> str:
    """Return which simple fit predicts each of some folds best from the others of them."""
    squares = dict.fromkeys(SIMPLE, 0.0)
    for left_out in folds:
        train = np.any([fold for fold in folds if fold is not left_out], axis=0)
        for name, error in predict_simple(record, train, left_out).items():
            squares[name] += error.rms**2 * float(left_out.sum())
    return min(squares, key=lambda name: squares[name])
