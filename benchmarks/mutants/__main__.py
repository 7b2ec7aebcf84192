"""Mutants: `python -m benchmarks.mutants --certificate | --verify [--count N] [--seed S]`.

Changes one thing in the C that ships, asks an oracle what that does (sanitizers, claimed bounds,
every bit on the host's builds and on emulated cores), corrects every hash that speaks of the file,
and gives it to `zerodrift verify --certificate` (mutants that trap or leave a claimed bound) or to
`zerodrift verify` (mutants that change a bit). With --bits the identities in the C are corrected
as well, so that no comparison of texts helps and verify has the bits alone. Prints how many of
them are accepted, by class, with the difference. --count is how many that the judge must not
accept are tried. Results are kept in build/mutants; a run goes on where the last one ended,
--judge-again asks only the judge anew.

--judge-first asks the judge before the oracle, and the oracle only of what the judge accepts, which
finds holes several times faster. --count is then how many are drawn, whatever they do.
"""

import argparse
import hashlib
import json
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.bench_copies import bound as bound_rate
from benchmarks.mutants.judge import judge_mutant, name_mutant, to_line, try_mutant
from benchmarks.mutants.oracle import Oracle
from benchmarks.mutants.subjects import MODELS, PROJECTS, Subject, make_model, make_project

ROOT = Path(__file__).parents[2] / "build" / "mutants"
BAD = {
    "certificate": ("traps", "leaves a bound"),
    "verify": ("traps", "leaves a bound", "changes a bit"),
}

JUDGE_FIRST = "judge first"


@cache
def load_subject(way: str, name: str) -> Subject:
    """Return a subject, built if it is not there."""
    folder = ROOT / way / name
    return make_model(name, folder) if way == "certificate" else make_project(name, folder)


@cache
def load_oracle(way: str, name: str) -> Oracle:
    """Return who judges a subject's mutants, once per process."""
    return load_subject(way, name).make_oracle(kept=ROOT / "unchanged")


def work(task: tuple[str, str, int, int, str | None, bool]) -> str:
    """Judge one mutant and, where the judge on trial has something to lose, try it."""
    way, name, seed, number, known, bits = task
    subject = load_subject(way, name)
    if known == JUDGE_FIRST:
        told = try_mutant(subject, seed, number, way, bits=bits)
        if told[0] == "refused":
            return to_line(name_mutant(subject, seed, number), told)
        oracle = load_oracle(way, name)
        record = judge_mutant(subject, oracle, seed, number, bit_suffices=way == "verify")
        return to_line(record, told)
    if known is None:
        oracle = load_oracle(way, name)
        record = judge_mutant(subject, oracle, seed, number, bit_suffices=way == "verify")
        bad = record.finding.kind in BAD[way]
        told = try_mutant(subject, seed, number, way, bits=bits) if bad else None
        return to_line(record, told)
    line = json.loads(known)
    line["told"] = try_mutant(subject, seed, number, way, bits=bits)
    return json.dumps(line)


def main() -> None:
    """Run, print, and end with 1 if a bad mutant was accepted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--certificate", action="store_true")
    group.add_argument("--verify", action="store_true")
    parser.add_argument("--count", type=int, default=1000, help="mutants that must not pass")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--bits", action="store_true", help="with --verify: identities corrected")
    order = parser.add_mutually_exclusive_group()
    order.add_argument("--judge-again", action="store_true")
    order.add_argument("--judge-first", action="store_true")
    parser.add_argument("--only", nargs="*", default=[], metavar="SUBJECT")
    given = parser.parse_args()
    way = "certificate" if given.certificate else "verify"
    names = [
        n for n in (MODELS if given.certificate else PROJECTS) if not given.only or n in given.only
    ]
    subjects = {name: load_subject(way, name) for name in names}
    state = json.dumps([sorted(s.files.items()) for s in subjects.values()])
    key = hashlib.sha256(state.encode()).hexdigest()[:10]
    kind = f"{'_bits' if given.bits else ''}{'_first' if given.judge_first else ''}"
    log = ROOT / f"{way}_{given.seed}_{key}{kind}.jsonl"
    known = read_lines(log)
    if given.judge_again:
        log.rename(log.with_suffix(".before"))
        lines = known
        known = [line for line in lines if line["finding"]["kind"] not in BAD[way]]
        log.write_text("".join(json.dumps(line) + "\n" for line in known))
        tasks = [
            (way, line["subject"], given.seed, line["number"], json.dumps(line), given.bits)
            for line in lines
            if line["finding"]["kind"] in BAD[way]
        ]
        known = run(tasks, log, known, len(tasks) + 10**9, given.jobs, way)
    elif given.judge_first:
        drawn = (
            (way, names[number % len(names)], given.seed, number, JUDGE_FIRST, given.bits)
            for number in range(len(known), given.count)
        )
        known = run(drawn, log, known, 10**9, given.jobs, way)
    else:
        first = len(known)
        tasks_left = (
            (way, names[number % len(names)], given.seed, number, None, given.bits)
            for number in range(10**7)
            if number >= first
        )
        known = run(tasks_left, log, known, given.count, given.jobs, way)
    sys.exit(tell(known, way))


def read_lines(log: Path) -> list[dict[str, Any]]:
    """Return what an earlier run found."""
    if not log.is_file():
        return []
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def run(
    tasks: Any, log: Path, known: list[dict[str, Any]], count: int, jobs: int, way: str
) -> list[dict[str, Any]]:
    """Work until so many mutants that must not pass were tried; return all that is known."""
    start = time.perf_counter()
    bad = sum(line["finding"]["kind"] in BAD[way] for line in known)
    if bad >= count:
        return known
    with multiprocessing.Pool(jobs) as pool, log.open("a", encoding="utf-8") as file:
        for text in pool.imap(work, limit(tasks)):
            line = json.loads(text)
            known.append(line)
            print(text, file=file, flush=True)
            if line["finding"]["kind"] in BAD[way]:
                bad += 1
                if line["told"][0] != "refused":
                    tell_one(line)
            if len(known) % 50 == 0:
                seconds = time.perf_counter() - start
                print(f"  {len(known)} drawn, {bad} to be refused, {seconds:.0f} s", flush=True)
            if bad >= count:
                pool.terminate()
                break
    return known


def limit(tasks: Any) -> Iterator[Any]:
    """Yield the tasks; a pool reads ahead without an end otherwise."""
    for number, task in enumerate(tasks):
        if number >= 20_000:
            return
        yield task


def tell_one(line: dict[str, Any]) -> None:
    """Print one mutant that was not refused."""
    finding = line["finding"]
    print(
        f"{line['told'][0].upper()} {line['subject']} {line['number']} [{line['kind']}]"
        f" {line['file']}:{line['line']}: {finding['kind']} as {finding['build']}"
        f" {finding['phase']} {finding['detail']}\n    "
        + line["diff"][:600].replace("\n", "\n    ")
        + (f"\n    said: {line['told'][1]}" if line["told"][1] else ""),
        flush=True,
    )


def tell(known: list[dict[str, Any]], way: str) -> int:
    """Print the table by class; return 1 if anything was not refused."""
    kinds = Counter(line["finding"]["kind"] for line in known)
    print(f"{len(known)} mutants: " + ", ".join(f"{n} {kind}" for kind, n in kinds.most_common()))
    bad = [line for line in known if line["finding"]["kind"] in BAD[way]]
    passed = [line for line in bad if line["told"][0] != "refused"]
    print(f"{'class':16} {'tried':>6} {'accepted':>9} {'hangs':>6} {'crashes':>8}")
    for kind, tried in sorted(Counter(line["kind"] for line in bad).items()):
        told = Counter(line["told"][0] for line in passed if line["kind"] == kind)
        print(f"{kind:16} {tried:6} {told['accepted']:9} {told['hangs']:6} {told['crashes']:8}")
    accepted = sum(line["told"][0] == "accepted" for line in passed)
    if (refused := kinds["not asked"]) > 0:
        share = bound_rate(accepted, len(known))
        print(f"{refused} refused before the oracle was asked, {len(known) - refused} accepted")
        print(f"{way}: {accepted} of {len(known)} drawn do so and are accepted; 95 %: {share:.2%}")
        return 1 if passed else 0
    print(
        f"{way}: {accepted} of {len(bad)} accepted, {len(passed) - accepted} without an answer;"
        f" 95 %: {bound_rate(accepted, len(bad)):.2%}"
    )
    return 1 if passed else 0


if __name__ == "__main__":
    main()
