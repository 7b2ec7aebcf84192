"""Changes of meaning that C's lexical grammar hides: accepted by the certificate, by the proof.

    python -m benchmarks.bench_lexical --count 300 --seed 1 [--first N]

Tricks of `benchmarks.mutants.lexical` are played in a model's own two files, hashes and identities
made to agree with them. Only those count that change what a compiler makes of the text: bits, a
trap of a sanitizer, or what the header says, on this host (gnu99; c99 with trigraphs; optimized;
without assertions) or on an emulated Cortex-M4. Exit code 1: one is accepted.
"""

import argparse
import difflib
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.bench_copies import bound as bound_rate
from benchmarks.mutants.judge import ask_certificate, identify_files, replace_file
from benchmarks.mutants.lexical import draw_lexical
from benchmarks.mutants.oracle import CHIP_BUILDS, Build, Oracle
from benchmarks.mutants.subjects import MODELS, Subject, draw_subject, make_folder
from zerodrift.export.integer_model import IntegerModel
from zerodrift_proof import OPEN, list_shown, read_model

BUILDS = (
    Build("gnu99"),
    Build("c99", ("-std=c99", "-trigraphs")),
    Build("optimized", ("-O1", "-DNDEBUG")),
    *(build for build in CHIP_BUILDS if build.name == "m4"),
)
TOLD = 25
"""After so many the count so far is printed."""


def changes_meaning(oracle: Oracle, name: str, text: str) -> str:
    """Return what a build makes of a changed file: changes a bit, traps; nothing if no build does.

    Args:
        oracle: of the unchanged files.
        name: of the changed file.
        text: its text.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for file, content in {**oracle.files, name: text, "judge.c": oracle.driver}.items():
            (folder / file).write_text(content, encoding="utf-8")
        for build in BUILDS:
            base = oracle.find_base(build)
            verdict = build.judge(folder, quick=True)
            if verdict.kind in ("traps", "leaves"):
                return f"{verdict.kind} ({build.name})"
            if verdict.kind == "ran" and verdict.hashes != base.verdict.hashes:
                return f"changes a bit ({build.name})"
    return ""


def ask_certificate_of(subject: Subject, texts: dict[str, str]) -> tuple[str, str]:
    """Return what the certificate's checker says of a folder with these texts, hashes agreeing."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "firmware"
        shutil.copytree(subject.folder, folder)
        for name, text in texts.items():
            if text != subject.files[name]:
                replace_file(folder / name, text.encode(), [folder])
        return ask_certificate(folder)


def ask_proof_of(model: IntegerModel, texts: dict[str, str]) -> tuple[str, str]:
    """Return accepted or refused, and why, by the proof."""
    for one in list_shown(read_model(model.to_json()), texts):
        if one.verdict == OPEN:
            return "refused", one.why
    return "accepted", ""


def run(count: int, seed: int, first: int = 0) -> bool:
    """Play tricks until so many changed the meaning; print who accepted what."""
    began = time.process_time()
    told: Counter[str] = Counter()
    tricks: Counter[str] = Counter()
    missed = {"certificate": 0, "proof": 0}
    with tempfile.TemporaryDirectory() as scratch:
        subjects = {name: make_folder(name, Path(scratch) / name) for name in MODELS}
        models = {name: draw_subject(name) for name in MODELS}
        oracles = {name: subject.make_oracle(chips=False) for name, subject in subjects.items()}
        number, changed = first, 0
        while changed < count:
            name = MODELS[number % len(MODELS)]
            subject = subjects[name]
            trick, file, text = draw_lexical(subject.files, subject.prefix, seed, number)
            number += 1
            what = changes_meaning(oracles[name], file, text)
            told[what.split(" (")[0] or "means the same, or does not compile"] += 1
            if not what:
                continue
            changed += 1
            tricks[trick] += 1
            texts = {**subject.files, file: text}
            try:
                texts = identify_files(texts, subject.prefix)
            except Exception as error:  # noqa: BLE001 - a text that cannot be identified keeps its own
                told[f"identities left as they were ({type(error).__name__})"] += 1
            for judge, (answer, _why) in (
                ("certificate", ask_certificate_of(subject, texts)),
                ("proof", ask_proof_of(models[name], texts)),
            ):
                told[f"{judge}: {answer}"] += 1
                if answer != "refused":
                    missed[judge] += 1
                    print(f"{answer.upper()} by {judge}: {name} {number - 1}: {trick}: {what}\n"
                          f"{_show(subject.files[file], text)}", flush=True)  # fmt: skip
            if changed % TOLD == 0:
                print(f"  {changed} of {number - first} drawn: {missed}", flush=True)
    print(f"changes of meaning: {count} of {number - first} drawn (seed {seed}, from {first};"
          f" builds {', '.join(build.name for build in BUILDS)})")  # fmt: skip
    for what, n in sorted((*told.items(), *((f"trick: {k}", n) for k, n in tricks.items()))):
        print(f"  {what}: {n}")
    for judge, n in missed.items():
        print(
            f"accepted by the {judge}: {n} of {count}; at most {100 * bound_rate(n, count):.2f} %"
        )
    print(f"CPU time: {time.process_time() - began:.0f} s, compilers apart")
    return not any(missed.values())


def _show(before: str, after: str) -> str:
    lines = difflib.unified_diff(before.split("\n"), after.split("\n"), lineterm="", n=0)
    return "\n".join(list(lines)[2:12])


def main(quick: bool) -> None:
    """Play 30 tricks, or 300."""
    if not run(30 if quick else 300, seed=1):
        raise SystemExit(1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_lexical", description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    raise SystemExit(0 if run(given.count, given.seed, given.first) else 1)
