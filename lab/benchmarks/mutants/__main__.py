"""Mutants: `python -m benchmarks.mutants --certificate | --verify [--count N] [--seed S]`.

Changes one thing in the C that ships, asks an oracle what that does (sanitizers, claimed bounds,
every bit on the host's builds and on emulated cores), corrects every hash that speaks of the file,
and gives it to `zerodrift verify --certificate` (mutants that trap or leave a claimed bound) or to
`zerodrift verify` (mutants that change a bit). With --bits the identities in the C are corrected
as well, so that no comparison of texts helps and verify has the bits alone. Prints how many of
them are accepted, by class, with the difference. --count is how many that the judge must not
accept are tried. Results are kept in build/mutants; a run goes on where the last one ended,
--judge-again asks only the judge anew, --accepted-again of those alone that it accepted.

--quick asks the oracle of one build alone, the first that compiles the changed lines, which finds
mutants that must not pass many times faster. Of every fortieth in which it finds nothing the judge
is asked all the same, and of what the judge accepts the oracle of every build. Verify leaves out
what comes after a difference: what it finds later adds to a refusal.

What changes nothing of the golden vectors (drifts, flags, nodes, the self-test's answer) but how a
state lies in memory is told apart from what does.
"""

import argparse
import hashlib
import json
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import count as count_up
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.bench_copies import bound as bound_rate
from benchmarks.mutants.judge import judge_mutant, to_line, try_mutant
from benchmarks.mutants.oracle import Oracle
from benchmarks.mutants.subjects import MODELS, Subject, make_folder, make_project

ROOT = Path(__file__).parents[3] / "build" / "mutants"
BAD = {
    "certificate": ("traps", "leaves a bound"),
    "verify": ("traps", "leaves a bound", "changes a bit"),
}
LOOKED_AT = 40
"""Of so many mutants in which the quick oracle finds nothing, one is given to the judge."""
MOST = 40_000
"""Mutants drawn in one run; a pool reads ahead without an end otherwise."""


@dataclass(frozen=True)
class Task:
    """One mutant to be judged."""

    way: str
    """certificate | verify."""
    subject: str
    seed: int
    number: int
    bits: bool = False
    """Whether identities are corrected."""
    quick: bool = False
    known: str = ""
    """The line of an earlier run of which the judge alone is asked again."""


@cache
def load_subject(way: str, name: str) -> Subject:
    """Return a subject, built if it is not there."""
    folder = ROOT / way / name
    return make_folder(name, folder) if way == "certificate" else make_project(name, folder)


@cache
def load_oracle(way: str, name: str) -> Oracle:
    """Return who judges a subject's mutants, once per process."""
    return load_subject(way, name).make_oracle(kept=ROOT / "unchanged")


def work(task: Task) -> str:
    """Judge one mutant and, where the judge on trial has something to lose, try it."""
    way, seed, number = task.way, task.seed, task.number
    subject = load_subject(way, task.subject)

    def ask() -> tuple[str, str]:
        return try_mutant(subject, seed, number, way, bits=task.bits, quick=task.quick)

    if task.known:
        return json.dumps({**json.loads(task.known), "told": ask()})
    oracle = load_oracle(way, task.subject)
    suffices = way == "verify"
    record = judge_mutant(subject, oracle, seed, number, bit_suffices=suffices, quick=task.quick)
    told = ask() if record.finding.kind in BAD[way] else None
    silent = record.finding.kind != "does not compile" and told is None
    if task.quick and silent and number % LOOKED_AT == 0:
        told = ask()
        if told[0] != "refused":
            record = judge_mutant(subject, oracle, seed, number, bit_suffices=suffices)
    return to_line(record, told)


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
    parser.add_argument("--quick", action="store_true")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--judge-again", action="store_true")
    again.add_argument("--accepted-again", action="store_true")
    parser.add_argument("--only", nargs="*", default=[], metavar="SUBJECT")
    given = parser.parse_args()
    way = "certificate" if given.certificate else "verify"
    names = [n for n in MODELS if not given.only or n in given.only]
    subjects = {name: load_subject(way, name) for name in names}
    state = json.dumps([sorted(s.files.items()) for s in subjects.values()])
    key = hashlib.sha256(state.encode()).hexdigest()[:10]
    kind = f"{'_bits' if given.bits else ''}{'_quick' if given.quick else ''}"
    log = ROOT / f"{way}_{given.seed}_{key}{kind}.jsonl"
    known = read_lines(log)

    def name_task(name: str, number: int, line: str = "") -> Task:
        return Task(way, name, given.seed, number, given.bits, given.quick, line)

    if given.judge_again or given.accepted_again:
        log.rename(log.with_suffix(".before"))
        kept = (None,) if given.judge_again else (None, "refused")
        asked = [line for line in known if (line["told"] or [None])[0] not in kept]
        known = [line for line in known if (line["told"] or [None])[0] in kept]
        log.write_text("".join(json.dumps(line) + "\n" for line in known))
        tasks = (name_task(line["subject"], line["number"], json.dumps(line)) for line in asked)
        known = run(tasks, log, known, len(asked) + 10**9, given.jobs, way)
    else:
        numbers = islice(count_up(len(known)), MOST)
        drawn = (name_task(names[number % len(names)], number) for number in numbers)
        known = run(drawn, log, known, given.count, given.jobs, way)
    sys.exit(tell(known, way))


def read_lines(log: Path) -> list[dict[str, Any]]:
    """Return what an earlier run found."""
    if not log.is_file():
        return []
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def run(
    tasks: Iterable[Task],
    log: Path,
    known: list[dict[str, Any]],
    count: int,
    jobs: int,
    way: str,
) -> list[dict[str, Any]]:
    """Work until so many mutants that must not pass were tried; return all that is known."""
    start = time.perf_counter()
    bad = sum(line["finding"]["kind"] in BAD[way] for line in known)
    if bad >= count:
        return known
    with (
        multiprocessing.get_context("spawn").Pool(jobs) as pool,
        log.open("a", encoding="utf-8") as file,
    ):
        for text in pool.imap(work, tasks):
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


def is_layout(finding: dict[str, Any]) -> bool:
    """Say whether nothing but header, state, saved copy and damaged states is another."""
    phases = set(finding["phase"].split())
    return finding["kind"] == "changes a bit" and not phases & {"step", "node", "selftest"}


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
    lies = [line for line in bad if way == "verify" and is_layout(line["finding"])]
    if lies:
        equal = sum(line["told"][0] == "accepted" for line in lies)
        print(
            f"{len(lies)} of them change how a state lies in memory and nothing of the golden"
            f" vectors: {equal} accepted; not counted below"
        )
        bad = [line for line in bad if line not in lies]
        passed = [line for line in passed if line not in lies]
    accepted = sum(line["told"][0] == "accepted" for line in passed)
    looked = [line for line in known if line["told"] is not None and line not in bad]
    if looked:
        equal = sum(line["told"][0] == "accepted" for line in looked)
        print(
            f"{len(looked)} others, of which nothing is known, given to the judge: {equal} accepted"
        )
    print(
        f"{way}: {accepted} of {len(bad)} accepted, {len(passed) - accepted} without an answer;"
        f" 95 %: {bound_rate(accepted, len(bad)):.2%}"
    )
    return 1 if passed else 0


if __name__ == "__main__":
    main()
