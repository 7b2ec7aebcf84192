"""Builds and runs the fuzz targets: `python tests/fuzz/build.py [SECONDS [TARGET]]`.

Needs clang. Every target runs for SECONDS (default 600), shared out over its models, under the
address and undefined-behaviour sanitizers, and keeps what it has found interesting in
tests/fuzz/corpus/TARGET_MODEL.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel, load_model

HERE = Path(__file__).parent
GOLDEN = HERE.parent / "golden"
TARGETS = {"step": 0, "state": 1, "restore": 2}
MODELS = ("front_end", "windowed", "int8_before")
SANITIZERS = "address,undefined"


def build(
    model: IntegerModel, target: str, compiler: Compiler, folder: Path, extra: tuple[str, ...]
) -> Path:
    """Return the program of one target for one model.

    Args:
        model: the integer model.
        target: one of `TARGETS`.
        compiler: of the host.
        folder: is made; holds sources and program.
        extra: "-fsanitize=..." and what else the compiler is to be told.
    """
    folder.mkdir(parents=True, exist_ok=True)
    code = generate(model)
    write_sources(code, folder)
    (folder / f"{code.prefix}_harness.c").write_text(code.harness, encoding="utf-8")
    limits = [
        ",".join(f"({int(v)})" for v in values) for values in (model.drift.low, model.drift.high)
    ]
    program = folder / f"fuzz_{target}"
    compiler.run(
        ["-std=c99", "-O1", "-g", "-fno-sanitize-recover=all", "-DZD_PLAIN", *extra,
         f"-DTARGET={TARGETS[target]}", f'-DHARNESS="{code.prefix}_harness.c"',
         f"-DMODEL_STATE={code.prefix}_state_t", f"-DMODEL_SAVE={code.prefix}_save",
         f"-DMODEL_RESTORE={code.prefix}_restore", f"-DIDENTITY={code.prefix.upper()}_MODEL_ID",
         f"-DCHANNELS={len(model.channels)}", f"-DOUTPUTS={len(model.outputs)}",
         f"-DLOWEST={{{limits[0]}}}", f"-DHIGHEST={{{limits[1]}}}", f"-I{folder}",
         str(HERE / "fuzz_model.c"), str(folder / "zd_runtime.c"), "-o", str(program)]
    )  # fmt: skip
    return program


def main() -> int:
    """Fuzz every target on every model; return 1 if one of them found something."""
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 600
    path = os.environ.get("FUZZ_CC") or shutil.which("clang")
    if path is None:
        print("fuzzing needs clang with libFuzzer: `apt-get install clang`, or FUZZ_CC=clang-14")
        return 2
    clang = Compiler("clang", (path,))
    found = 0
    for target in sys.argv[2:] or TARGETS:
        for name in MODELS:
            folder = HERE.parents[1] / "build" / "fuzz" / f"{target}_{name}"
            model = load_model(GOLDEN / f"{name}.model.json")
            program = build(model, target, clang, folder, (f"-fsanitize=fuzzer,{SANITIZERS}",))
            corpus = HERE / "corpus" / f"{target}_{name}"
            corpus.mkdir(parents=True, exist_ok=True)
            share = max(seconds // len(MODELS), 1)
            done = subprocess.run(
                [program, corpus, f"-max_total_time={share}", "-max_len=600", "-verbosity=0",
                 "-print_final_stats=1"],
                cwd=folder, check=False, capture_output=True, text=True,
            )  # fmt: skip
            runs = [line for line in done.stderr.splitlines() if "number_of_executed" in line]
            print(f"{target}, {name}: {share} s, {' '.join(runs)[-20:].strip()} runs,", end=" ")
            print("no finding" if done.returncode == 0 else f"FOUND:\n{done.stderr[-3000:]}")
            found |= done.returncode != 0
    return int(found)


if __name__ == "__main__":
    sys.exit(main())
