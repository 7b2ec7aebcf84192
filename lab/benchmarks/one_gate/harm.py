"""How much worse a plain least-squares model gets by spoilt training logs."""

import numpy as np

from benchmarks.one_gate.sensor import TIME, Array, Columns, Log, Sensor

DOUBLE = 2.0
"""A fault counts as harmful where it at least doubles the error on unseen runs."""


def fit_plainly(sensor: Sensor, output: int) -> Array:
    """Return coefficients of the told model's columns, by least squares on all training rows.

    The form is the simulator's own, nonlinear values at their truth. Logs that were tared are
    taken less their first rows' mean, columns too; else a constant is the last coefficient.
    """
    parts = [_prepare(sensor, log.columns, output) for log in sensor.select("train")]
    columns = np.concatenate([columns for columns, _ in parts])
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    drift = np.concatenate([drift for _, drift in parts])
    return np.asarray(np.linalg.lstsq(columns / scale, drift, rcond=None)[0] / scale)


def leave(sensor: Sensor, logs: tuple[Log, ...], output: int, coefficients: Array) -> float:
    """Return RMS of what these coefficients leave of the drift in some logs, noise included."""
    left = []
    for log in logs:
        columns, drift = _prepare(sensor, log.columns, output)
        left.append(drift - columns @ coefficients)
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def weigh_harm(sound: Sensor, spoilt: Sensor) -> float:
    """Return by how much the error on unseen runs grows, at the output that suffers most.

    The error is what a user is left with: measured less reference less the model, noise included.
    So a fault below the noise harms nobody, whatever it does to a model that was nearly exact.
    """
    unseen = sound.select("test", "spare")
    worst = 0.0
    for output in range(len(sound.outputs)):
        before = leave(sound, unseen, output, fit_plainly(sound, output))
        after = leave(sound, unseen, output, fit_plainly(spoilt, output))
        worst = max(worst, after / before)
    return worst


def bring_to_period(columns: Columns, period_s: float) -> Columns:
    """Return a log whose rows are closer than the sensor's period, averaged to it; else the log."""
    time = columns[TIME]
    rows = round(period_s / float(np.median(np.diff(time))))
    if rows < 2:
        return columns
    whole = time.size // rows * rows
    return {name: v[:whole].reshape(-1, rows).mean(axis=1) for name, v in columns.items()}


def _prepare(sensor: Sensor, columns: Columns, output: int) -> tuple[Array, Array]:
    columns = bring_to_period(columns, sensor.period_s)
    terms, drift = sensor.basis(columns, output), sensor.drift(columns, output)
    rows = sensor.tare_rows
    if rows:
        return terms - terms[:rows].mean(axis=0), drift - drift[:rows].mean()
    return np.column_stack([terms, np.ones(len(terms))]), drift
