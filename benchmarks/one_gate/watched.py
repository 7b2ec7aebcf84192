"""`monitor` over logs with gaps, and over units that were swapped; models are trained, not true.

A unit drifts by a polynomial of temperature that its model knows, and by a lag and a cubic part
that it does not: trained on chamber runs, the model misfits in use by 0.1 to 0.3 of the noise,
which raises the RMS that it leaves by 5 % at most, so that nobody sees it there. In use it is
logged for 20 days (the first 14 are learnt from), then not for two to nine weeks, then for 10 days
more, as two logs or as one. Its zero ages all the time, or steps at an instant within the gap, or
nothing happens. Of 20 units, one is swapped for another; a stranger is one that nobody knows. All
of it is simulated; noise is white.

A step is right where the change is told to lie between two times that hold the true one. Ageing is
right where it is named, with the true rate in the interval where one is told, or where it stays
open what happened between two times that hold the whole gap; "at once" is wrong.
"""

import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.one_gate.draw import follow
from benchmarks.one_gate.drive import Answer, ask
from benchmarks.one_gate.results import Row, scratch, tell_rate
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

RIGHT, WRONG, SILENT, OPEN = "right", "wrong", "no alarm", "left open"


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


def _table(start_s: float, warm: Array, drift: Array, rng: np.random.Generator) -> dict[str, Array]:
    time_s = start_s + PERIOD_S * np.arange(warm.size)
    measured = drift + NOISE * rng.standard_normal(warm.size)
    return {"time_s": time_s, "temperature_degC": warm, "y_N": measured}


def write_calibration(unit: Unit, folder: Path, rng: np.random.Generator) -> None:
    """Write five chamber runs of a unit as `cal_1.csv` to `cal_5.csv`."""
    folder.mkdir(parents=True, exist_ok=True)
    for n in range(5):
        warm = draw_chamber(rng)
        start_s = START_S - (30.0 - 3.0 * n) * DAY_S
        write_csv(_table(start_s, warm, unit.drift(warm), rng), folder / f"cal_{n + 1}.csv")


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


@cache
def build_unit(seed: int) -> tuple[Unit, Path]:
    """Return a unit and its project with firmware, made once in this process.

    Raises:
        FailedError: `firmware` did not end well.
    """
    rng = np.random.default_rng([seed, 1])
    unit, folder = draw_unit(rng), Path(tempfile.mkdtemp(prefix="one_gate_"))
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
    folder = Path(tempfile.mkdtemp(prefix="one_gate_"))
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
    table = _table(START_S, warm, unit.drift(warm) + 3.0 * rng.normal(), rng)
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


def watch(
    folder: Path, logs: Sequence[Mapping[str, Array]], scratched: Path, *words: str
) -> list[Answer]:
    """Run `monitor` on one log after the other, with a state of its own; returns each answer."""
    answers = []
    for n, columns in enumerate(logs):
        write_csv(columns, scratched / f"field_{n + 1}.csv")
        given = ("--load", "y=0", "--state", str(scratched / "state.json"), *words)
        answers.append(ask(folder, "monitor", *given, str(scratched / f"field_{n + 1}.csv")))
    return answers


DATE = r"\d{4}-\d\d-\d\d(?:[ T]\d\d:\d\d(?::\d\d)?)?"


def read_date(text: str, *, end: bool = False) -> float:
    """Return a date of UTC in seconds since 1970: the begin of a day or minute, or its end.

    Raises:
        ValueError: it is no date.
    """
    bare = text.removesuffix(" UTC").removesuffix("Z").strip()
    told = datetime.fromisoformat(bare).replace(tzinfo=UTC).timestamp()
    return told + (end * {10: DAY_S, 16: 60.0}.get(len(bare), 1.0))


BOUNDS = (("earliest", "latest"), ("not_before", "not_after"), ("from", "to"), ("low", "high"))
"""Pairs of words by which the two ends of an interval may be called."""


def read_between(output: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return between which times the change is told to lie: from the verdict, else the text."""
    verdict = output.get("verdict") or {}
    for first, last in _list_pairs(verdict):
        try:
            low = read_date(first) if isinstance(first, str) else float(first)
            high = read_date(last, end=True) if isinstance(last, str) else float(last)
        except (TypeError, ValueError):
            continue
        if low > START_S - 365.0 * DAY_S:  # else it is no time
            return low, high
    said = re.search(rf"between ({DATE})\D{{1,9}}({DATE})", str(output.get("text", "")))
    return (read_date(said[1]), read_date(said[2], end=True)) if said else None


def _list_pairs(told: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
    """Give what may be an interval in a verdict: lists of two, or two keys that are its ends."""
    for value in told.values():
        if isinstance(value, list) and len(value) == 2:
            yield value[0], value[1]
        elif isinstance(value, dict):
            yield from _list_pairs(value)
    for first, last in BOUNDS:
        for key in told:
            if key.endswith(first) and key[: -len(first)] + last in told:
                yield told[key], told[key[: -len(first)] + last]


def read_rate(output: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the interval of an ageing rate per day, where one is told."""
    found = (output.get("verdict") or {}).get("rate_per_day")
    if isinstance(found, list) and len(found) == 2:
        return float(found[0]), float(found[1])
    return None


def judge(kind: str, use: Use, output: Mapping[str, Any]) -> str:
    """Return what is to be said of a verdict."""
    verdict = output.get("verdict") or {}
    cause, between = str(verdict.get("cause", "")), read_between(output)
    if not cause:
        return SILENT
    if kind.startswith("no change"):
        return WRONG
    if kind.startswith("step"):
        if cause not in ("step", "undecided"):
            return WRONG
        if between is None:
            return OPEN if cause == "undecided" else WRONG
        return RIGHT if between[0] <= use.at <= between[1] else WRONG
    if cause == "ageing":
        rate = read_rate(output)
        return RIGHT if rate is None or rate[0] <= use.rate_per_day <= rate[1] else WRONG
    if cause != "undecided":
        return WRONG
    whole = between is not None and between[0] <= use.gap[0] and between[1] >= use.gap[1]
    return RIGHT if whole else OPEN


def examine(kind: str, seed: int) -> Row:
    """Draw a case, run `monitor`, and return what it says."""
    return _examine_swap(kind, seed) if kind in SWAPS else _examine_gap(kind, seed)


def _examine_gap(kind: str, seed: int) -> Row:
    unit, folder = build_unit(seed % 5)
    use = draw_use(unit, kind, np.random.default_rng([seed, 3 + KINDS.index(kind)]))
    with scratch() as scratched:
        answers = watch(folder, use.logs, scratched)
    last = answers[-1]
    output = dict(last.told.get("outputs", {}).get("y", {}))
    between = read_between(output)
    rate = read_rate(output)
    return {
        "outcome": judge(kind, use, output) if last.told else f"exit code {last.code}",
        "early": not use.rate_per_day and any(answer.code == 1 for answer in answers[:-1]),
        "gap_days": (use.gap[1] - use.gap[0]) / DAY_S,
        "width_days": (between[1] - between[0]) / DAY_S if between else None,
        "rate_told": rate is not None,
        "verdict": output.get("verdict"),
        "text": output.get("text", ""),
        "message": last.message[:300],
    }


def _examine_swap(kind: str, seed: int) -> Row:
    units, folder = build_fleet(seed // UNITS)
    rng = np.random.default_rng([seed, 3 + KINDS.index(kind)])
    here = seed % UNITS
    there = int(rng.choice([n for n in range(UNITS) if n != here]))
    other = units[there] if kind == SWAPS[0] else draw_unit(rng)
    warm = draw_field(rng, int((BEFORE_DAYS + SWAP_DAYS) * DAY_S / PERIOD_S))
    table = _table(START_S, warm, units[here].drift(warm), rng)
    swapped = table["time_s"] >= START_S + BEFORE_DAYS * DAY_S
    change = other.drift(warm) - units[here].drift(warm) + 5.0 * rng.normal()
    table["y_N"] += change * swapped
    parts = [{n: v[~swapped] for n, v in table.items()}, {n: v[swapped] for n, v in table.items()}]
    with scratch() as scratched:
        answers = watch(folder, parts, scratched, "--sensor", name_unit(here))
    last = answers[-1]
    told = last.told.get("other_unit") or {}
    named = next((v for k, v in told.items() if k in ("named", "unit", "serial", "name") and v), "")
    if told.get("state") == "named":
        right = kind == SWAPS[0] and name_unit(there) in str(told)
        outcome = RIGHT if right else WRONG
    else:
        outcome = OPEN if last.told else f"exit code {last.code}"
    output = dict(last.told.get("outputs", {}).get("y", {}))
    return {
        "outcome": outcome,
        "early": answers[0].code == 1,
        "here": name_unit(here),
        "there": name_unit(there) if kind == SWAPS[0] else "",
        "named": str(named),
        "other_unit": told,
        "verdict": output.get("verdict"),
        "text": output.get("text", ""),
        "message": last.message[:300],
    }


def tell(rows: list[Row]) -> None:
    """Print what was said of each kind, how wide the intervals were, and what was wrong."""
    for row in rows:
        good = SILENT if row["kind"] in SOUND else OPEN if row["kind"] == SWAPS[1] else RIGHT
        if row["outcome"] == good and not row["early"]:
            continue
        early = ", an alarm before anything happened" if row["early"] else ""
        verdict = row["verdict"] or {}
        print(f"{row['kind']}, seed {row['seed']}: {row['outcome']}{early}")
        print(f"    {verdict.get('cause', '')}: {row['text'][:200]} {row['message'][:160]}")
        if row.get("other_unit"):
            print(f"    in place: {row['there'] or 'a stranger'}; told: {row['other_unit']}")
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        outcomes = dict.fromkeys(row["outcome"] for row in mine)
        counts = {name: sum(row["outcome"] == name for row in mine) for name in outcomes}
        words = ", ".join(f"{name} {count}" for name, count in counts.items())
        wide = [r["width_days"] - r["gap_days"] for r in mine if r.get("width_days") is not None]
        more = f"; interval wider than the gap by {np.median(wide):.1f} days" if wide else ""
        print(f"{kind:30s} {words or 'not run'}{more}")
    changed = [row for row in rows if row["kind"] in CHANGES]
    sound = [row for row in rows if row["kind"] in SOUND]
    known = [row for row in rows if row["kind"] == SWAPS[0]]
    swaps = [row for row in rows if row["kind"] in SWAPS]
    right = sum(row["outcome"] == RIGHT for row in changed)
    print("changes in a gap told right (simulated)", tell_rate(right, len(changed), upper=False))
    alarms = sum(row["outcome"] != SILENT or row["early"] for row in sound)
    print("alarms where nothing changed", tell_rate(alarms, len(sound), upper=True))
    right = sum(row["outcome"] == RIGHT for row in known)
    print("swapped unit named right", tell_rate(right, len(known), upper=False))
    wrong = sum(row["outcome"] == WRONG for row in swaps)
    print("a false name", tell_rate(wrong, len(swaps), upper=True))
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")
