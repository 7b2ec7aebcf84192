"""Random models proven, with the CPU time of each; and faults planted in C and tables, none proven.

    python -m benchmarks bench_proof [--quick]
    python -m benchmarks.bench_proof --models 500 --seed 5
    python -m benchmarks.bench_proof --faults 500 --seed 5

Faults are drawn by `benchmarks.mutants`, which knows nothing of the prover, in the model's own two
files; assembly, which is tested and not proven, is left out. The oracle of `benchmarks.mutants`
(every bit and sanitizers, the layouts of this host) tells which of them compile and change what the
C does: those alone are counted, and drawn until there are so many. Both go in parts: `--first N`
begins at the Nth, and what was found so far is printed every 25 models or draws. Exit code 1: a
random model is not proven, or a fault is.
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.bench_copies import bound as bound_rate
from benchmarks.mutants.judge import Mutant, draw_mutant
from benchmarks.mutants.operators import OPERATORS
from benchmarks.mutants.oracle import Oracle
from benchmarks.mutants.subjects import MODELS, Subject, draw_subject, make_folder
from benchmarks.random_models import draw_case
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift_proof import OPEN, ShownPart, list_shown, read_model

KINDS = tuple(kind for kind in OPERATORS if kind != "assembly")
UNBUILT = "does not compile"
HARMLESS = ("equivalent", UNBUILT)
LIMIT_S = 30.0
TOLD = 25
"""After so many the count so far is printed."""


def main(quick: bool) -> None:
    """Prove 20 random models and plant 40 faults, or 500 of each."""
    good = prove_models(20 if quick else 500, seed=5)
    good = plant(40 if quick else 500, seed=5) and good
    if not good:
        raise SystemExit(1)


def prove_models(count: int, seed: int, first: int = 0) -> bool:
    """Prove random models of every sort; print how many, and the CPU time of each."""
    runtime = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    seconds, failed, slow = [], 0, 0
    sorts: Counter[str] = Counter()
    for number in range(first, first + count):
        case = draw_case(seed, number)
        code = generate(case.model)
        texts = {**runtime, code.header_name: code.header, code.source_name: code.source}
        began = time.process_time()
        shown = tuple(list_shown(read_model(case.model.to_json()), texts))
        seconds.append(time.process_time() - began)
        left = [one for one in shown if one.verdict == OPEN]
        sorts[case.sort] += 1
        slow += seconds[-1] > LIMIT_S
        failed += bool(left)
        if left:
            print(f"case {number} ({case.sort}): {_tell(left)}", flush=True)
        if len(seconds) % TOLD == 0:
            print(f"  cases {first} to {number}: {failed} not proven, {slow} slow", flush=True)
    kinds = ", ".join(f"{n} {sort}" for sort, n in sorted(sorts.items()))
    print(f"random models proven: {count - failed} of {count} ({kinds}; seed {seed});"
          f" not proven at most {100 * bound_rate(failed, count):.2f} %")  # fmt: skip
    middle, most = float(np.median(seconds)), max(seconds)
    print(f"CPU time: median {middle:.1f} s, most {most:.1f} s; above {LIMIT_S:.0f} s: {slow}")
    return failed == 0


def _tell(left: Sequence[ShownPart]) -> str:
    return "; ".join(f"{one.what} ({one.build}): {one.why}" for one in left[:3])


def plant(count: int, seed: int, first: int = 0, only: Sequence[str] = ()) -> bool:
    """Plant faults that compile and change what the C does; print how many are proven all the same.

    Args:
        count: of such faults; as many are drawn as it takes.
        seed: of all that are drawn.
        first: number of the first that is drawn.
        only: names of models; empty for all.
    """
    names = [name for name in MODELS if not only or name in only]
    told: Counter[str] = Counter()
    number, planted, missed = first, 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        subjects = {name: make_folder(name, Path(scratch) / name) for name in names}
        models = {name: draw_subject(name) for name in names}
        oracles = {name: subject.make_oracle(chips=False) for name, subject in subjects.items()}
        while planted < count:
            name = names[number % len(names)]
            mutant = draw_mutant(subjects[name], seed, number, KINDS, model_share=1.0)
            kind, proven = _try(oracles[name], models[name], subjects[name], mutant)
            told[kind] += 1
            planted += kind not in HARMLESS
            if proven and kind not in HARMLESS:
                missed += 1
                diff = _diff(subjects[name], mutant.file, mutant.text)
                print(f"MISSED {name} {number}: {kind}\n{diff}", flush=True)
            number += 1
            if (number - first) % TOLD == 0:
                print(f"  {first} to {number - 1}: {planted} faults, {missed} missed", flush=True)
    print(f"drawn: {number - first} in {len(names)} models (seed {seed}, from {first} on)")
    for kind, n in sorted(told.items()):
        print(f"  {kind}: {n}")
    print(f"faults, which compile and change a bit, leave a bound or trap: {planted}")
    print(f"proven all the same: {missed} of {planted};"
          f" at most {100 * bound_rate(missed, planted):.2f} %")  # fmt: skip
    return missed == 0


def _try(oracle: Oracle, model: IntegerModel, subject: Subject, mutant: Mutant) -> tuple[str, bool]:
    """Return what a mutant does, and whether it is proven.

    One build that shows a change is enough to call it a fault. Of one that is proven and shows
    none there, every build is asked.
    """
    told = mutant.file, mutant.text, mutant.lines
    kind = oracle.judge(*told, bit_suffices=True, quick=True).kind
    if kind == UNBUILT:
        return kind, False
    texts = {**subject.files, mutant.file: mutant.text}
    proven = all(one.verdict != OPEN for one in list_shown(read_model(model.to_json()), texts))
    if proven and kind in HARMLESS:
        kind = oracle.judge(*told, bit_suffices=True).kind
    return kind, proven


def _diff(subject: Subject, name: str, text: str) -> str:
    pairs = zip(subject.files[name].split("\n"), text.split("\n"), strict=False)
    return "\n".join(f"- {a}\n+ {b}" for a, b in pairs if a != b)[:600]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_proof", description=__doc__)
    parser.add_argument("--models", type=int, default=0)
    parser.add_argument("--faults", type=int, default=0)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], metavar="SUBJECT")
    given = parser.parse_args()
    held = not given.models or prove_models(given.models, given.seed, given.first)
    held = (not given.faults or plant(given.faults, given.seed, given.first, given.only)) and held
    raise SystemExit(0 if held else 1)
