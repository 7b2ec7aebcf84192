"""Single real records, the first 60 % to teach and the last 40 % to predict, for the studies.

How the loop does on real records is `bench_real`. Simple fits to a record's first 60 % are a
constant, a line and a cubic in the temperature, and a cubic in the temperature behind one lag.

The measurements are third-party data that are not part of the repository (cellularmitosis/logs,
MIT licence, (c) 2018 Jason Pepas; hmd83/tanen, CC BY 4.0); they are looked for beside it, in
shared/data.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
DATA = Path(__file__).parents[3] / "shared" / "data"
TAUGHT = 0.6
LAGS = 40
FEWEST = 200
"""Samples of a record."""


@dataclass(frozen=True)
class Record:
    """One log: uniform samples of a thermometer and of what drifts."""

    name: str
    unit: str
    period_s: float
    temperature_degC: Array
    drift: Array


def list_records() -> Iterator[Record]:
    """Give the records of the public folders."""
    yield from _read_table("loadcell_h40a_22kg.csv", "temperature_degC", "weight_kg", "kg", 256.0)
    for name, period_s in (
        ("resistor_genrad2k_oven_ramps.csv", 5.0),
        ("resistor_vhd200_oven_ramps.csv", 10.0),
    ):
        yield from _read_table(name, "oven_temperature_degC", "drift_ppm", "ppm", period_s)
    folder = DATA / "as_logged"
    for path in sorted((folder / "20171208-svrt-logging").glob("*/data.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        climate = np.loadtxt(path.with_name("env.csv"), delimiter=",", skiprows=1)
        value = rows[:, 1] / np.median(rows[:, 1]) * 1e6 - 1e6
        yield _resample(path.parent.name, rows[:, 0], climate[:, 0], climate[:, 1], value)
    for path in sorted((folder / "20180115-vhp202z").glob("*/tempco.csv")):
        with path.open(encoding="utf-8") as file:
            header = file.readline().strip().split(",")
        places = [header.index("temp_c"), header.index("ppm")]
        rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=places)
        time_s = np.arange(len(rows), dtype=np.float64)
        yield _resample(path.parent.name, time_s, time_s, rows[:, 0], rows[:, 1])
    for number in (6, 7, 8):
        path = folder / "20180309-r-tempcos" / f"run{number}" / "tempco.csv"
        rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 2, 3))
        yield _resample(
            f"r-tempcos {path.parent.name}", rows[:, 0], rows[:, 0], rows[:, 2], rows[:, 1]
        )
    for path in sorted((folder / "20180117-hp34401a-tempco").glob("*/out.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1, 2))
        value = rows[:, 1] / np.median(rows[:, 1]) * 1e6 - 1e6
        yield _resample(path.parent.name, rows[:, 0], rows[:, 0], rows[:, 2], value)


def _read_table(
    name: str, thermometer: str, output: str, unit: str, period_s: float
) -> Iterator[Record]:
    """Give the runs of a table as records."""
    runs: dict[str, list[tuple[float, float, float]]] = {}
    with (DATA / name).open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = f"{row['run']} {row['unit']}" if "run" in row else "load cell"
            values = (float(row["time_s"]), float(row[thermometer]), float(row[output]))
            runs.setdefault(key, []).append(values)
    for key, rows in runs.items():
        table = np.array(rows)
        grid = np.arange(table[0, 0], table[-1, 0], period_s)
        yield Record(
            key,
            unit,
            period_s,
            np.interp(grid, table[:, 0], table[:, 1]),
            np.interp(grid, table[:, 0], table[:, 2]),
        )


def _resample(
    name: str, time_s: Array, climate_s: Array, temperature: Array, value: Array
) -> Record:
    """Return a log in some 3,000 means of equal length at least a sample's period apart."""
    order = np.argsort(time_s, kind="stable")
    time_s, value = time_s[order], value[order]
    step = max((time_s[-1] - time_s[0]) / 3000.0, 2.0 * float(np.median(np.diff(time_s))))
    step = float(np.ceil(step))
    edges = np.arange(max(time_s[0], climate_s[0]), min(time_s[-1], climate_s[-1]), step)
    middle = 0.5 * (edges[1:] + edges[:-1])
    return Record(
        name,
        "ppm",
        step,
        _average(climate_s, temperature, edges, middle),
        _average(time_s, value, edges, middle),
    )


def _average(time_s: Array, values: Array, edges: Array, middle: Array) -> Array:
    """Return the means between edges; lines over intervals without a sample."""
    count, _ = np.histogram(time_s, edges)
    total, _ = np.histogram(time_s, edges, weights=values)
    there = count > 0
    return np.interp(middle, middle[there], total[there] / count[there])


def fit_simple(record: Record, taught: int) -> tuple[float, ...]:
    """Return the errors of the simple fits on what was not taught, in the order of SIMPLE."""
    span = float(np.ptp(record.temperature_degC)) or 1.0

    def fit_power(temperature: Array, degree: int) -> tuple[float, float]:
        scaled = (temperature - temperature[:taught].mean()) / span
        table = scaled[:, None] ** np.arange(degree + 1)
        answer = np.linalg.lstsq(table[:taught], record.drift[:taught], rcond=None)[0]
        rest = record.drift - table @ answer
        return float(np.sqrt(np.mean(rest[:taught] ** 2))), float(
            np.sqrt(np.mean(rest[taught:] ** 2))
        )

    plain = [fit_power(record.temperature_degC, degree)[1] for degree in (0, 1, 3)]
    lagged = []
    for tau_s in np.geomspace(record.period_s, taught * record.period_s / 6.0, LAGS):
        a = float(np.exp(-record.period_s / tau_s))
        first = record.temperature_degC[0]
        lagged.append(
            fit_power(first + lfilter([1.0 - a], [1.0, -a], record.temperature_degC - first), 3)
        )
    return (*plain, min(lagged)[1])
