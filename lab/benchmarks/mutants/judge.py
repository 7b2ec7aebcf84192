"""Draws mutants from a seed, asks the oracle, then the judge on trial; keeps what was found."""

import contextlib
import difflib
import hashlib
import io
import json
import os
import random
import shutil
import signal
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from unittest import mock

from benchmarks.mutants.operators import OPERATORS, Edit
from benchmarks.mutants.oracle import Finding, Oracle
from benchmarks.mutants.source import Source
from benchmarks.mutants.subjects import Subject

_JUDGE_SECONDS = 600
_MODEL_SHARE = 0.6
"""Of the mutants, those in the model's own two files; the others are in the runtime's."""


@dataclass(frozen=True)
class Mutant:
    """One file with one thing changed."""

    number: int
    kind: str
    """One of `OPERATORS`."""
    file: str
    line: int
    text: str
    """The file's text, changed."""
    lines: range
    """Of the original that the change touches."""

    def diff(self, before: str) -> str:
        """Return what was changed, as a diff without context."""
        lines = difflib.unified_diff(before.split("\n"), self.text.split("\n"), lineterm="", n=0)
        return "\n".join(list(lines)[2:])


def draw_mutant(
    subject: Subject,
    seed: int,
    number: int,
    kinds: tuple[str, ...] = (),
    *,
    model_share: float = _MODEL_SHARE,
) -> Mutant:
    """Return the mutant of a number: the same one whenever it is asked for.

    Args:
        subject: whose files are mutated.
        seed: of all mutants.
        number: of this one.
        kinds: of `OPERATORS`; empty for all.
        model_share: how many are in the model's own two files.
    """
    rng = random.Random(f"{seed}/{number}")
    names = sorted(subject.files)
    own = [n for n in names if not n.startswith("zd_")]
    others = [n for n in names if n.startswith("zd_")]
    classes = {k: v for k, v in OPERATORS.items() if not kinds or k in kinds}
    while True:
        kind = rng.choices(list(classes), [weight for _, weight in classes.values()])[0]
        pool = own if rng.random() < model_share else others
        weights = [len(subject.files[n]) ** 0.5 for n in pool]
        name = rng.choices(pool, weights)[0]
        source = _read_source(name, subject.files[name])
        edit: Edit | None = classes[kind][0](source, rng)
        if edit is None or source.text[edit.start : edit.end] == edit.text:
            continue
        text = source.text[: edit.start] + edit.text + source.text[edit.end :]
        if text.split() == source.text.split():
            continue
        first, last = source.count_lines(edit.start), source.count_lines(edit.end)
        return Mutant(number, kind, name, first, text, range(first, last + 1))


_SOURCES: dict[tuple[str, int], Source] = {}


def _read_source(name: str, text: str) -> Source:
    return _SOURCES.setdefault((name, hash(text)), Source(name, text))


def write_mutant(subject: Subject, mutant: Mutant, folder: Path, *, bits: bool = False) -> None:
    """Write a folder that holds the mutant and hashes that speak for it.

    Args:
        subject: the firmware folder or project; copied.
        mutant: what replaces one of its files.
        folder: where the firmware folder, or the project's directory, is written.
        bits: give code and runtime the identities of their text, as of another version.
    """
    if subject.project:
        shutil.copytree(subject.project, folder)
        shipped = folder / subject.folder.relative_to(subject.project)
    else:
        shutil.copytree(subject.folder, folder)
        shipped = folder
    texts = {**subject.files, mutant.file: mutant.text}
    if bits:
        texts = identify_files(texts, subject.prefix)
    for name, text in texts.items():
        if text != subject.files[name]:
            replace_file(shipped / name, text.encode(), [shipped, folder / "build"])


def identify_files(texts: dict[str, str], prefix: str) -> dict[str, str]:
    """Return a firmware's C, name -> text, with the identities that its texts have."""
    from zerodrift.codegen.identity import (
        identify_again,
        identify_runtime,
        read_runtime_identity,
    )

    header, source = f"{prefix}.h", f"{prefix}.c"
    runtime = {name: text for name, text in texts.items() if "ZD_RUNTIME_ID" in text}
    own = {name: runtime.pop(name, texts[name]) for name in (header, source)}
    before = read_runtime_identity(runtime)
    runtime = identify_runtime(runtime)
    after = read_runtime_identity(runtime)
    if before:
        own = {name: text.replace(before, after) for name, text in own.items()}
    own[header], own[source] = identify_again(own[header], own[source])
    return {**texts, **runtime, **own}


def replace_file(path: Path, content: bytes, folders: list[Path]) -> None:
    """Replace a file and, in every text of some folders, its hash by the new one.

    A file whose text changes by that has a new hash itself; it goes on until nothing changes.
    """
    pending = [(path, content)]
    for _ in range(30):
        if not pending:
            return
        target, new = pending.pop(0)
        old = target.read_bytes()
        target.write_bytes(new)
        before, after = (hashlib.sha256(data).hexdigest() for data in (old, new))
        for folder in folders:
            for file in sorted(folder.glob("*")) if folder.is_dir() else ():
                if file.suffix in (".json", ".c", ".h") and file.is_file():
                    data = file.read_bytes()
                    changed = data.replace(before.encode(), after.encode())
                    if changed != data and file != target:
                        pending.append((file, changed))


@dataclass(frozen=True)
class Record:
    """What is known of one mutant; one line of the file of results."""

    subject: str
    number: int
    kind: str
    file: str
    line: int
    finding: Finding
    diff: str


def judge_mutant(
    subject: Subject,
    oracle: Oracle,
    seed: int,
    number: int,
    *,
    bit_suffices: bool,
    quick: bool = False,
) -> Record:
    """Ask the oracle of one mutant."""
    mutant = draw_mutant(subject, seed, number)
    finding = oracle.judge(
        mutant.file, mutant.text, mutant.lines, bit_suffices=bit_suffices, quick=quick
    )
    diff = mutant.diff(subject.files[mutant.file])
    return Record(subject.name, number, mutant.kind, mutant.file, mutant.line, finding, diff)


class JudgeHangsError(Exception):
    """The judge on trial did not end."""


@contextlib.contextmanager
def end_after(seconds: int) -> Iterator[None]:
    """Raise `JudgeHangsError` in the block after so many seconds."""

    def stop(*_: object) -> None:
        raise JudgeHangsError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def ask_certificate(folder: Path) -> tuple[str, str]:
    """Return accepted, refused, hangs or crashes, and what the certificate's checker said."""
    from zerodrift_proof import check_certificate

    try:
        with end_after(_JUDGE_SECONDS):
            outcome = check_certificate(folder)
    except JudgeHangsError:
        return "hangs", f"no answer in {_JUDGE_SECONDS} s"
    except Exception as error:  # noqa: BLE001 - whatever it is, it is told
        from zerodrift.base.errors import ZerodriftError

        told = f"{type(error).__name__}: {str(error)[:200]}"
        return ("refused" if isinstance(error, ZerodriftError) else "crashes"), told
    return ("refused", outcome.failures[0][:200]) if outcome.failures else ("accepted", "")


@contextlib.contextmanager
def first_failure_suffices() -> Iterator[None]:
    """Let verify leave out what comes after the host's builds, or a core, that differ.

    What it finds later adds to a refusal and never takes one back.
    """
    from zerodrift.verify import folder_check, replay

    check_cores, run_core = folder_check._check_cores, folder_check._run_core
    check_claims = replay.check_folder_certificate
    failed: list[str] = []

    def check(found: folder_check.FolderCheck, *rest: object) -> None:
        failed.extend(found.failures)
        if not failed:
            check_cores(found, *rest)  # type: ignore[arg-type]

    def run(*rest: object) -> list[str]:
        failures = [] if failed else run_core(*rest)  # type: ignore[arg-type]
        failed.extend(failures)
        return failures

    def derive(*given: object) -> object:
        return replay.NO_CERTIFICATE if failed else check_claims(*given)  # type: ignore[arg-type]

    with (
        mock.patch.object(folder_check, "_check_cores", check),
        mock.patch.object(folder_check, "_run_core", run),
        mock.patch.object(replay, "check_folder_certificate", derive),
    ):
        yield


def ask_verify(project: Path, *, quick: bool = False) -> tuple[str, str]:
    """Return accepted, refused, hangs or crashes, and what `zerodrift verify` said."""
    from click.testing import CliRunner

    from zerodrift.base.errors import ZerodriftError
    from zerodrift.cli.main import cli

    home = Path.cwd()
    shortened = first_failure_suffices() if quick else contextlib.nullcontext()
    try:
        with end_after(_JUDGE_SECONDS), contextlib.redirect_stderr(io.StringIO()), shortened:
            done = CliRunner().invoke(cli, ["verify", "-C", str(project), "--trust"])
    except JudgeHangsError:
        return "hangs", f"no answer in {_JUDGE_SECONDS} s"
    finally:
        os.chdir(home)
    if done.exception is None or (isinstance(done.exception, SystemExit) and done.exit_code == 0):
        return "accepted", done.output.strip()[-200:]
    if isinstance(done.exception, ZerodriftError):
        return "refused", str(done.exception)[:300]
    if isinstance(done.exception, JudgeHangsError):
        return "hangs", f"no answer in {_JUDGE_SECONDS} s"
    return "crashes", repr(done.exception)[:300]


def try_mutant(
    subject: Subject, seed: int, number: int, way: str, *, bits: bool = False, quick: bool = False
) -> tuple[str, str]:
    """Give one mutant, its hashes corrected, to the judge on trial."""
    mutant = draw_mutant(subject, seed, number)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "mutant"
        write_mutant(subject, mutant, folder, bits=bits)
        return ask_verify(folder, quick=quick) if way == "verify" else ask_certificate(folder)


def to_line(record: Record, told: tuple[str, str] | None) -> str:
    """Return a record as one line of JSON."""
    return json.dumps({**asdict(record), "told": told})
