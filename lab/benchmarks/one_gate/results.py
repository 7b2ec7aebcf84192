"""Cases worked off by several processes, kept in a file from which the same command goes on."""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.bench_conditions import bound

Row = dict[str, Any]
RENEWED = 25
"""Cases after which a process is renewed: a command is made to run once in a process, and keeps
some 10 MB of what it read."""
Examine = Callable[[str, int], Row]
"""Kind and seed of a case -> what became of it."""


def examine_all(
    examine: Examine, cases: Sequence[tuple[str, int]], kept: Path, jobs: int
) -> list[Row]:
    """Return what became of every case; those that `kept` has are not run again.

    Args:
        examine: a function of a module.
        cases: kind and seed of each.
        kept: file of one row a line, appended to.
        jobs: processes; 0 = this one.
    """
    kept.parent.mkdir(parents=True, exist_ok=True)
    rows = {(row["kind"], row["seed"]): row for row in read_rows(kept)}
    todo = [case for case in cases if case not in rows]
    with kept.open("a", encoding="utf-8") as file:
        for row in _work(partial(_time, examine), todo, jobs):
            rows[row["kind"], row["seed"]] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(
                f"\r{sum(case in rows for case in cases)} of {len(cases)}", end="", file=sys.stderr
            )
    print(file=sys.stderr)
    return [rows[case] for case in cases]


def read_rows(kept: Path) -> list[Row]:
    """Return the rows of a file; none where there is no file."""
    if not kept.exists():
        return []
    return [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]


def _work(
    examine: Callable[[tuple[str, int]], Row], cases: Sequence[tuple[str, int]], jobs: int
) -> Iterator[Row]:
    if not jobs:
        yield from map(examine, cases)
        return
    spawn = get_context("spawn")
    # not concurrent.futures: Python 3.11 waits for ever where it renews its only process
    with spawn.Pool(jobs, maxtasksperchild=RENEWED) as pool:
        yield from pool.imap(examine, cases)


def _time(examine: Examine, case: tuple[str, int]) -> Row:
    begin = time.process_time()
    found = examine(*case)
    return {"kind": case[0], "seed": case[1], **found, "cpu_s": time.process_time() - begin}


@contextmanager
def scratch() -> Iterator[Path]:
    """Give a folder that goes away again."""
    with tempfile.TemporaryDirectory(prefix="one_gate_") as folder:
        yield Path(folder)


def tell_rate(found: int, count: int, *, upper: bool) -> str:
    """Return "found of count (rate, bound)"; the bound is Clopper and Pearson's, one-sided 95 %."""
    if not count:
        return "no case"
    side = "at most" if upper else "at least"
    edge = 100.0 * bound(found, count, upper=upper)
    return f"{found} of {count} ({100.0 * found / count:.1f} %, {side} {edge:.1f} %)"
