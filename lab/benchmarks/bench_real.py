"""Real records as judges: each fifth of each is predicted from the other four.

    python -m benchmarks.bench_real [--data FOLDER] [--only TEXT] [--jobs N] [--results FILE]
                                    [--short] [--allow-missing]

Simple fits stand beside the model that `diagnose`, `add` and `remove` arrive at (the loop), all
from the four fifths alone. `chosen` is the simple fit that predicts each of the four best from the
other three; `hindsight` is the best one on the fifth itself, which nobody can know. The list of the
records is fixed (real/records.toml, with sources and licences); their data are not part of the
repository and are looked for beside it, in shared/data. A record that is not there is named, and
the exit code is 1 unless --allow-missing. With --results each record is written as a line of JSON
when it is done, and those that stand there already are not run again.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import open_pool
from benchmarks.real.loop import run_loop
from benchmarks.real.records import Entry, list_entries, mark_entry, read_record
from benchmarks.real.simple import (
    SIMPLE,
    choose_simple,
    list_folds,
    measure_error,
    predict_simple,
)
from zerodrift.base.errors import ZerodriftError

DATA = Path(__file__).parents[3] / "shared" / "data"
METHODS = (*SIMPLE, "chosen", "hindsight", "loop")
WORSE = 1.05
"""The loop's error over that of a constant or a line, from which on it does harm."""
Result = dict[str, Any]


def judge(entry: Entry, data: Path) -> Result:
    """Return a record's errors fold by fold, as the line of the results file.

    Args:
        entry: which record.
        data: the folder of data.
    """
    start = time.perf_counter()
    record = read_record(entry, data)
    folds = list_folds(record.drift.size)
    told = []
    for left_out in folds:
        others = [fold for fold in folds if fold is not left_out]
        train = np.any(others, axis=0)
        errors = {k: asdict(v) for k, v in predict_simple(record, train, left_out).items()}
        chosen = choose_simple(record, others)
        one: Result = {"rows": int(left_out.sum()), "chosen": chosen, "errors": errors}
        errors["hindsight"] = {
            by: min(errors[name][by] for name in SIMPLE) for by in ("rms", "scatter")
        }
        errors["chosen"] = errors[chosen]
        try:
            loop = run_loop(record, train, left_out)
        except ZerodriftError as error:
            one["failed"] = str(error)
        else:
            errors["loop"] = asdict(measure_error((record.drift - loop.drift)[left_out]))
            one |= {"effects": loop.effects, "verdicts": loop.verdicts}
        told.append(one)
    return {
        "record": entry.name,
        "mark": mark_entry(entry),
        "unit": record.unit,
        "rows": record.drift.size,
        "hours": record.period_s * float(np.ptp(record.place)) / 3600.0,
        "folds": told,
        "seconds": time.perf_counter() - start,
    }


def pool(result: Result, method: str, by: str = "rms") -> float:
    """Return a method's error over all rows of a record, each predicted once; nan where it failed.

    Args:
        result: of one record.
        method: one of METHODS.
        by: rms or scatter.
    """
    squares = [
        fold["rows"] * fold["errors"].get(method, {by: float("nan")})[by] ** 2
        for fold in result["folds"]
    ]
    return float(np.sqrt(sum(squares) / result["rows"]))


def read_results(path: Path | None, entries: Sequence[Entry]) -> dict[str, Result]:
    """Return what a file of results has of some records.

    Raises:
        SystemExit: the list has changed since.
    """
    kept: dict[str, Result] = {}
    if path is None or not path.exists():
        return kept
    marks = {entry.name: mark_entry(entry) for entry in entries}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        result: Result = json.loads(line)
        name = result["record"]
        if name in marks and result["mark"] != marks[name]:
            raise SystemExit(
                f"{path}:{number}: '{name}' is {result['mark']}; expected {marks[name]}, as the"
                " list has it now. Give --results another file."
            )
        if name in marks:
            kept[name] = result
    return kept


def run_all(entries: Sequence[Entry], data: Path, jobs: int) -> Iterator[Result]:
    """Yield results as they are done, and say on stderr how far it is."""
    start = time.perf_counter()
    with open_pool(jobs) as workers:
        waiting = [workers.submit(judge, entry, data) for entry in entries]
        for number, done in enumerate(as_completed(waiting), 1):
            result = done.result()
            print(
                f"{number} of {len(entries)}: {result['record']}, {result['seconds']:.0f} s; "
                f"{time.perf_counter() - start:.0f} s in all",
                file=sys.stderr,
                flush=True,
            )
            yield result


def write_table(results: Sequence[Result], by: str) -> str:
    """Return each method's error over the constant's, a record a line."""
    lines = [f"{'':34s}{'rows':>5s} {'constant':>14s}" + "".join(f"{m:>12s}" for m in METHODS[1:])]
    for result in results:
        constant = pool(result, "constant", by)
        cells = "".join(f"{pool(result, m, by) / constant:12.3f}" for m in METHODS[1:])
        unit = f"{constant:.4g} {result['unit']}"
        lines.append(f"{result['record']:34s}{result['rows']:5d} {unit:>14s}{cells}")
    return "\n".join(lines)


def summarise(results: Sequence[Result]) -> str:
    """Return the figures over all records, and the folds that failed."""
    lines = []
    for by, words in (("rms", "RMS"), ("scatter", "RMS without each fold's own mean")):

        def take(
            method: str, rows: Sequence[Result] = results, by: str = by
        ) -> np.ndarray[Any, np.dtype[np.float64]]:
            return np.array([pool(result, method, by) for result in rows])

        loop = take("loop")
        there = np.isfinite(loop)
        harm = there & (loop > WORSE * np.minimum(take("constant"), take("line")))
        names = [r["record"] for r, worse in zip(results, harm, strict=True) if worse]
        over = {m: (loop / take(m))[there] for m in ("constant", "chosen", "hindsight")}
        beside = (take("chosen") / take("hindsight"))[there]
        lines += [
            f"{words}, {int(there.sum())} of {len(results)} records:",
            *(f"  loop over {m}: median {np.median(r):.3f}" for m, r in over.items() if r.size),
            f"  chosen over hindsight: median {np.median(beside):.3f}" if beside.size else "",
            f"  loop better than chosen: {int((over['chosen'] < 1.0).sum())}",
            f"  loop worse than constant or line by over 5 %: {len(names)} {names}",
        ]
    for result in results:
        for number, fold in enumerate(result["folds"], 1):
            if "failed" in fold:
                lines.append(f"failed: {result['record']}, fold {number}: {fold['failed']}")
    return "\n".join(line for line in lines if line)


def main(quick: bool) -> int:
    """Run all records, or the short list; a record that is missing is no miss of a mark."""
    return run((*(("--short",) if quick else ()), "--allow-missing"))


def run(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 where a record is missing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_real", description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="the folder of data")
    parser.add_argument("--results", type=Path, help="a file of JSON lines, to be gone on with")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", default="", help="records whose name has this")
    parser.add_argument("--short", action="store_true", help="the short list, for CI")
    parser.add_argument("--allow-missing", action="store_true", help="skip what is not there")
    options = parser.parse_args(arguments)
    wanted = [
        e for e in list_entries() if options.only in e.name and (e.short or not options.short)
    ]
    missing = [entry for entry in wanted if not entry.find(options.data).exists()]
    for entry in missing:
        print(f"missing: {entry.name} ({entry.find(options.data)})")
    kept = read_results(options.results, wanted)
    to_run = [entry for entry in wanted if entry not in missing and entry.name not in kept]
    to_run.sort(key=mark_entry)  # by chance, so that a part of them is a fair sample
    for result in run_all(to_run, options.data, options.jobs):
        kept[result["record"]] = result
        if options.results is not None:
            with options.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")
    results = [kept[entry.name] for entry in wanted if entry.name in kept]
    if results:
        for by, words in (("rms", "RMS"), ("scatter", "RMS without each fold's own mean")):
            print(f"\n{words} on the fifths left out; the constant's, and the others over it")
            print(write_table(results, by))
        print(f"\n{summarise(results)}")
    return int(bool(missing) and not options.allow_missing)


if __name__ == "__main__":
    sys.exit(run())
