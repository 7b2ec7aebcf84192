"""The tables: rates with one-sided 95 % bounds, calibration, the staircase, and every failure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.bench_conditions import bound
from benchmarks.evidence.conditions import CONDITIONS, PURPOSES
from benchmarks.evidence.judge import Row

FEWEST_IN_A_BAND = 200


def tell_least(count: int, cases: int) -> str:
    """Return a rate that should be high, with its lower bound."""
    least = 100 * bound(count, cases, upper=False)
    return f"{count}/{cases} {100 * count / cases:.1f} % (at least {least:.1f} %)"


def tell_most(count: int, cases: int) -> str:
    """Return a rate that should be low, with its upper bound."""
    most = 100 * bound(count, cases, upper=True)
    return f"{count}/{cases} {100 * count / cases:.1f} % (at most {most:.1f} %)"


def list_conditions(rows: Sequence[Row]) -> list[str]:
    """Return the table of conditions, a line for each condition and purpose, then of all."""
    lines = []
    for name in (*CONDITIONS, "all"):
        for purpose in PURPOSES:
            mine = [
                row
                for row in rows
                if row.ask.condition in CONDITIONS
                and name in (row.ask.condition, "all")
                and row.ask.purpose == purpose
                and row.counts
            ]
            if mine:
                lines.append(f"{name:16s} {purpose:9s} {_tell_purpose(mine, purpose)}")
    return lines


def _tell_purpose(rows: Sequence[Row], purpose: str) -> str:
    cases = len(rows)
    right = tell_least(sum(row.right for row in rows), cases)
    wrong = tell_most(sum(row.wrong_name for row in rows), cases)
    refused = tell_most(sum(row.refused_add for row in rows), cases)
    failed = sum(bool(row.failed) for row in rows)
    told = f"errors {failed}, " * bool(failed)
    told += f"MISSING and add refused {refused}"
    if purpose == "beside":
        rest = tell_least(sum(row.right and row.tells_rest for row in rows), cases)
        return f"named {right}; and something else told {rest}; another {wrong}; {told}"
    if purpose != "one":
        good = "complete" if purpose == "complete" else "unknown"
        return f"{good} {right}; named {wrong}; {told}{_tell_unlike(rows)}"
    first = sum(row.effect in row.ask.hidden for row in rows)
    nearest = sum(row.effect is None and row.nearest in row.ask.hidden for row in rows)
    silent = sum(row.verdict == "complete" for row in rows)
    return (
        f"named, look-alikes included {right}; first {first}; another {wrong}; "
        f"called complete {silent}; UNKNOWN with the truth nearest {nearest}; {told}"
    )


def _tell_unlike(rows: Sequence[Row]) -> str:
    """Return how many are named of the cases that no form of the catalogue imitates."""
    unlike = [row for row in rows if row.form_error is not None and not row.imitated]
    if not unlike:
        return ""
    named = tell_most(sum(row.wrong_name for row in unlike), len(unlike))
    return f"; of those that no form imitates named {named}"


@dataclass(frozen=True)
class Band:
    """Entries whose told probabilities are neighbours."""

    count: int
    told: float
    true: float


def cut_bands(entries: Sequence[tuple[float, bool]]) -> list[Band]:
    """Return bands of at least `FEWEST_IN_A_BAND` entries, at most ten; fewer entries are one."""
    ordered = sorted(entries)
    if not ordered:
        return []
    number = max(1, min(10, len(ordered) // FEWEST_IN_A_BAND))
    bands = []
    for part in np.array_split(np.arange(len(ordered)), number):
        told = [ordered[i][0] for i in part]
        true = [float(ordered[i][1]) for i in part]
        bands.append(Band(len(part), float(np.mean(told)), float(np.mean(true))))
    return bands


def measure_calibration(bands: Sequence[Band]) -> float:
    """Return the expected calibration error: mean |told - true| over entries."""
    total = sum(band.count for band in bands)
    return sum(band.count * abs(band.told - band.true) for band in bands) / total


def list_entries(rows: Sequence[Row]) -> dict[str, list[tuple[float, bool]]]:
    """Return each kind of probability with what was told and what is true."""
    found: dict[str, list[tuple[float, bool]]] = {
        "every candidate": [],
        "named effect": [],
        "nothing missing": [],
        "something else": [],
    }
    for row in rows:
        if row.failed or not row.counts:
            continue
        hidden = set(row.ask.listed)
        for name, p in row.probabilities.items():
            found["every candidate"].append((p, name in hidden))
        found["nothing missing"].append((row.nothing_missing, not row.ask.hidden))
        if row.effect is not None:
            told = row.probabilities.get(row.effect, 0.0)
            found["named effect"].append((told, row.effect in hidden))
            rest = set(row.ask.hidden) - {row.effect}
            found["something else"].append((row.something_else, bool(rest)))
    return found


def list_calibration(rows: Sequence[Row]) -> list[str]:
    """Return a line for each kind of probability."""
    lines = []
    for name, entries in list_entries(rows).items():
        if not entries:
            continue
        bands = cut_bands(entries)
        few = "" if len(entries) >= FEWEST_IN_A_BAND else " (fewer than a band needs)"
        told = ", ".join(f"{100 * b.told:.1f}->{100 * b.true:.1f} ({b.count})" for b in bands)
        lines.append(
            f"{name:16s} {len(entries):6d} entries{few}, expected calibration error "
            f"{100 * measure_calibration(bands):.1f} points; told->true % (entries): {told}"
        )
    return lines


def list_staircase(rows: Sequence[Row]) -> list[str]:
    """Return how the loop ends: error on unseen runs over the noise, per step and in the end."""
    lines = []
    for purpose in ("one", "pair"):
        mine = [r for r in rows if r.ask.condition == "loop" and r.ask.purpose == purpose]
        mine = [row for row in mine if row.steps]
        if not mine:
            continue
        longest = max(len(row.steps) for row in mine)
        stairs = []
        for place in range(longest):
            errors = [row.steps[min(place, len(row.steps) - 1)].error for row in mine]
            stairs.append(f"{np.median(errors):.2f}")
        last = [row.steps[-1].error for row in mine]
        done = [row for row in mine if row.steps[-1].verdict == "complete"]
        exact = sum({s.added for s in row.steps} - {""} == set(row.ask.hidden) for row in mine)
        every = sum(set(row.ask.hidden) <= {s.added for s in row.steps} for row in mine)
        within = sum(error <= 0.5 for error in last)
        reachable = [row.reachable for row in mine]
        lines += [
            f"{purpose}: {len(mine)} cases, median error over noise by step "
            f"{' -> '.join(stairs)}; in the end median {np.median(last):.2f}, "
            f"90 % {np.quantile(last, 0.9):.2f}, worst {max(last):.2f}; with all that is hidden "
            f"in the model median {np.median(reachable):.2f}, 90 % "
            f"{np.quantile(reachable, 0.9):.2f}, worst {max(reachable):.2f}",
            f"  ends COMPLETE {tell_least(len(done), len(mine))}; error at most 0.5 of the noise "
            f"{tell_least(within, len(mine))}; all hidden added {every}, and nothing else "
            f"{exact}; add refused {tell_most(sum(r.refused_add for r in mine), len(mine))}",
        ]
    return lines


def is_failure(row: Row) -> bool:
    """Return whether a case did not go as it should; of the loop, whether it ends otherwise."""
    if not row.counts:
        return False
    if row.ask.condition == "loop":
        return not row.steps or row.steps[-1].verdict != "complete"
    return not row.right or row.refused_add or bool(row.failed)


def list_failures(rows: Sequence[Row]) -> list[str]:
    """Return every case that did not go as it should, with what draws it again."""
    lines = []
    for row in filter(is_failure, rows):
        ask = row.ask
        said = row.failed or (
            f"{row.verdict.upper()} {row.effect or ''} {'/'.join(row.lookalikes)} "
            f"nearest {row.nearest} floor {row.floor_before:.2f}->{row.floor_after:.2f}"
        )
        if row.refused_add:
            said += f"; ADD REFUSED: {row.reason}"
        if row.truth_errors:
            before, after = row.truth_errors
            done = "keeps it" if row.truth_kept else "does not keep it"
            said += f"; add {ask.hidden[0]} {done}, error {before:.2f} -> {after:.2f}"
        if row.form_error is not None:
            said += f"; best form leaves {row.form_error:.2f}"
        if row.steps:
            said += f"; with all that is hidden {row.reachable:.2f}"
        steps = " -> ".join(f"{s.added or 'base'} {s.error:.2f}" for s in row.steps)
        lines.append(
            f"simulator {ask.simulator} {ask.condition} {ask.purpose} seed {ask.seed} "
            f"{row.sensor} runs {ask.runs} hidden {'+'.join(ask.hidden) or '-'} "
            f"size {ask.size:.2g}: {said}"
            f"{'; ' + steps if steps else ''}"
        )
    return lines
