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
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.one_gate.drive import Answer, ask
from benchmarks.one_gate.in_use import (
    BEFORE_DAYS,
    CHANGES,
    DAY_S,
    KINDS,
    PERIOD_S,
    SOUND,
    START_S,
    SWAP_DAYS,
    SWAPS,
    UNITS,
    Use,
    build_fleet,
    build_unit,
    draw_field,
    draw_unit,
    draw_use,
    make_log,
    name_unit,
)
from benchmarks.one_gate.results import Row, scratch, tell_rate
from benchmarks.one_gate.sensor import Array, write_csv

RIGHT, WRONG, SILENT, OPEN = "right", "wrong", "no alarm", "left open"


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
    table = make_log(START_S, warm, units[here].drift(warm), rng)
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
