"""Simulated sensors whose drift is a sum of known effects, for judging what names the missing one.

A case is one sensor in 1 to 8 runs of a chamber: a polynomial of the chip's temperature, 0 to 3
effects of `forms`, noise. Everything is drawn from the priors that the oracle has, by one seed.
Effects are integrated at four steps for each row of the log, from temperatures that differ from the
thermometers' by a slow error; the log has the thermometers' resolution and the converter's steps.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift_lab.oracle.forms import (
    BEND,
    BODIES,
    CHIP,
    LINE,
    RESOLUTION_K,
    SLOW_S,
    Array,
    Candidate,
    Entry,
    SetPrior,
    Signals,
    leave_polynomial,
    measure_scale,
    relax,
    rms,
    tabulate,
)

SUBSTEPS = 4
PROGRAMMES = ("ramps", "steps", "soaks", "day")
COLUMNS = {
    CHIP: "temperature_degC",
    "body_1": "body_1_degC",
    "body_2": "body_2_degC",
    "supply": "supply_V",
    "humidity": "humidity_pct",
    "ambient_light": "light_lux",
    "pressure": "pressure_hPa",
    "acceleration_z": "az_mps2",
    "turn_on": "turn_on",
    "clock": "clock_s",
}
SHARES = {
    **{"load": 0.5, "supply": 0.4, "humidity": 0.4, "ambient_light": 0.3, "pressure": 0.3},
    **{"acceleration_z": 0.3, "turn_on": 0.3, "clock": 0.5},
}
"""How often a sensor has each input."""
SIZES = (3.0, 10.0)
"""Of an effect, in noise levels: multiples of the RMS of the noise's white part."""
CLOCK_S = 1.7e9
"""What the logged clock shows when the first run begins."""
ERRORS_K = (0.0, 0.25, 1.0)
SLOW_RATIOS = (0.0, 0.0, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class HiddenEffect:
    """One effect that the sensor has.

    Attributes:
        kind: the catalogue's name.
        form: the form's name in `forms`.
        signal: the thermometer that it follows.
        options: of the form in an [[effect]] table.
        value: the catalogue's name and the number of the nonlinear value; None without one.
        size: RMS beyond a polynomial of the logged temperature over the noise level; of a
            rewriting form, what it does to the polynomial's first order.
        coefficients: in the output's unit.
    """

    kind: str
    form: str
    signal: str
    options: dict[str, float]
    value: tuple[str, float] | None
    size: float
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Truth:
    """What is known because it was simulated.

    Attributes:
        seed: of the case.
        effects: 0 to 3.
        order: of the polynomial in the chip's temperature.
        noise_level: RMS of the noise's white part, in the output's unit.
        slow_ratio: RMS of the slow part over that of the white one.
        adc_step: in the output's unit.
        thermometer_error_K: RMS of the slow difference of what acts from each thermometer.
        sizes: between which each effect's size was drawn.
    """

    seed: int
    effects: tuple[HiddenEffect, ...]
    order: int
    noise_level: float
    slow_ratio: float
    adc_step: float
    thermometer_error_K: float
    sizes: tuple[float, float]

    @property
    def kinds(self) -> frozenset[str]:
        """The catalogue's names of the effects."""
        return frozenset(effect.kind for effect in self.effects)


@dataclass(frozen=True, eq=False)
class Case:
    """One simulated sensor: its logs as a user would have them, and the truth.

    Attributes:
        signals: as logged; runs side by side, shorter ones held at their last value.
        lengths: rows of each run.
        measured: before compensation, shape (runs, rows).
        reference: the load, shape (runs, rows), zero where none is applied.
        drift: true and free of noise, shape (runs, rows).
        entries: the candidates that these signals can show.
        truth: what is known.
    """

    signals: Signals
    lengths: tuple[int, ...]
    measured: Array
    reference: Array
    drift: Array
    entries: tuple[Entry, ...]
    truth: Truth

    def list_runs(self) -> list[dict[str, Array]]:
        """Return each run's columns as its log has them, each of shape (rows,)."""
        found = []
        for run, length in enumerate(self.lengths):
            columns = {"time_s": self.signals.series["elapsed"][run, :length]}
            for name, column in COLUMNS.items():
                if name in self.signals.series:
                    columns[column] = self.signals.series[name][run, :length]
            if "clock" in self.signals.series:
                columns["clock_s"] = columns["clock_s"] + CLOCK_S
            columns["y_measured"] = self.measured[run, :length]
            if "load" in self.signals.series:
                columns["y_reference"] = self.reference[run, :length]
            found.append(columns)
        return found

    def render_toml(self) -> str:
        """Return zerodrift.toml: the model has the polynomial and no effect beside it."""
        lines = [
            "# Simulated: the oracle's generator.",
            "[sensor]",
            'name = "simulated"',
            'time = "time_s"',
            f'temperature = "{COLUMNS[CHIP]}"',
            f"sample_period_s = {self.signals.step_s}",
            "",
            "[outputs.y]",
            'measured = "y_measured"',
        ]
        if "load" in self.signals.series:
            lines.append('reference = "y_reference"')
        lines += ['unit = "N"', f"full_scale = {self.signals.full_scale}"]
        inputs = [name for name in COLUMNS if name in self.signals.series and name != CHIP]
        if inputs:
            lines += ["", "[inputs]"]
        lines += [f'{name} = "{COLUMNS[name]}"' for name in inputs]
        lines += ["", "[logs]", 'train = ["logs/run_*.csv"]', "tared = false"]
        lines += ["", "[[effect]]", 'kind = "zero_tempco"', f"order = {self.truth.order}"]
        return "\n".join(lines) + "\n"

    def write(self, folder: Path) -> None:
        """Write zerodrift.toml, logs/run_N.csv and, for no program to read, truth.json."""
        (folder / "logs").mkdir(parents=True, exist_ok=True)
        (folder / "zerodrift.toml").write_text(self.render_toml(), encoding="utf-8")
        for run, columns in enumerate(self.list_runs()):
            table = np.stack(list(columns.values()), axis=1)
            path = folder / "logs" / f"run_{run + 1}.csv"
            np.savetxt(path, table, "%.10g", ",", header=",".join(columns), comments="")
        told = json.dumps(asdict(self.truth), indent=2) + "\n"
        (folder / "truth.json").write_text(told, encoding="utf-8")


def draw_case(
    seed: int,
    *,
    count: int | None = None,
    sizes: tuple[float, float] = SIZES,
    runs: int | None = None,
    rows: tuple[int, int] = (1000, 4000),
    thermometers: int | None = None,
    thermometer_error_K: float | None = None,
    slow_ratio: float | None = None,
) -> Case:
    """Return one case; what is left out is drawn.

    Args:
        seed: decides everything that is not asked for.
        count: effects, 0 to 3, as far as the sensor's signals can show so many.
        sizes: between which each effect's size is drawn, in noise levels; twice the same number
            for a point of a curve.
        runs: 1 to 8.
        rows: fewest and most of a run.
        thermometers: 1 to 3.
        thermometer_error_K: one of `ERRORS_K`.
        slow_ratio: RMS of the noise's slow part over that of the white one.

    Raises:
        ValueError: a number out of these ranges.
    """
    rng = np.random.default_rng(seed)
    runs = int(rng.integers(1, 9)) if runs is None else runs
    thermometers = int(rng.integers(1, 4)) if thermometers is None else thermometers
    if not (1 <= runs <= 8 and 1 <= thermometers <= 3 and 0 < sizes[0] <= sizes[1]):
        raise ValueError(f"{runs} runs, {thermometers} thermometers, sizes {sizes}: out of range.")
    if count is not None and not 0 <= count <= 3:
        raise ValueError(f"count = {count}; expected 0 to 3.")
    error_K = float(rng.choice(ERRORS_K)) if thermometer_error_K is None else thermometer_error_K
    ratio = float(rng.choice(SLOW_RATIOS)) if slow_ratio is None else slow_ratio
    lengths = tuple(int(n) for n in rng.integers(rows[0], rows[1] + 1, runs))
    step_s = float(rng.choice([1.0, 2.0, 5.0]))
    fine = _draw_signals(rng, lengths, step_s, thermometers)
    logged = _log(rng, fine)
    fine = _mislead(rng, fine, error_K)
    true = _thin(fine)
    entries = tabulate(logged, lengths)
    prior = SetPrior([entry.candidate for entry in entries])
    number = int(rng.integers(prior.most + 1)) if count is None else min(count, prior.most)
    chosen = prior.draw(rng, number)
    drift, effects, order = _draw_drift(rng, fine, true, lengths, entries, chosen, sizes)

    # From here on in the output's unit; so far in noise levels.
    level = 10.0 ** rng.uniform(-3.0, 0.0)
    slow = draw_slow(rng, drift.shape, step_s) if ratio else np.zeros(drift.shape)
    noise = level * (rng.standard_normal(drift.shape) + ratio * slow)
    adc_step = level * float(rng.choice([0.1, 0.5, 1.0]))
    full_scale = 2000.0 * level
    load = logged.series.get("load", np.zeros(drift.shape)) * full_scale
    measured = np.round((load + level * drift + noise) / adc_step) * adc_step
    series = {**logged.series, **({"load": load} if "load" in logged.series else {})}
    effects = tuple(_turn_to_unit(one, level, full_scale) for one in effects)
    truth = Truth(seed, effects, order, level, ratio, adc_step, error_K, sizes)
    return Case(
        signals=Signals(series, step_s, full_scale),
        lengths=lengths,
        measured=measured,
        reference=load,
        drift=level * drift,
        entries=tuple(_scale_load(entry, full_scale) for entry in entries),
        truth=truth,
    )


LOAD_KINDS = ("span_tempco", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk")
"""Their columns are in the load's unit; while a case is drawn, the full scale is 1."""


def _turn_to_unit(effect: HiddenEffect, level: float, full_scale: float) -> HiddenEffect:
    """Return the effect with coefficients in the output's unit."""
    unit = level / (full_scale if effect.kind in LOAD_KINDS else 1.0)
    return replace(effect, coefficients=tuple(unit * k for k in effect.coefficients))


def _scale_load(entry: Entry, full_scale: float) -> Entry:
    """Return the entry in the load's unit."""
    if entry.candidate.form.kind not in LOAD_KINDS:
        return entry
    columns = tuple(column * full_scale for column in entry.columns)
    return replace(entry, columns=columns, scale=entry.scale * full_scale)


def draw_slow(rng: np.random.Generator, shape: tuple[int, ...], step_s: float) -> Array:
    """Return noise of RMS 1 with the covariance (1 + t/s) exp(-t/s), s = SLOW_S, along rows.

    Args:
        rng: draws.
        shape: (runs, rows).
        step_s: between rows.
    """
    burn = round(8.0 * SLOW_S / step_s)
    driven = rng.standard_normal((shape[0], shape[1] + burn))
    tau_s = np.array([SLOW_S])
    found = relax(relax(driven, tau_s, step_s)[0], tau_s, step_s)[0]
    slow: Array = found[:, burn:] * math.sqrt(4.0 * SLOW_S / step_s)
    return slow


def _draw_drift(
    rng: np.random.Generator,
    fine: Signals,
    true: Signals,
    lengths: Sequence[int],
    entries: Sequence[Entry],
    chosen: Sequence[Candidate],
    sizes: tuple[float, float],
) -> tuple[Array, tuple[HiddenEffect, ...], int]:
    """Return the drift in noise levels (runs, rows), its effects, and the polynomial's order."""
    flat = _flatten(true.series[CHIP], lengths)
    middle = flat.mean()
    seen = true.series[CHIP]  # what the polynomial sees
    line = float(rng.choice([-1.0, 1.0]) * rng.uniform(*LINE) / flat.std())
    drift, effects = np.zeros(seen.shape), []
    for one in chosen:
        entry = next(entry for entry in entries if entry.candidate == one)
        while True:
            value = one.form.draw(rng)
            if not entry.allowed[int(np.argmin(np.abs(entry.grid - value)))]:
                continue
            built = one.form.build(fine, one.signal, np.array([value]))
            columns = [column[0][:, ::SUBSTEPS] for column in built]
            ends = [_flatten(column, lengths)[None] for column in columns]
            scale = measure_scale(one, ends, flat)[:, 0]
            if not np.isnan(scale).any():
                break
        size = float(rng.choice([-1.0, 1.0]) * rng.uniform(*sizes))
        if one.form.rewrites:
            seen, line = columns[0], size / float(scale[0])
            coefficients = [line]
        else:
            mixed = rng.standard_normal(len(columns)) / scale
            together = sum(k * end[0] for k, end in zip(mixed, ends, strict=True))
            coefficients = list(size * mixed / rms(leave_polynomial(together, flat)))
            drift += sum(k * column for k, column in zip(coefficients, columns, strict=True))
        effects.append(
            HiddenEffect(
                kind=one.form.kind,
                form=one.form.name,
                signal=one.signal,
                options=dict(one.form.options),
                value=(one.form.value, value) if one.form.value else None,
                size=abs(size),
                coefficients=tuple(float(k) for k in coefficients),
            )
        )
    order = int(rng.integers(1, 3))
    drift += line * (seen - middle)
    if order == 2:
        bent = (flat - middle) ** 2
        drift += BEND * rng.standard_normal() / bent.std() * (seen - middle) ** 2
    return drift, tuple(effects), order


def _flatten(x: Array, lengths: Sequence[int]) -> Array:
    """Return the runs end to end, without what pads them."""
    return np.concatenate([run[:length] for run, length in zip(x, lengths, strict=True)])


def _thin(fine: Signals) -> Signals:
    """Return the signals at the log's rows."""
    series = {name: x[:, ::SUBSTEPS] for name, x in fine.series.items()}
    return Signals(series, fine.step_s * SUBSTEPS, fine.full_scale)


def _log(rng: np.random.Generator, fine: Signals) -> Signals:
    """Return what is logged: thermometers by their resolution, no clock in some."""
    thinned = _thin(fine)
    series = dict(thinned.series)
    if rng.random() >= SHARES["clock"]:
        del series["clock"]
    for name in (CHIP, *BODIES):
        if name in series:
            series[name] = np.round(series[name] / RESOLUTION_K) * RESOLUTION_K
    return Signals(series, thinned.step_s, fine.full_scale)


def _mislead(rng: np.random.Generator, fine: Signals, error_K: float) -> Signals:
    """Return the signals with the temperatures that act: each thermometer's and a slow error.

    The chamber holds what its thermometers show, and the parts beside them wander about it; an
    error so made is independent of what is logged (Berkson's), as the oracle takes it.
    """
    series = dict(fine.series)
    for name in (CHIP, *BODIES):
        if name in series and error_K:
            rows = np.arange(0, series[name].shape[1], SUBSTEPS)
            wrong = draw_slow(rng, (len(series[name]), rows.size), fine.step_s * SUBSTEPS)
            every = np.arange(series[name].shape[1])
            added = np.stack([np.interp(every, rows, one) for one in wrong])
            series[name] = series[name] + error_K * added
    return Signals(series, fine.step_s, fine.full_scale)


# Programmes: what a chamber, a bench and the weather do, at fine steps.


def _draw_signals(
    rng: np.random.Generator, lengths: Sequence[int], step_s: float, thermometers: int
) -> Signals:
    """Return true signals at fine steps; loads are parts of the full scale, which is 1."""
    fine_s = step_s / SUBSTEPS
    shape = (len(lengths), max(lengths) * SUBSTEPS)
    time: Array = np.arange(shape[1], dtype=np.float64) * fine_s
    low, high = sorted(rng.uniform([-15.0, 35.0], [15.0, 75.0]))
    air = np.empty(shape)
    for run, length in enumerate(lengths):
        kind = str(rng.choice(PROGRAMMES))
        air[run] = draw_air(rng, kind, length * step_s, time, (low, high))
    air = _relax_one(air, rng.uniform(30.0, 120.0), fine_s)
    series = {CHIP: _relax_one(air, rng.uniform(10.0, 60.0), fine_s)}
    for name in BODIES[: thermometers - 1]:
        around = rng.uniform(0.3, 1.0)
        source = around * air + (1.0 - around) * 25.0
        series[name] = _relax_one(source, rng.uniform(150.0, 900.0), fine_s)
    series["elapsed"] = np.repeat(time[None], shape[0], axis=0)
    starts = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 4.0, shape[0] - 1) * 86400.0)])
    series["clock"] = starts[:, None] + time
    for name, share in SHARES.items():
        if name != "clock" and rng.random() < share:
            series[name] = np.stack(
                [_draw_input(rng, name, length * step_s, time) for length in lengths]
            )
    if "humidity" in series:
        series["humidity"] = _relax_one(series["humidity"], 120.0, fine_s)
    for x in series.values():  # a shorter run is held at its last row
        for run, length in enumerate(lengths):
            x[run, length * SUBSTEPS :] = x[run, (length - 1) * SUBSTEPS]
    return Signals(series, fine_s, 1.0)


def _relax_one(x: Array, tau_s: float, step_s: float) -> Array:
    found: Array = relax(x, np.array([tau_s]), step_s)[0]
    return found


def draw_air(
    rng: np.random.Generator, kind: str, seconds: float, time: Array, span: tuple[float, float]
) -> Array:
    """Return the air's temperature of one run, degC, shape of `time`.

    Args:
        rng: draws.
        kind: one of `PROGRAMMES`.
        seconds: of the run.
        time: in s.
        span: lowest and highest, degC.
    """
    low, high = span
    if kind == "day":
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        period_s, phase = seconds * rng.uniform(0.4, 1.2), rng.uniform(0.0, 2.0 * math.pi)
        cloud = 0.2 * half * np.sin(2.0 * math.pi * time / (0.23 * period_s) + 3.0 * phase)
        found: Array = middle + 0.8 * half * np.sin(2.0 * math.pi * time / period_s + phase) + cloud
        return found
    now, value = 0.0, float(rng.uniform(low, high))
    points = [(now, value)]
    while now < seconds:
        goal = float(rng.uniform(low, high))
        if kind == "ramps":
            pace, hold = rng.uniform(0.08, 0.25) * seconds, rng.uniform(0.0, 0.05) * seconds
            goal = high if value < 0.5 * (low + high) else low
            goal += 0.2 * (value - goal) * rng.random()
        elif kind == "steps":
            pace, hold = 20.0, rng.uniform(0.05, 0.2) * seconds
        else:
            pace, hold = rng.uniform(0.03, 0.1) * seconds, rng.uniform(0.15, 0.4) * seconds
        now += pace
        points.append((now, goal))
        now += hold + 1.0
        points.append((now, goal))
        value = goal
    return _join(points, time)


def _join(points: Sequence[tuple[float, float]], time: Array) -> Array:
    """Return straight lines through (s, level), shape of `time`."""
    seconds, levels = np.array(points).T
    found: Array = np.interp(time, seconds, levels)
    return found


def _draw_steps(
    rng: np.random.Generator, low: float, high: float, seconds: float, time: Array
) -> Array:
    """Return levels drawn evenly, each held a while, with rises of some seconds."""
    now, points = 0.0, [(0.0, float(rng.uniform(low, high)))]
    while now < seconds:
        now += rng.uniform(0.04, 0.15) * seconds
        points.append((now, points[-1][1]))
        now += rng.uniform(5.0, 20.0)
        points.append((now, float(rng.uniform(low, high))))
    return _join(points, time)


def _draw_input(rng: np.random.Generator, name: str, seconds: float, time: Array) -> Array:
    """Return one run of an input, in its column's unit; loads are parts of the full scale."""
    if name == "turn_on":
        return np.full(time.shape, rng.standard_normal())
    if name == "load":
        found = _draw_steps(rng, -1.0, 1.0, seconds, time)
        return np.where(time < 0.03 * seconds, 0.0, found)
    low, high = {
        "supply": (4.5, 5.5),
        "humidity": (20.0, 90.0),
        "ambient_light": (0.0, 1000.0),
        "pressure": (960.0, 1030.0),
        "acceleration_z": (-9.81, 9.81),
    }[name]
    return _draw_steps(rng, low, high, seconds, time)
