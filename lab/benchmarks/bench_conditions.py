"""The diagnosis under the conditions of real logs: few runs, no dwell, outlier rows.

Simulated cases of `bench_hidden`, changed as a condition says: the same seeds make the same cases
under every condition, so that conditions can be compared case by case. Outlier rows are 15 to 60
times the noise off in every output, in the runs and in the dwell.

    python -m benchmarks.bench_conditions CONDITION PURPOSE [--count N] [--seed N] [--size X]
                                           [--minutes M] [--json FILE]
    python -m benchmarks.bench_conditions --table FILE

PURPOSE is one (an effect hidden), complete or outside. Outcomes are appended to the file, and cases
whose outcome it has are not run again, so a long measurement is made in parts. All logs here are
simulated. Rates stand beside their one-sided 95 % Clopper-Pearson bound.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks.hidden.cases import LISTED, OUTSIDE, Case
from benchmarks.hidden.outcomes import Outcome, run_case
from zerodrift.dataset.runs import Dataset, Run


@dataclass(frozen=True)
class Condition:
    """What logs are like."""

    fewest_runs: int
    most_runs: int
    outliers: float = 0.0
    """Share of the rows."""
    has_dwell: bool = True


CONDITIONS = {
    "clean": Condition(6, 12),
    "runs_2": Condition(2, 2),
    "runs_3": Condition(3, 3),
    "runs_4": Condition(4, 4),
    "runs_5": Condition(5, 5),
    "outliers_0.2": Condition(6, 12, 0.002),
    "outliers_2": Condition(6, 12, 0.02),
    "runs_4_outliers": Condition(4, 4, 0.01),
    "no_dwell": Condition(6, 12, has_dwell=False),
    "no_dwell_runs_4": Condition(4, 4, has_dwell=False),
    "no_dwell_outliers": Condition(6, 12, 0.01, has_dwell=False),
    "no_dwell_runs_3": Condition(3, 3, has_dwell=False),
}
PURPOSES = ("one", "complete", "outside")


def list_cases(condition: Condition, purpose: str, seed: int) -> Iterator[Case]:
    """Give cases without end, the effects in turn."""
    rng = np.random.default_rng([seed, PURPOSES.index(purpose)])
    hidden: dict[str, tuple[str, ...]] = {"one": LISTED, "outside": OUTSIDE, "complete": ("",)}
    while True:
        for name in hidden[purpose]:
            draw, case_seed, size = rng.uniform(), int(rng.integers(2**31)), rng.choice([1, 3, 10])
            span = condition.most_runs - condition.fewest_runs + 1
            runs = condition.fewest_runs + int(draw * span)
            if condition.most_runs <= 5:
                size = 3.0
            yield Case(
                purpose,
                (name,) if name else (),
                float(size) if name else 0.0,
                runs,
                case_seed,
            )


def change(dataset: Dataset, condition: Condition, seed: int) -> Dataset:
    """Return the logs as the condition has them."""
    rng = np.random.default_rng(seed)
    if condition.outliers:
        dwell = np.concatenate([run.drift for run in dataset.dwell])
        noise = np.maximum(np.std(dwell, axis=0), 1e-12)

        def spoil(run: Run) -> Run:
            hit = rng.uniform(size=len(run)) < condition.outliers
            size = (int(hit.sum()), noise.size)
            measured = run.measured.copy()
            measured[hit] += rng.choice([-1, 1], size) * rng.uniform(15, 60, size) * noise
            return replace(run, measured=measured)

        dataset = replace(
            dataset,
            train=tuple(spoil(run) for run in dataset.train),
            dwell=tuple(spoil(run) for run in dataset.dwell),
        )
    return dataset if condition.has_dwell else replace(dataset, dwell=())


def measure(name: str, case: Case) -> Outcome:
    """Return what the diagnosis says of a case under a condition."""
    return run_case(case, lambda dataset: change(dataset, CONDITIONS[name], case.seed))


def bound(count: int, cases: int, *, upper: bool) -> float:
    """Return the one-sided 95 % Clopper-Pearson bound of a rate."""
    if upper:
        return 1.0 if count == cases else float(beta.ppf(0.95, count + 1, cases - count))
    return 0.0 if count == 0 else float(beta.ppf(0.05, count, cases - count + 1))


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a file of outcomes."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """Print a line for each condition and purpose."""
    for name in CONDITIONS:
        for purpose in PURPOSES:
            mine = [r for r in rows if r["condition"] == name and r["case"]["purpose"] == purpose]
            mine = [r for r in mine if not r["refused"]]
            if not mine:
                continue
            named = [r for r in mine if r["effect"] is not None]
            line = f"{name:18s} {purpose:9s} {len(mine):4d} cases"
            if purpose == "one":
                truth = [r["case"]["hidden"][0] for r in mine]
                right = sum(
                    t in (r["effect"], *r["lookalikes"]) for r, t in zip(mine, truth, strict=True)
                )
                first = sum(r["effect"] == t for r, t in zip(mine, truth, strict=True))
                wrong = sum(
                    r["effect"] is not None and t not in (r["effect"], *r["lookalikes"])
                    for r, t in zip(mine, truth, strict=True)
                )
                nots = sum(
                    r["verdict"] == "unknown" and r["nearest"] == t
                    for r, t in zip(mine, truth, strict=True)
                )
                line += (
                    f"  right {right} ({100 * right / len(mine):.1f} %, at least "
                    f"{100 * bound(right, len(mine), upper=False):.1f} %), first {first}, "
                    f"wrong {wrong} (at most {100 * bound(wrong, len(mine), upper=True):.1f} %), "
                    f"truth called nearest of UNKNOWN {nots}"
                )
            else:
                count = len(named)
                line += (
                    f"  named {count} ({100 * count / len(mine):.1f} %, at most "
                    f"{100 * bound(count, len(mine), upper=True):.1f} %), "
                    f"complete {sum(r['verdict'] == 'complete' for r in mine)}"
                )
            seconds = float(np.median([r["seconds"] for r in mine]))
            print(f"{line}, median {seconds:.1f} CPU s")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run cases of one condition, or print the table of a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("condition", nargs="?", choices=tuple(CONDITIONS))
    parser.add_argument("purpose", nargs="?", choices=PURPOSES)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after so long")
    parser.add_argument("--json", type=Path, help="append outcomes here, and go on from them")
    parser.add_argument("--table", type=Path, help="print the table of a file of outcomes")
    options = parser.parse_args(arguments)
    if options.table:
        print_table(read_rows(options.table))
        return 0
    if options.condition is None or options.purpose is None:
        parser.error("expected CONDITION and PURPOSE, or --table FILE")
    begin = time.monotonic()
    rows = read_rows(options.json) if options.json else []
    known = {(r["condition"], r["case"]["seed"]) for r in rows}
    cases = list_cases(CONDITIONS[options.condition], options.purpose, options.seed)
    for _, case in zip(range(options.count), cases, strict=False):
        if (options.condition, case.seed) in known:
            continue
        if time.monotonic() - begin > 60.0 * options.minutes:
            print("time is up; the same command goes on from here", file=sys.stderr)
            break
        outcome = measure(options.condition, case)
        rows.append({"condition": options.condition, **asdict(outcome)})
        if options.json:
            with options.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print_table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
