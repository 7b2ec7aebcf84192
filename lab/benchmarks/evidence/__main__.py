"""Public evidence: the diagnosis under named conditions, its probabilities, and the whole loop.

    python -m benchmarks.evidence conditions [--simulator 1|2|3] [--condition NAME]...
                                             [--purpose one|complete|outside|beside]... [--count N]
                                             [--effect NAME]
    python -m benchmarks.evidence drawn      [--simulator 1|2|3] [--count N]
    python -m benchmarks.evidence loop       [--simulator 1|3] [--count N]
    python -m benchmarks.evidence table      [--simulator 1|2|3] [--version KEY]
    python -m benchmarks.evidence again      [--simulator 1|2|3] --version KEY

`conditions` takes N cases of every condition and purpose in turn; `drawn` draws all factors, for
the calibration curve of the probabilities; `loop` adds what is named until nothing is missing, and
measures the error on unseen runs. Outcomes lie in build/evidence/KEY, KEY being that of the code;
the same command goes on where it stopped, `--minutes` stops it. `again` runs, on the code as it is,
what an earlier version got wrong. All logs are simulated. Rates
stand beside their one-sided 95 % Clopper-Pearson bound.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import islice

from benchmarks import open_pool
from benchmarks.evidence import tables
from benchmarks.evidence.conditions import (
    CONDITIONS,
    PURPOSES,
    Ask,
    draw_asks,
    list_asks,
    list_walks,
)
from benchmarks.evidence.judge import run_case
from benchmarks.evidence.store import HOME, Store, open_store


def list_wanted(options: argparse.Namespace) -> Iterator[Ask]:
    """Give the cases that the command line asks for, the conditions in turn."""
    if options.action == "again":
        rows = open_store(options.version).rows
        mine = [row for row in rows if row.ask.simulator == options.simulator]
        yield from [row.ask for row in mine if row.impossible or tables.is_failure(row)]
    elif options.action == "drawn":
        yield from islice(draw_asks(options.simulator, options.seed), options.count)
    elif options.action == "loop":
        yield from islice(list_walks(options.simulator, options.seed), 2 * options.count)
    else:
        sources = [
            list_asks(options.simulator, name, purpose, options.seed, options.effect)
            for name in options.condition or CONDITIONS
            for purpose in options.purpose or ("one", "complete")
        ]
        for _ in range(options.count):
            yield from (next(source) for source in sources)


def work(asks: Sequence[Ask], store: Store, jobs: int, minutes: float) -> bool:
    """Run what the store lacks; return whether all of it was run."""
    begin = time.monotonic()
    left = [ask for ask in asks if ask not in store]
    with open_pool(jobs) as pool:
        for place in range(0, len(left), jobs):
            if time.monotonic() - begin > 60.0 * minutes:
                return False
            for row in pool.map(run_case, left[place : place + jobs]):
                store.append(row)
            print(f"\r{place + jobs} of {len(left)}", end="", file=sys.stderr, flush=True)
    return True


def print_tables(store: Store, simulator: int) -> None:
    """Print all that the store has of a simulator."""
    rows = [row for row in store.rows if row.ask.simulator == simulator]
    impossible = sum(not row.counts for row in rows)
    drawn = [row for row in rows if row.ask.condition == "drawn"]
    named = [row for row in rows if row.ask.condition in CONDITIONS]
    print(
        f"simulated logs, simulator {simulator}, {len(rows)} cases, code {store.path.parent.name}"
    )
    if impossible:
        print(f"{impossible} that the simulator cannot make, not counted")
    parts = {
        "conditions": tables.list_conditions(rows),
        "probabilities, drawn cases": tables.list_calibration(drawn),
        "probabilities, cases of the conditions": tables.list_calibration(named),
        "loop: RMS of predicted less true drift on unseen runs, over the noise": (
            tables.list_staircase(rows)
        ),
        "not as it should be": tables.list_failures(rows),
    }
    for title, lines in parts.items():
        if lines:
            print("\n".join([f"\n{title}", *lines]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run cases and print the tables; return 1 where time was up before all were run."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.evidence",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("action", choices=("conditions", "drawn", "loop", "table", "again"))
    parser.add_argument("--simulator", type=int, choices=(1, 2, 3), default=3)
    parser.add_argument("--condition", choices=tuple(CONDITIONS), action="append")
    parser.add_argument("--purpose", choices=PURPOSES, action="append")
    parser.add_argument("--effect", default="", metavar="NAME", help="hide this one alone")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=600.0, help="stop after so long")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--version", help="an earlier version of the code")
    options = parser.parse_args(arguments)
    if options.action == "loop" and options.simulator == 2:
        parser.error("simulator 2 tells no true drift; expected --simulator 1 or 3 for the loop")
    if "beside" in (options.purpose or ()) and options.simulator != 3:
        parser.error(
            "beside: no other simulator mixes what is in a catalogue and what is not; use 3"
        )
    if options.version and not (HOME / options.version).is_dir():
        there = sorted(path.name for path in HOME.glob("*"))
        parser.error(f"no outcomes of version {options.version}; there are {there}")
    if options.action == "again" and not options.version:
        parser.error("again needs --version KEY, whose failures it runs")
    store = open_store(options.version if options.action == "table" else None)
    done = True
    if options.action != "table":
        done = work(list(list_wanted(options)), store, options.jobs, options.minutes)
        print(file=sys.stderr)
    print_tables(store, options.simulator)
    if not done:
        print("time is up; the same command goes on from here", file=sys.stderr)
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
