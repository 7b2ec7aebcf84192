"""Fuzzes what reads or computes: `python -m tests.fuzz [--seconds S] [--scratch] [TARGET ...]`.

step, state, restore: the generated C, with the whole and the small table, under libFuzzer with the
address and undefined-behaviour sanitizers (needs clang). model, onnx, config, csv: the readers of
a user's files under atheris. Each target gets S seconds of processor time, shared out over its
models. What a fuzzer finds interesting is kept in tests/fuzz/corpus.tar.xz, as small as its
coverage allows, or with --scratch in build/fuzz alone. Exit codes: 0 no finding, 1 a finding, 2 a
fuzzer is missing.
"""

import argparse
import importlib.util
import itertools
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz import build, loaders
from tests.fuzz.corpus import read_corpus, unpack, write_corpus

from zerodrift.c_runtime.compilers import Compiler
from zerodrift.export.model_files import load_model

ROOT = Path(__file__).parents[2]
SCRATCH = ROOT / "build" / "fuzz"
LONGEST_INPUT = {"model": 16_000, "onnx": 8_000, "config": 4_000, "csv": 2_000}
Command = list[str | Path]


def list_jobs(target: str, clang: Compiler | None) -> Iterator[tuple[str, Command, list[bytes]]]:
    """Yield the name, the command and the seeds of all that is fuzzed for a target."""
    if target in build.TARGETS and clang is not None:
        for name, (table, macros) in itertools.product(build.MODELS, build.TABLES.items()):
            if table and target == "restore":  # reads no table
                continue
            job = f"{target}_{name}{table}"
            model = load_model(build.GOLDEN / f"{name}.model.json")
            flags = (f"-fsanitize=fuzzer,{build.SANITIZERS}", *macros)
            program = build.build(model, target, clang, SCRATCH / job, flags)
            yield job, [program, "-max_len=600"], []
    elif target in loaders.TARGETS:
        limit = f"-max_len={LONGEST_INPUT[target]}"
        command: Command = [sys.executable, "-m", "tests.fuzz.under_atheris", target]
        yield f"loader_{target}", [*command, limit, "-timeout=60"], loaders.list_seeds(target)


def fuzz(name: str, command: Command, corpus: Path, seconds: float) -> tuple[float, int, str]:
    """Run a target until it has used its processor time or found something.

    Args:
        name: of the folder under build/fuzz where findings are written.
        command: libFuzzer's program and options.
        corpus: read, and grown.
        seconds: of processor time.

    Returns:
        Seconds of processor time used, executions, and what it said of a finding, "" for none.
    """
    folder = SCRATCH / name
    folder.mkdir(parents=True, exist_ok=True)
    start, used, runs = _child_seconds(), 0.0, 0
    while used < seconds:  # libFuzzer itself stops by the wall's clock only
        wall = max(int(seconds - used), 1)
        done = _run([*command, corpus, f"-max_total_time={wall}", f"-artifact_prefix={folder}/"])
        for line in done.stderr.splitlines():
            if "number_of_executed_units" in line:
                runs += int(line.split()[-1])
        used = _child_seconds() - start
        if done.returncode != 0:
            return used, runs, done.stderr[-3000:]
    return used, runs, ""


def shrink(command: Command, corpus: Path) -> None:
    """Leave the part of a corpus that covers what the whole of it covers."""
    with tempfile.TemporaryDirectory(dir=corpus.parent) as kept:
        merged = _run([*command, "-merge=1", kept, corpus]).returncode == 0
        if merged and any(Path(kept).iterdir()):
            for path in corpus.iterdir():
                path.unlink()
            for path in Path(kept).iterdir():
                path.rename(corpus / path.name)


def _run(command: Command) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [*command, "-verbosity=0", "-print_final_stats=1"],
        cwd=ROOT, check=False, capture_output=True, text=True, errors="replace",
        env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip


def _child_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def find_missing(targets: list[str], clang: Compiler | None) -> list[str]:
    """Return what has to be installed before these targets can be fuzzed."""
    missing = []
    if clang is None and any(target in build.TARGETS for target in targets):
        missing.append("clang with libFuzzer (or name one by FUZZ_CC)")
    if not importlib.util.find_spec("atheris") and any(t in loaders.TARGETS for t in targets):
        missing.append("atheris")
    return missing


def main() -> int:
    """Fuzz the targets named, or all."""
    known = [*build.TARGETS, *loaders.TARGETS]
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(known)}")
    parser.add_argument("--seconds", type=float, default=600.0, help="of processor time per target")
    parser.add_argument("--scratch", action="store_true", help="leave the kept corpora as they are")
    parser.add_argument(
        "--allow-missing", action="store_true", help="exit with 0 where a fuzzer is missing"
    )
    parser.add_argument("--have-clang", action="store_true", help="only tell by the exit code")
    arguments = parser.parse_args()
    if arguments.have_clang:
        return int(build.find_clang() is None)
    for name in set(arguments.targets) - set(known):
        parser.error(f"no target '{name}'; there are {', '.join(known)}")
    targets, clang = arguments.targets or known, build.find_clang()
    missing = find_missing(targets, clang)
    for what in missing:
        print(f"not fuzzed for lack of {what}: `make setup-fuzz`")
    found, corpus = False, read_corpus()
    for target in targets:
        jobs = [] if find_missing([target], clang) else list(list_jobs(target, clang))
        for name, command, seeds in jobs:
            kept, folder = name.removesuffix("_small"), SCRATCH / name / "corpus"
            if not arguments.scratch:
                shutil.rmtree(folder, ignore_errors=True)
            unpack([*corpus.get(kept, []), *seeds], folder)
            try:
                used, runs, finding = fuzz(name, command, folder, arguments.seconds / len(jobs))
                # atheris cannot merge; libFuzzer drops what a smaller file covers while it runs
                if target in build.TARGETS and not (finding or arguments.scratch):
                    shrink(command, folder)
            finally:
                if not arguments.scratch:
                    corpus[kept] = [path.read_bytes() for path in folder.iterdir()]
                    write_corpus(corpus)
            told = f"FOUND:\n{finding}" if finding else "no finding"
            print(f"{name}: {used:.0f} s of processor time, {runs} runs, {told}", flush=True)
            found |= bool(finding)
    return 1 if found else 2 * bool(missing and not arguments.allow_missing)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted; what was found so far is kept")
