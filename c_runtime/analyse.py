"""Static analysis of the runtime and of generated models: `python -m zerodrift.c_runtime.analyse`.

Every compiler there is with all warnings as errors, gcc's analyser, clang-tidy, cppcheck and its
MISRA C:2012 checker. A tool that is not installed is reported as skipped.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from platform import machine

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import (
    INCLUDE_DIRECTORY,
    RUNTIME_DIRECTORY,
    WARNINGS,
    Compiler,
    find_compilers,
)
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.model_files import load_model

ROOT = RUNTIME_DIRECTORY.resolve().parent
GOLDEN_DIRECTORY = ROOT / "tests" / "golden"
MODELS = ("front_end", "effects", "windowed", "int8_before")
"""Golden models that between them use every kernel."""
VARIANTS = ((), ("-DZD_KERNEL=0",), ("-DZD_KERNEL=1",), ("-DZD_SMALL",), ("-DZD_LANES=2u",))
"""What chooses between the kernels; the vector units' ones are the compilers' own to choose."""

ANALYSER_SUPPRESSED = {
    # it loses count of the loop that fills the head's sums, which every other variant has too
    ("-DZD_KERNEL=1",): ("-Wno-analyzer-use-of-uninitialized-value",),
}
"""Variant -> what gcc's analyser is not asked there."""

MISRA_DEVIATIONS = {
    "2.3": "the typedef that is unused is a static assertion",
    "2.4": "layers of one core's assembly have a type that the other cores leave unused",
    "2.5": "the header's macros are for the user",
    "2.7": "a function of assembly finds its parameters in registers",
    "8.4": "a shared table is declared where it is defined: every model that reads it holds it",
    "8.7": "public functions are used by the firmware, not here",
    "8.9": "constants stand in one place, before the functions",
    "10.1": "signed right shifts are what rounding is made of; they stand in zd_asr32 and zd_asr64",
    "10.4": "uint32_t against an unsigned constant; the checker sees different types",
    "10.7": "sums of 32-bit products of narrower operands are meant; the proof bounds them",
    "10.8": "narrowing after a clamp or a proven bound",
    "12.1": "a sum of products needs no more brackets",
    "15.5": "a step returns early where the state is damaged",
    "20.1": "a target's kernel is included below what it is made of",
    "17.3": "__smlad is declared by arm_acle.h",
    "20.9": "which assembly there is is asked only where there is one",
    "20.7": "the parameter of a static assertion is the name that it declares",
}
"""MISRA C:2012 rule -> why it is not followed."""

CPPCHECK_SUPPRESSED = {
    "missingIncludeSystem": "the checker does not read the system's headers",
    "constParameterPointer": "assembly writes through its own; clang-tidy asks it of the rest",
    "duplicateExpression": "x - lowpass(x) is zero where a model settles",
    "shiftTooManyBitsSigned": "x >> 31 is the compiler's to define, not undefined; asserted",
    "uninitvar": "it believes that the self-test's loop may not begin at 0; gcc's analyser knows",
}
"""cppcheck message -> why it is not listened to."""


@dataclass(frozen=True)
class ToolResult:
    """What one tool said."""

    tool: str
    outcome: str
    """"ok", "skipped", or the tool's own words."""

    @property
    def failed(self) -> bool:
        """Tell whether the tool found something."""
        return self.outcome not in ("ok", "skipped")


def analyse(folder: Path) -> Iterator[ToolResult]:
    """Yield what each tool says of the runtime, its tests and the models, written into `folder`."""
    models = [_write_model(name, folder) for name in MODELS]
    tests = sorted((RUNTIME_DIRECTORY / "tests").glob("*.c"))
    includes = [f"-I{INCLUDE_DIRECTORY}", f"-I{GOLDEN_DIRECTORY}"]
    yield from _compile(tests, models, includes, folder)
    tidied = [str(path) for path in (*tests, *models[0])]
    for variant in VARIANTS:
        some = tidied if variant == () else [str(RUNTIME_DIRECTORY / "tests" / "test_gru.c")]
        arguments = ["--quiet", *some, "--", "-std=c99", *variant, *includes]
        yield _run("clang-tidy", arguments, variant)
    suppressed = [f"--suppress={name}" for name in CPPCHECK_SUPPRESSED]
    for files in models:  # one by one, since a firmware holds one runtime
        arguments = ["--quiet", "--std=c99", "--platform=unix32", *map(str, files)]
        checks = "--enable=warning,performance,portability,style"
        yield _run("cppcheck", [checks, "--error-exitcode=1", *suppressed, *arguments])
    yield _check_misra(models)


def main() -> int:
    """Print every tool's outcome; return 1 if one of them found something."""
    failed = False
    with tempfile.TemporaryDirectory() as scratch:
        for finding in analyse(Path(scratch)):
            print(f"{finding.tool}: {finding.outcome}", flush=True)
            failed |= finding.failed
    return int(failed)


def _write_model(name: str, folder: Path) -> list[Path]:
    """Write a golden model with its runtime into a folder of its own; return the sources."""
    place = folder / name
    place.mkdir()
    written = write_sources(generate(load_model(GOLDEN_DIRECTORY / f"{name}.model.json")), place)
    return [path for path in written if path.suffix == ".c"]


def _compile(
    tests: list[Path], models: list[list[Path]], includes: list[str], folder: Path
) -> Iterator[ToolResult]:
    """Compile every variant with every compiler, the firmware's part also by gcc's analyser."""
    firmware = [*models[0], *(files[0] for files in models[1:])]
    vectors = [("-mavx2",)] if machine() in ("x86_64", "AMD64") else []
    for compiler in find_compilers():
        yield _compile_all(compiler, [], [*tests, *firmware], includes, folder)
        for variant in (*VARIANTS[1:], *vectors):
            yield _compile_all(compiler, [*variant], firmware, includes, folder)
            if compiler.name == "gcc":
                analyser = ["-fanalyzer", *variant, *ANALYSER_SUPPRESSED.get(variant, ())]
                yield _compile_all(compiler, analyser, firmware, includes, folder)
        if compiler.name == "gcc":
            yield _compile_all(compiler, ["-fanalyzer"], firmware, includes, folder)


def _compile_all(
    compiler: Compiler, extra: list[str], sources: list[Path], includes: list[str], folder: Path
) -> ToolResult:
    tool = " ".join([compiler.name, *extra])
    try:
        for source in sources:
            target = ["-c", str(source), "-o", str(folder / "object.o")]
            compiler.run([*WARNINGS, "-O2", *extra, *includes, *target])
    except CheckError as error:
        return ToolResult(tool, str(error))
    return ToolResult(tool, "ok")


def _run(tool: str, arguments: list[str], variant: tuple[str, ...] = ()) -> ToolResult:
    path = _find(tool)
    name = " ".join([tool, *variant])
    if path is None:
        return ToolResult(name, "skipped")
    done = subprocess.run([path, *arguments], capture_output=True, text=True, cwd=ROOT, check=False)
    return ToolResult(name, "ok" if done.returncode == 0 else f"{done.stdout}{done.stderr}")


def _check_misra(models: list[list[Path]]) -> ToolResult:
    path = _find("cppcheck")
    if path is None:
        return ToolResult("misra", "skipped")
    lines = []
    runs = [(files, ()) for files in models] + [(models[0], variant) for variant in VARIANTS[1:]]
    for files, variant in runs:
        command = [path, "--quiet", "--addon=misra", "--enable=style", "--std=c99"]
        command += ["--platform=unix32", *variant, *map(str, files)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        lines += [line for line in done.stderr.splitlines() if "[misra-c2012-" in line]
    new = [line for line in lines if _rule_of(line) not in MISRA_DEVIATIONS]
    stale = set(MISRA_DEVIATIONS) - {_rule_of(line) for line in lines}
    if new:
        return ToolResult("misra", "\n".join(["rules without a listed deviation:", *new[:20]]))
    if stale:
        return ToolResult("misra", f"deviations that are no longer needed: {sorted(stale)}")
    return ToolResult("misra", "ok")


def _rule_of(line: str) -> str:
    match = re.search(r"\[misra-c2012-([0-9.]+)\]", line)
    return match.group(1) if match else ""


def _find(tool: str) -> str | None:
    """Return the tool beside this Python, or on the path."""
    beside = Path(sys.executable).parent / tool
    return str(beside) if beside.exists() else shutil.which(tool)


if __name__ == "__main__":
    sys.exit(main())
