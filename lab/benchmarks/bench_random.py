"""Random models on the reference, in onnxruntime and as host C; their certificates against all that
was seen; how tight the bounds are.

    python -m benchmarks bench_random [--quick]
    python -m benchmarks.bench_random --count 2000 --seed 1 --journal build/random.jsonl

A case is drawn from its number alone, so `--first 1234 --count 1` repeats one. With a journal a run
that was stopped goes on where it was. Host C is compiled many models at a time, with other options
and macros for each batch; a batch that crashes is repeated one case at a time. Exit code 1 if any
bit differs, any bound was exceeded, any certificate refused, or any process crashed.
"""

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from tests.certificate.test_check import list_texts
from tests.fixed_point.accumulators import Record, drop_missing, prove_values, recompute, record

from benchmarks.many_hosts import HOW, ManyHosts
from benchmarks.random_models import Case, draw_case
from benchmarks.tightness import Tightness
from zerodrift.base.arrays import IntArray
from zerodrift.verify.certificate import certify
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift_proof import compare as check_certificate

FULL, QUICK, BATCH = 2000, 20, 20
EVERY = 5
"""Of so many cases, one has its certificate derived again from its C, which takes as long as the
rest."""
BACKENDS = ("onnxruntime", "host C")
Result = dict[str, Any]


def main(quick: bool) -> None:
    """Compare 2,000 random models, or 20."""
    with tempfile.TemporaryDirectory() as scratch:
        journal = Path(scratch) / "journal.jsonl"
        if not compare(QUICK if quick else FULL, 1, journal):
            raise SystemExit(1)


def compare(count: int, seed: int, journal: Path, *, first: int = 0) -> bool:
    """Run what the journal does not have yet, print what it says, and tell whether all is well.

    Args:
        count: cases.
        seed: of all cases.
        journal: a line of JSON for each case.
        first: number of the first case.
    """
    wanted = range(first, first + count)
    done = read_journal(journal, seed)
    missing = [number for number in wanted if number not in done]
    began = time.perf_counter()
    for at in range(0, len(missing), BATCH):
        batch = missing[at : at + BATCH]
        run_apart(seed, batch, journal)
        if sys.stderr.isatty() or at % (5 * BATCH) == 0:
            seconds = (time.perf_counter() - began) / (at + len(batch))
            print(f"\r{at + len(batch)} of {len(missing)} cases, {seconds:.2f} s each", end="",
                  file=sys.stderr, flush=True)  # fmt: skip
    print(file=sys.stderr)
    done = read_journal(journal, seed)
    return report([done[number] for number in wanted], seed)


def read_journal(journal: Path, seed: int) -> dict[int, Result]:
    """Return the results of a seed by their case's number; a line cut short does not count."""
    found: dict[int, Result] = {}
    for line in journal.read_text().splitlines() if journal.exists() else []:
        try:
            result = json.loads(line)
        except json.JSONDecodeError:
            continue
        if result["seed"] == seed:
            found[result["case"]] = result
    return found


def run_apart(seed: int, batch: list[int], journal: Path) -> None:
    """Run a batch in a process of its own; where it dies, its cases one by one."""
    process = multiprocessing.get_context("fork").Process(
        target=run_batch, args=(seed, batch, journal)
    )
    process.start()
    try:
        process.join()
    except KeyboardInterrupt:
        process.terminate()
        raise
    if process.exitcode == 0:
        return
    left = [number for number in batch if number not in read_journal(journal, seed)]
    if len(batch) > 1:
        for number in left:
            run_apart(seed, [number], journal)
        return
    crash = {"seed": seed, "case": batch[0], "crash": process.exitcode}
    with journal.open("a") as file:
        file.write(json.dumps(crash) + "\n")


def run_batch(seed: int, batch: list[int], journal: Path) -> None:
    """Compare some cases and add their results to the journal."""
    cases = [draw_case(seed, number) for number in batch]
    how = HOW[batch[0] // BATCH % len(HOW)]
    with tempfile.TemporaryDirectory() as scratch:
        hosts = ManyHosts([case.model for case in cases], Path(scratch), how)
        for i, case in enumerate(cases):
            result = {"seed": seed, **run_case(case, hosts, i), "compiled": " ".join(how)}
            with journal.open("a") as file:
                file.write(json.dumps(result) + "\n")


def run_case(case: Case, hosts: ManyHosts, index: int) -> Result:
    """Return what all back ends and the certificate have to say of one case."""
    model = case.model
    seen = record(model, case.codes, settled=case.settled)
    expected = join_reference(case, seen)
    found = {
        "onnxruntime": run_onnx(case),
        "host C": hosts.run(index, case.codes, case.settled, expected.shape[-1]),
    }
    code = hosts.codes[index]
    claims = json.loads(certify(model, code))
    tightness, beyond = hold_against(claims, case, seen)
    checked = case.number % EVERY == 0
    failures = list(check_certificate(claims, list_texts(code)).failures) if checked else []
    return {
        "case": case.number,
        "sort": case.sort,
        "kinds": sorted({node.kind for node in model.nodes}),
        "values": expected.size,
        "differ": {name: int((rows != expected).sum()) for name, rows in found.items()},
        "selftest": hosts.selftest(index),
        "claims": len(claims["bounds"]),
        "beyond": beyond,
        "checked": checked,
        "failures": failures,
        "refused": case.refused,
        "tightness": tightness.to_json(),
    }


def hold_against(claims: dict[str, Any], case: Case, seen: Record) -> tuple[Tightness, list[str]]:
    """Return observed / claimed of every bound that was watched, and what went beyond its bound."""
    seen = drop_missing(seen)
    bounds = {c["where"]: (c["low"], c["high"]) for c in claims["bounds"]}
    kinds = {node.name: node.kind for node in case.model.nodes}
    reach: dict[str, tuple[int, int]] = {}
    for where, values in recompute(case.model, seen):
        low, high = reach.get(where, (0, 0))
        reach[where] = min(low, int(values.min())), max(high, int(values.max()))
    tightness, beyond = Tightness(), []
    for where, (low, high) in reach.items():
        if where not in bounds:  # a delay by whole samples mixes no two of them
            continue
        claimed = bounds[where]
        zero_in = min(claimed[0], 0), max(claimed[1], 0)  # `reach` begins at 0
        if low < zero_in[0] or high > zero_in[1]:
            beyond.append(f"{where}: {low} .. {high}, claimed {claimed[0]} .. {claimed[1]}")
        largest = max(map(abs, claimed))
        if largest:
            tightness.add(kinds, where, max(abs(low), abs(high)) / largest)
    for name, intervals in prove_values(case.model).items():
        rows = seen.values[name].reshape(len(seen.values[name]), -1)
        for column, interval in zip(rows.T, intervals, strict=True):
            if column.min() < interval.low or column.max() > interval.high:
                beyond.append(f"{name}: outside {interval}")
    return tightness, beyond


def join_reference(case: Case, seen: Record) -> IntArray:
    """Return all values [B, N] of the reference: drifts, flags, every node, the state after."""
    batch, steps, _ = case.codes.shape
    nodes = [seen.values[node.name].reshape(steps, batch, -1) for node in case.model.nodes]
    whole = np.concatenate(nodes, axis=2).swapaxes(0, 1)
    return join(seen.drift, seen.flags, whole, seen.end.pack())


def run_onnx(case: Case) -> IntArray:
    """Return the same values of onnxruntime."""
    trace = OnnxModel(case.model).run(case.codes, settled=case.settled)
    return join(trace.drift, trace.flags, trace.nodes, trace.state)


def join(*parts: Any) -> IntArray:
    """Return arrays [B, ...] side by side."""
    return np.concatenate([p.reshape(len(p), -1).astype(np.int64) for p in parts], axis=1)


def report(results: list[Result], seed: int) -> bool:
    """Print the whole and every case that is not well; return whether there is none."""
    crashed = [r for r in results if "crash" in r]
    whole = [r for r in results if "crash" not in r]
    for result in crashed:
        print(f"case {result['case']} of seed {seed}: crashed ({result['crash']})")
    values = sum(r["values"] for r in whole)
    kinds = sorted({kind for r in whole for kind in r["kinds"]})
    sorts = ", ".join(
        f"{n} of {sort}" for sort, n in sorted(Counter(r["sort"] for r in whole).items())
    )
    print(f"{len(results)} random models ({sorts}), {values} values: drift, flags, every node at"
          " every step and the whole state at the end")  # fmt: skip
    print(f"kinds of nodes: {', '.join(kinds)}")
    bad = len(crashed)
    for result in whole:
        for name, wrong in result["differ"].items():
            if wrong:
                print(f"case {result['case']}: {name} differs in {wrong} values"
                      f" ({result['compiled']})")  # fmt: skip
        for text in (*result["beyond"], *result["failures"]):
            print(f"case {result['case']}: {text}")
        if result["selftest"]:
            print(f"case {result['case']}: self-test says {result['selftest']}")
        wrong = any(result["differ"].values()) or result["beyond"] or result["failures"]
        bad += bool(wrong or result["selftest"])
    for name in BACKENDS:
        print(
            f"{name} against the reference: {sum(r['differ'][name] for r in whole)} values differ"
        )
    claims = sum(r["claims"] for r in whole)
    checked = sum(r["checked"] for r in whole)
    print(f"{claims} bounds claimed, {sum(len(r['beyond']) for r in whole)} contradicted by an"
          f" observed value; {checked} certificates derived again from the C,"
          f" {sum(bool(r['failures']) for r in whole)} refused")  # fmt: skip
    print(f"{sum(r['refused'] for r in whole)} further models were refused by the quantizer")
    tightness = Tightness()
    for result in whole:
        tightness.merge(result["tightness"])
    print("observed / bound:")
    print(tightness.table())
    return bad == 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=FULL, help="cases (default %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--seed", type=int, default=1, help="of all cases (default %(default)s)")
    parser.add_argument("--journal", type=Path, help="file of the results, to stop and go on")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        journal = given.journal or Path(scratch) / "journal.jsonl"
        journal.parent.mkdir(parents=True, exist_ok=True)
        well = compare(given.count, given.seed, journal, first=given.first)
    raise SystemExit(0 if well else 1)
