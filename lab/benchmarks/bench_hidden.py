"""Hidden effects on simulated logs: how often the diagnosis names what is missing.

Every case is a simulated sensor whose model lacks something: one effect of the catalogue, two of
them, none, one whose channel was not logged, or a disturbance that the catalogue does not know.
The simulator shares no numerical code with the fit. All logs here are simulated.

    python -m benchmarks.bench_hidden [--quick] [--seed N] [--processes 1|2] [--first N]
                                       [--json FILE]

Exit code 1 if a frozen target is missed.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks import open_pool
from benchmarks.hidden.cases import Case, list_cases
from benchmarks.hidden.outcomes import Outcome, read_outcomes, run_case
from benchmarks.hidden.tables import check, list_misses, report


def run_cases(cases: Sequence[Case], processes: int) -> Iterator[Outcome]:
    """Give the outcomes in order, one after the other."""
    if processes == 1:
        yield from map(run_case, cases)
        return
    with open_pool(processes) as pool:
        yield from pool.map(run_case, cases, chunksize=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and print the tables; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few dozen cases")
    parser.add_argument("--seed", type=int, default=1, help="draws all cases")
    parser.add_argument("--processes", type=int, default=1, choices=(1, 2))
    parser.add_argument("--only", default="", help="only cases whose purpose or effect has this")
    parser.add_argument("--first", type=int, help="only so many of the cases")
    parser.add_argument("--json", type=Path, help="append every outcome to this file, one a line")
    parser.add_argument(
        "--go-on", action="store_true", help="leave out the cases whose outcome the file has"
    )
    options = parser.parse_args(arguments)
    cases = [
        case
        for case in list_cases(options.seed, options.quick)
        if options.only in (case.purpose, *case.hidden, "")
    ][: options.first]
    print(f"{len(cases)} simulated cases, seed {options.seed}", flush=True)
    outcomes = read_outcomes(options.json) if options.go_on else []
    known = {outcome.case for outcome in outcomes}
    outcomes = [outcome for outcome in outcomes if outcome.case in set(cases)]
    for outcome in run_cases([case for case in cases if case not in known], options.processes):
        outcomes.append(outcome)
        print(f"\r{len(outcomes)} done", end="", file=sys.stderr, flush=True)
        if options.json:
            with options.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    print(file=sys.stderr)
    figures = report(outcomes)
    list_misses(outcomes)
    if options.only:
        return 0
    return 0 if check(figures) else 1


if __name__ == "__main__":
    sys.exit(main())
