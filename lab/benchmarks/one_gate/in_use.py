"""Simulated units in use, the projects that their models come from, and what is logged of them."""

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.one_gate.draw import follow
from benchmarks.one_gate.drive import ask
from benchmarks.one_gate.sensor import Array, write_csv

PERIOD_S = 300.0
DAY_S = 86_400.0
START_S = 1_767_225_600.0
"""2026-01-01 00:00 UTC: begin of the use."""
NOISE = 0.5
BEFORE_DAYS, AFTER_DAYS = 20.0, 10.0
GAP_DAYS = (14.0, 63.0)
UNITS = 20
SPREAD = np.array([20.0, 15.0, 4.0])
"""Of offset, slope and curvature between units, over 20 K."""
MIDDLE_DEGC, REACH_K = 22.0, 20.0
MISFIT = (0.1, 0.3)
"""Of a trained model in use, over the noise of a sample."""
STEP = 5.0
"""Of the zero, over the noise of a sample."""
SWAP_DAYS = 12.0
"""Of logs after the swap."""
CHANGES = (
    "step, log after log",
    "step, within a log",
    "ageing, log after log",
    "ageing, within a log",
)
SOUND = ("no change, log after log", "no change, within a log")
SWAPS = ("one of 20 known in its place", "a stranger in its place")
KINDS = (*CHANGES, *SOUND, *SWAPS)
SEEDS = 20
"""Of each kind; the sound ones are few, as they only show that a gap raises no alarm by itself."""


@dataclass(frozen=True)
class Unit:
    """A simulated unit: what its model can know of its drift, and what it cannot.

    Attributes:
        known: coefficients of 1, x, x^2, x = temperature less 22 degC over 20 K.
        lagging: of x some hours late less x.
        cubic: of x^3.
        tau_s: of the lag.
    """

    known: tuple[float, float, float]
    lagging: float
    cubic: float
    tau_s: float

    def drift(self, warm: Array) -> Array:
        """Return the drift [n] at temperatures [n] that are PERIOD_S apart."""
        x = (warm - MIDDLE_DEGC) / REACH_K
        late = follow(x, self.tau_s, PERIOD_S) - x
        known = np.polynomial.polynomial.polyval(x, self.known)
        return np.asarray(known + self.lagging * late + self.cubic * x**3)


def draw_unit(rng: np.random.Generator) -> Unit:
    """Return a unit whose model, fitted to chamber runs, misfits by `MISFIT` of the noise."""
    a, b, c = (SPREAD * rng.normal(size=3)).tolist()
    unit = Unit((a, b, c), float(rng.normal()), float(rng.normal()), float(rng.uniform(1e3, 6e3)))
    misfit = measure_misfit(unit, [draw_chamber(rng) for _ in range(5)], draw_field(rng, 2880))
    by = rng.uniform(*MISFIT) * NOISE / misfit
    return replace(unit, lagging=by * unit.lagging, cubic=by * unit.cubic)


def measure_misfit(unit: Unit, chambers: Sequence[Array], field: Array) -> float:
    """Return standard deviation in use of what a parabola fitted to chamber runs leaves."""
    x = (np.concatenate(chambers) - MIDDLE_DEGC) / REACH_K
    drift = np.concatenate([unit.drift(warm) for warm in chambers])
    told = np.polynomial.polynomial.polyfit(x, drift, 2)
    x = (field - MIDDLE_DEGC) / REACH_K
    return float(np.std(unit.drift(field) - np.polynomial.polynomial.polyval(x, told)))


def draw_field(rng: np.random.Generator, rows: int) -> Array:
    """Return temperatures in use [n], degC: days, weather, season."""
    day = np.arange(rows) * PERIOD_S / DAY_S
    warm = np.full(rows, MIDDLE_DEGC)
    for period, swing in ((1.0, 6.0), (4.7, 3.0), (11.0, 3.0), (90.0, 3.0)):
        warm += swing * rng.uniform(0.5, 1.0) * np.sin(2 * np.pi * (day / period + rng.random()))
    return np.round(warm, 3)


def draw_chamber(rng: np.random.Generator) -> Array:
    """Return temperatures of a chamber run [n], degC: ramps between levels, and holds."""
    levels = [MIDDLE_DEGC, *rng.permutation([-8.0, 52.0, 5.0, 38.0]).tolist(), MIDDLE_DEGC]
    warm = [
        np.concatenate([np.linspace(a, b, int(rng.integers(36, 60))), np.full(30, b)])
        for a, b in pairwise(levels)
    ]
    return np.round(follow(np.concatenate(warm), 1200.0, PERIOD_S), 3)


def make_log(
    start_s: float, warm: Array, drift: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Return a log of a unit's drift [n] at temperatures [n], with noise."""
    time_s: Array = start_s + PERIOD_S * np.arange(warm.size, dtype=np.float64)
    measured = drift + NOISE * rng.standard_normal(warm.size)
    return {"time_s": time_s, "temperature_degC": warm, "y_N": measured}


def write_calibration(unit: Unit, folder: Path, rng: np.random.Generator) -> None:
    """Write five chamber runs of a unit as `cal_1.csv` to `cal_5.csv`."""
    folder.mkdir(parents=True, exist_ok=True)
    for n in range(5):
        warm = draw_chamber(rng)
        start_s = START_S - (30.0 - 3.0 * n) * DAY_S
        write_csv(make_log(start_s, warm, unit.drift(warm), rng), folder / f"cal_{n + 1}.csv")


def render_toml(*, fleet: bool) -> str:
    """Return zerodrift.toml of one unit, or of the fleet below `units/`."""
    logs = "cal_*.csv" if fleet else "logs/cal_*.csv"
    text = f"""# Simulated.
[sensor]
name = "watched"
time = "time_s"
temperature = {{ column = "temperature_degC", unit = "degC", raw = "int16", lsb = 0.0078125 }}
sample_period_s = {PERIOD_S:g}

[outputs.y]
measured = "y_N"
unit = "N"
full_scale = 2000

[logs]
train = ["{logs}"]

[[effect]]
kind = "zero_tempco"
order = 2

[network]
kind = "none"
"""
    return "format = 2\n" + text + ('\n[fleet]\nfolder = "units/{sensor}"\n' if fleet else "")


class FailedError(RuntimeError):
    """A command that is no part of what is judged did not do its work."""


def _keep_folder() -> Path:
    """Return a new folder that goes away with this process."""
    folder = Path(tempfile.mkdtemp(prefix="one_gate_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def build_unit(seed: int) -> tuple[Unit, Path]:
    """Return a unit and its project with firmware, made once in this process.

    Raises:
        FailedError: `firmware` did not end well.
    """
    rng = np.random.default_rng([seed, 1])
    unit, folder = draw_unit(rng), _keep_folder()
    write_calibration(unit, folder / "logs", rng)
    (folder / "zerodrift.toml").write_text(render_toml(fleet=False), encoding="utf-8")
    answer = ask(folder, "firmware")
    if answer.code != 0:
        raise FailedError(f"firmware: exit code {answer.code}: {answer.message} {answer.told}")
    return unit, folder


@cache
def build_fleet(seed: int) -> tuple[tuple[Unit, ...], Path]:
    """Return 20 units and their fleet with firmware, made once in this process.

    Raises:
        FailedError: `fleet` did not end well.
    """
    rng = np.random.default_rng([seed, 2])
    units = tuple(draw_unit(rng) for _ in range(UNITS))
    folder = _keep_folder()
    write_calibration(draw_unit(rng), folder, rng)  # what the design's own [logs] name
    for n, unit in enumerate(units):
        write_calibration(unit, folder / "units" / name_unit(n), rng)
    (folder / "zerodrift.toml").write_text(render_toml(fleet=True), encoding="utf-8")
    answer = ask(folder, "fleet")
    made = sorted(path.name for path in (folder / "firmware").glob("SN*"))
    if len(made) != UNITS:
        raise FailedError(f"fleet: exit code {answer.code}, {len(made)} units: {answer.message}")
    return units, folder


def name_unit(number: int) -> str:
    """Return a serial number."""
    return f"SN{number:04d}"


@dataclass(frozen=True, eq=False)
class Use:
    """What is logged of a unit in use, and what happened when, in seconds since 1970."""

    logs: tuple[Mapping[str, Array], ...]
    gap: tuple[float, float]
    at: float
    rate_per_day: float


def draw_use(unit: Unit, kind: str, rng: np.random.Generator) -> Use:
    """Return the logs of a unit's use with a gap."""
    gap_s = float(rng.uniform(*GAP_DAYS)) * DAY_S
    begin_s = START_S + BEFORE_DAYS * DAY_S
    rows = int((BEFORE_DAYS + AFTER_DAYS) * DAY_S / PERIOD_S + gap_s / PERIOD_S)
    warm = draw_field(rng, rows)
    table = make_log(START_S, warm, unit.drift(warm) + 3.0 * rng.normal(), rng)
    time_s, sign = table["time_s"], float(rng.choice([-1.0, 1.0]))
    at, rate = float("nan"), 0.0
    if kind.startswith("step"):
        at = begin_s + float(rng.uniform(0.0, gap_s))
        table["y_N"] += sign * STEP * NOISE * (time_s >= at)
    elif kind.startswith("ageing"):
        rate = sign * float(rng.uniform(0.05, 0.2)) * NOISE
        table["y_N"] += rate * (time_s - START_S) / DAY_S
    before, after = time_s < begin_s, time_s >= begin_s + gap_s
    gap = (float(time_s[before][-1]), float(time_s[after][0]))
    parts = (before, after) if kind.endswith("log after log") else (before | after,)
    logs = tuple({name: values[part] for name, values in table.items()} for part in parts)
    return Use(logs, gap, at, rate)
