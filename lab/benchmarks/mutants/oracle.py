"""Says of C what it does: traps, leaves a claimed bound, changes a bit, and in which build."""

import hashlib
import os
import pickle
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutants.chips import Chip, CrashError, run_on_chip
from benchmarks.mutants.driver import PHASES

_GCC = (
    *("gcc", "-std=gnu99", "-w", "-O0", "-ftrivial-auto-var-init=pattern", "-fmax-errors=1"),
    *("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"),
)
_QUICK = (
    "-fsanitize-undefined-trap-on-error",
    "-fno-sanitize=null,pointer-overflow,object-size,nonnull-attribute,returns-nonnull-attribute",
    *(["-fuse-ld=gold"] if shutil.which("ld.gold") else []),
)
"""Half as much to compile; a trap then has no words, and what the address sanitizer sees is left to
it."""
_SECONDS = 20


@dataclass(frozen=True)
class Build:
    """One way to build the C."""

    name: str
    flags: tuple[str, ...] = ()
    chip: Chip | None = None

    def preprocess(self, folder: Path) -> str:
        """Return what the preprocessor makes of it, with line markers; nothing if it fails."""
        command = [*self.command, "-E", "-I.", "judge.c"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        return done.stdout

    @property
    def command(self) -> list[str]:
        """What compiles."""
        return [*(self.chip.command if self.chip else _GCC), *self.flags]

    def judge(self, folder: Path, *, quick: bool = False) -> "Verdict":
        """Build what lies in a folder and run it."""
        program = folder / f"judge_{self.name}"
        more = _QUICK if quick and self.chip is None else ()
        done = subprocess.run(
            [*self.command, *more, "-I.", "judge.c", "-o", program.name],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            return Verdict("does not compile", self.name, done.stderr[-300:])
        if self.chip:
            try:
                return Verdict("ran", self.name, "", run_on_chip(program, self.chip, len(PHASES)))
            except CrashError as error:
                return Verdict("traps", self.name, str(error))
        return self._run(program)

    def _run(self, program: Path) -> "Verdict":
        environment = {"UBSAN_OPTIONS": "print_stacktrace=0", "ASAN_OPTIONS": "detect_leaks=0"}
        try:
            done = subprocess.run(
                [program],
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                env=environment,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Verdict("traps", self.name, f"does not end in {_SECONDS} s")
        if done.returncode != 0:
            said = re.search(r"runtime error: .*|ERROR: \w+: [\w-]+.*", done.stderr)
            return Verdict("traps", self.name, said[0] if said else done.stderr[-200:])
        lines = done.stdout.split("\n")
        hashes = tuple(line for line in lines if re.fullmatch(r"[0-9a-f]{16}", line))
        left = [line for line in lines if line.startswith("left ")]
        return Verdict("leaves" if left else "ran", self.name, " ".join(left), hashes)


@dataclass(frozen=True)
class Verdict:
    """What became of a build."""

    kind: str
    """ran, traps, leaves (a bound), does not compile."""
    build: str
    detail: str = ""
    hashes: tuple[str, ...] = ()


HOST_BUILDS = (
    Build("columns"),
    Build("portable", ("-DZD_KERNEL=0", "-DZD_LANES=2u")),
    Build("pairs", ("-DZD_KERNEL=1", "-DZD_LANES=2u")),
    Build("avx2", ("-mavx2",)),
    Build("small", ("-DZD_SMALL",)),
    Build("rows", ("-DZD_KERNEL=2", "-I" + str(Path(__file__).parent / "mve"))),
)
CHIP_BUILDS = (
    Build("m4", ("-O1",), Chip("cortex-m4")),
    Build("m0plus", ("-O1",), Chip("cortex-m0plus")),
    Build("rv32imc", ("-O1",), Chip("rv32imc")),
    Build("m3", ("-O1",), Chip("cortex-m3")),
    Build("m4_c", ("-O1", "-DZD_NO_ASSEMBLY"), Chip("cortex-m4")),
    Build("m4_small", ("-O1", "-DZD_SMALL"), Chip("cortex-m4")),
    Build("m0plus_small", ("-O1", "-DZD_SMALL"), Chip("cortex-m0plus")),
    Build("m4_aligned", ("-O1", "-mno-unaligned-access"), Chip("cortex-m4")),
)


@dataclass(frozen=True)
class Finding:
    """What a mutant does."""

    kind: str
    """traps, leaves a bound, changes a bit, does not compile, equivalent."""
    build: str = ""
    phase: str = ""
    detail: str = ""


@dataclass(frozen=True)
class Base:
    """What the unchanged C does in one build."""

    verdict: Verdict
    active: frozenset[tuple[str, int]]
    """(file, line) of all that the preprocessor lets through."""
    text: str
    """What the preprocessor makes of it."""


class Oracle:
    """Judges changes of one model's files.

    Args:
        files: name -> text, as shipped.
        driver: the program of `driver.render_driver`.
        chips: whether to run on emulated cores too.
        kept: a folder where what the unchanged C does is kept for other processes.
    """

    def __init__(
        self,
        files: dict[str, str],
        driver: str,
        *,
        chips: bool = True,
        kept: Path | None = None,
    ) -> None:
        self.files, self.driver, self._kept = files, driver, kept
        self.builds = (*HOST_BUILDS, *(CHIP_BUILDS if chips else ()))
        self._base: dict[str, Base] = {}

    def find_base(self, build: Build) -> Base:
        """Return what the unchanged C does in a build, worked out once."""
        if build.name not in self._base:
            self._base[build.name] = self._read_base(build)
        return self._base[build.name]

    def _read_base(self, build: Build) -> Base:
        state = repr((sorted(self.files.items()), self.driver, build.name, build.command))
        key = hashlib.sha256(state.encode()).hexdigest()[:16]
        path = self._kept / f"{key}.pickle" if self._kept else None
        if path and path.is_file():
            base = pickle.loads(path.read_bytes())  # noqa: S301 - written below
            assert isinstance(base, Base)
            return base
        with tempfile.TemporaryDirectory() as name:
            folder = self._write(Path(name), self.files)
            verdict = build.judge(folder)
            if verdict.kind != "ran":
                raise SystemExit(
                    f"the unchanged C {verdict.kind} as {build.name}: {verdict.detail}"
                )
            text = build.preprocess(folder)
        base = Base(verdict, frozenset(list_active_lines(text)), drop_markers(text))
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            whole = path.with_suffix(f".{os.getpid()}")
            whole.write_bytes(pickle.dumps(base))
            whole.replace(path)
        return base

    def _write(self, folder: Path, files: dict[str, str]) -> Path:
        for name, text in {**files, "judge.c": self.driver}.items():
            (folder / name).write_text(text, encoding="utf-8")
        return folder

    def judge(
        self,
        name: str,
        text: str,
        lines: range,
        *,
        bit_suffices: bool = False,
        quick: bool = False,
    ) -> Finding:
        """Say what the change of one file's lines does.

        Args:
            name: of the file.
            text: its changed text.
            lines: the lines that were touched; of a preprocessor's line, all builds are looked at.
            bit_suffices: look no further for a trap once a bit has changed.
            quick: look at the first build that compiles the lines, and at no other: what is found
                is so, what is not found may be there.
        """
        original = self.files[name].split("\n")
        touched = [original[n - 1] for n in lines if n <= len(original)]
        directive = any(line.lstrip().startswith("#") or line.endswith("\\") for line in touched)
        found = list(self.builds)
        if not directive:
            found = self._list_reading(name, lines, [b for b in self.builds if b.chip is None])
            if len(found) == len(HOST_BUILDS):  # what all share need not be asked of all
                found = [build for build in found if build.name in ("columns", "portable", "small")]
            if not found:  # what a sanitizer can see is not asked of a core that has none
                chips = [build for build in self.builds if build.chip]
                found = self._list_reading(name, lines, chips)
        changed, unbuilt = None, None
        with tempfile.TemporaryDirectory() as place:
            folder = self._write(Path(place), {**self.files, name: text})
            for build in found:
                if directive and self._reads_the_same(build, folder):
                    continue
                verdict = build.judge(folder, quick=quick)
                if verdict.kind == "does not compile":
                    unbuilt = Finding("does not compile", build.name, "", verdict.detail)
                elif verdict.kind in ("traps", "leaves"):
                    kind = "traps" if verdict.kind == "traps" else "leaves a bound"
                    return Finding(kind, build.name, "bound", verdict.detail)
                elif changed is None and verdict.hashes != self.find_base(build).verdict.hashes:
                    before = self.find_base(build).verdict.hashes
                    pairs = zip(PHASES, verdict.hashes, before, strict=True)
                    phases = [phase for phase, new, old in pairs if new != old]
                    changed = Finding("changes a bit", build.name, " ".join(phases))
                for file in folder.glob("judge_*"):
                    file.unlink() if file.is_file() else shutil.rmtree(file)
                if quick or unbuilt or (bit_suffices and changed):
                    break
        if unbuilt and changed is None:
            return unbuilt
        return changed or Finding("equivalent")

    def _reads_the_same(self, build: Build, folder: Path) -> bool:
        """Say whether the preprocessor makes the same of a folder."""
        return drop_markers(build.preprocess(folder)) == self.find_base(build).text

    def _list_reading(self, name: str, lines: range, builds: list[Build]) -> list[Build]:
        """Return the builds that compile one of a file's lines."""
        return [b for b in builds if any((name, n) in self.find_base(b).active for n in lines)]


def list_active_lines(text: str) -> set[tuple[str, int]]:
    """Return (file, line) of all that the preprocessor let through."""
    active, name, line = set(), "", 0
    for row in text.split("\n"):
        marker = re.match(r'#(?:line)? (\d+) "([^"]*)"', row)
        if marker:
            name, line = Path(marker[2]).name, int(marker[1])
            continue
        if row.strip():
            active.add((name, line))
        line += 1
    return active


def drop_markers(text: str) -> str:
    """Return preprocessed text without where it came from."""
    return "\n".join(row for row in text.split("\n") if row.strip() and not row.startswith("#"))
