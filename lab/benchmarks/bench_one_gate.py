"""One gate, seen from outside: wrong data, leaks, clean sets and real files through the commands.

    python -m benchmarks.bench_one_gate wrong|leaks|clean|files|monitor [--seeds N] [--first SEED]
                                        [--only KIND] [--jobs N] [--results FILE] [--fresh]

`wrong`: 26 kinds of wrong data in one training run of five, 5 seeds each; `leaks`: a test run that
is a training run; `clean`: 100 clean sets of each of three simulators; `files`: real logs beside
the repository, labelled before anything was run; `monitor`: changes within a gap of weeks, and
swapped units. What was found is kept in a file, from which the same command goes on; `--fresh`
begins anew, as is needed after a change of the code that is judged. All sensors but those of
`files` are simulated. Nothing is read but exit codes and JSON.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("POLARS_MAX_THREADS", "1")

from benchmarks.one_gate import (
    clean,
    draw,
    faults,
    in_use,
    leaks,
    real_files,
    results,
    watched,
    wrong,
)

PARTS = {
    "wrong": (wrong, tuple(faults.KINDS), wrong.SEEDS),
    "leaks": (leaks, leaks.KINDS, leaks.SEEDS),
    "clean": (clean, draw.SIMULATORS, clean.COUNT),
    "monitor": (watched, in_use.KINDS, in_use.SEEDS),
    "files": (real_files, tuple(project.name for project in real_files.PROJECTS), 1),
}
"""Part -> its module, its kinds of case, and the seeds of each."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Work off a part's cases and print what became of them."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.bench_one_gate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("part", choices=tuple(PARTS))
    parser.add_argument("--seeds", type=int, help="cases of each kind")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default="", help="only kinds whose name has this")
    parser.add_argument("--jobs", type=int, default=1, help="processes; 0 = this one")
    parser.add_argument("--results", type=Path, help="default: build/one_gate/PART.jsonl")
    parser.add_argument("--fresh", action="store_true", help="forget what the file has")
    options = parser.parse_args(arguments)
    module, kinds, seeds = PARTS[options.part]
    if options.part == "files" and not real_files.DATA.is_dir():
        print(f"{real_files.DATA}: the measurements are not at hand; nothing was run")
        return 2
    kept = options.results or Path("build/one_gate") / f"{options.part}.jsonl"
    if options.fresh:
        kept.unlink(missing_ok=True)
    cases = [
        (kind, seed)
        for seed in range(options.first, options.first + (options.seeds or seeds))
        for kind in kinds
        if options.only in kind
    ]
    if not cases:
        parser.error(f"--only {options.only}: no such kind; there are {', '.join(kinds)}")
    module.tell(results.examine_all(module.examine, cases, kept, options.jobs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
