"""One project as the page knows it: what was found, what is being done, what can be undone.

The page changes nothing itself: it runs the commands, in processes of their own, and shows what
they print. All state is here, behind one lock, for the page may be open in several windows.
"""

import json
import os
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.commands.common import write_text
from zerodrift.config import FILE_NAME
from zerodrift.errors import InputError
from zerodrift.physics.history import FILE_NAME as HISTORY
from zerodrift.report.findings import Findings, load_findings
from zerodrift.workbench.child import (
    DIAGNOSED,
    DIAGNOSIS,
    PREVIEWED,
    SURVEYED,
    name_preview,
)
from zerodrift.workbench.jobs import Job

Array = NDArray[np.float64]

CHILD = "zerodrift.workbench.child"
LOGS = "logs"
BUILT = (HISTORY, "firmware.json", "compensator.json")
"""Files of build/ that other commands write and the page shows."""
LARGEST_UPLOAD = 1 << 30
"""Bytes; larger logs are put into the project's folder by other means."""
SUFFIXES = (".csv", ".parquet")


@dataclass(frozen=True)
class Message:
    """Something to tell the user."""

    text: str
    is_error: bool = True


@dataclass(frozen=True)
class Undo:
    """The files as they were before a change, and zerodrift.toml as the change left it."""

    title: str
    text: bytes
    history: bytes | None
    text_after: bytes


class Workplace:
    """A project directory, its findings, and the job that runs."""

    def __init__(self, directory: Path) -> None:
        """Open a directory.

        Args:
            directory: of zerodrift.toml, or where a new project is to be.

        Raises:
            InputError: another workbench is open on it.
        """
        self.directory = directory.resolve()
        self._lock = threading.RLock()
        self._hold = _hold_directory(self.directory)
        self._scratch = tempfile.TemporaryDirectory(prefix="zerodrift-workbench-")
        self._looks = 0
        self._result: Path | None = None
        self._marks: dict[str, tuple[int, int]] = {}
        self.findings: Findings | None = None
        self.previews: tuple[str, ...] = ()
        self.job: Job | None = None
        self.message: Message | None = None
        self.revision: dict[str, Any] | None = None
        """The JSON of the last `add` or `remove`."""
        self.outcome: dict[str, Any] | None = None
        """The JSON of the last `train`, `firmware` or `verify`, with its name."""
        self.undo_stack: list[Undo] = []
        self.version = 0
        """Counts up whenever there is something new to show."""
        self.shown = 0
        """Counts up whenever there are new errors, so that charts are drawn again."""

    # --- what there is --------------------------------------------------------------------------

    @property
    def toml(self) -> Path:
        """The project's zerodrift.toml, which may not be there yet."""
        return self.directory / FILE_NAME

    @property
    def has_project(self) -> bool:
        """Whether there is a zerodrift.toml."""
        return self.toml.is_file()

    @property
    def busy(self) -> bool:
        """Whether a job runs."""
        return self.job is not None and self.job.running

    @property
    def is_practice(self) -> bool:
        """Whether the logs came from `twin`, so that something may be hidden in them."""
        return (self.directory / "truth.json").exists()

    @property
    def diagnosing(self) -> bool:
        """Whether the verdict is still being found."""
        job = self.job
        return job is not None and job.running and job.name == "look"

    def preview(self, effect: str, run: str) -> Array | None:
        """Return [K, n] what an effect would explain of a run, where it was drawn."""
        with self._lock:
            if self._result is None or effect not in self.previews:
                return None
            path = name_preview(self._result, effect, run)
        return np.load(path, mmap_mode="r", allow_pickle=False) if path.exists() else None

    # --- looking --------------------------------------------------------------------------------

    def look(self) -> None:
        """Survey and diagnose the project; what is shown is kept until the new findings are in."""
        with self._lock:
            if not self.has_project or self.busy:
                return
            self._looks += 1
            result = Path(self._scratch.name) / str(self._looks)
            result.mkdir()
            self._marks = self._mark_files()
            arguments = [str(self.directory), str(result)]
            self.job = Job(
                "look",
                "Looking at the project",
                [[CHILD, what, *arguments] for what in ("survey", "diagnose")],
                on_event=lambda event: self._take(event, result),
                on_end=self._end,
            )
            self._touch()

    def poll(self) -> None:
        """Look again if a file of the project was changed from outside."""
        with self._lock:
            if self.busy or not self.has_project:
                return
            marks = self._mark_files()
            if marks != self._marks:
                changed = sorted(
                    name
                    for name in {*marks, *self._marks}
                    if marks.get(name) != self._marks.get(name)
                )
                if self._marks:
                    self.message = Message(
                        f"{', '.join(changed[:3])} changed outside of this page; looking again.",
                        is_error=False,
                    )
                self.look()

    def _mark_files(self) -> dict[str, tuple[int, int]]:
        """Return size and time of zerodrift.toml, the logs, the user's effects, and what was built.

        Whatever went into the findings counts, and new files where logs usually lie.
        """
        marks = {}
        places = {self.toml, *self.directory.glob("*.py"), *self.directory.glob("*.csv")}
        places |= set(self.directory.glob(f"{LOGS}/*"))
        places |= {self.directory / "build" / name for name in BUILT}
        if self.findings is not None:
            files = self.findings.told["provenance"]["files"]
            places |= {self.directory / told["file"] for told in files}
        for path in sorted(places):
            try:
                told = path.stat()
            except OSError:
                continue
            marks[path.relative_to(self.directory).as_posix()] = (told.st_size, told.st_mtime_ns)
        return marks

    def _take(self, event: str, result: Path) -> None:
        """Take over what a child made ready."""
        with self._lock:
            if event == SURVEYED:
                kept = self.findings.told if self._result == result and self.findings else None
                self.findings = load_findings(result)
                # The findings name logs elsewhere in the project; what was known stays as it was.
                self._marks = {**self._mark_files(), **self._marks}
                if kept is not None:
                    self._set_diagnosis(kept["diagnose"], kept["diagnose_sentences"])
                if self._result != result:
                    self._result, self.previews = result, ()
                self._read_diagnosis(result)
            elif event == DIAGNOSED and self._result == result:
                self._read_diagnosis(result)
            elif event == PREVIEWED:
                names = {p.name.split(".")[1] for p in result.glob("preview.*.npy")}
                self.previews = tuple(bytes.fromhex(name).decode() for name in sorted(names))
            self.shown += event == SURVEYED
            self._touch()

    def _read_diagnosis(self, result: Path) -> None:
        path = result / DIAGNOSIS
        if path.exists():
            found = json.loads(path.read_text(encoding="utf-8"))
            self._set_diagnosis(found["diagnosis"], found["sentences"])

    def _set_diagnosis(self, diagnosis: Any, sentences: Any) -> None:
        assert self.findings is not None
        told = {**self.findings.told, "diagnose": diagnosis, "diagnose_sentences": sentences}
        self.findings = replace(self.findings, told=told)

    # --- doing ----------------------------------------------------------------------------------

    def run(self, name: str, title: str, arguments: Sequence[str]) -> bool:
        """Run a command on the project; returns False where another job runs.

        Args:
            name: add | remove | train | firmware | verify | report | init | twin.
            title: what is being done, for people.
            arguments: of the command line, after `zerodrift`.
        """
        self._stop_looking()
        with self._lock:
            if self.busy:
                self.message = Message("Something is being done already; wait, or cancel it.")
                self._touch()
                return False
            before = self._read_files() if name in ("add", "remove") else None
            self.message = None
            self.job = Job(
                name,
                title,
                [["zerodrift", *arguments, "-C", str(self.directory)]],
                on_end=lambda job: self._end(job, before),
            )
            self._touch()
            return True

    def _stop_looking(self) -> None:
        """Stop a survey, which can be made again; not under the lock, which its end needs."""
        job = self.job
        if job is not None and job.running and job.name == "look":
            job.cancel()
            job.wait()

    def cancel(self) -> None:
        """Cancel what runs; commands write whole files or none, so nothing is left half done."""
        job = self.job
        if job is not None and job.running:
            job.cancel()

    def _end(self, job: Job, before: tuple[bytes, bytes | None] | None = None) -> None:
        """Take over what a command printed, or tell why it failed."""
        with self._lock:
            told = self._read_result(job)
            if job.cancelled:
                if job.name != "look":
                    self.message = Message(
                        f"{job.title}: cancelled; the project is as it was.", is_error=False
                    )
            elif job.failures and told is None:
                # One failing survey usually fails twice, in the same words.
                reasons = dict.fromkeys(child.explanation for child in job.failures)
                self.message = Message(f"{job.title}: " + "\n".join(reasons))
            if told is not None and job.name in ("add", "remove"):
                self.revision = {**told, "command": job.name}
                done = told.get("added", told.get("removed", False))
                if done and before is not None:
                    after = self.toml.read_bytes()
                    self.undo_stack.append(Undo(job.title, *before, after))
                if not done:
                    self.message = Message(
                        f"{told['effect']} was not added: {told['reason']}.", is_error=False
                    )
            elif told is not None and job.name in ("train", "firmware", "verify", "report"):
                self.outcome = {"name": job.name, "told": told}
            elif told is not None and job.name == "init":
                self.message = Message(explain_guess(told), is_error=False)
            self._touch()
            is_done = not job.cancelled and not job.failures
            if is_done and job.name not in ("look", "verify", "report"):
                self.look()

    def _read_result(self, job: Job) -> dict[str, Any] | None:
        """Return the JSON that a command printed; None where it printed none."""
        if job.name == "look":
            return None
        try:
            told = json.loads("".join(job.children[0].out))
        except ValueError:
            return None
        return told if isinstance(told, dict) else None

    def undo(self) -> None:
        """Put zerodrift.toml and the history back as they were before the last change.

        A file that was edited since by somebody else is not touched.
        """
        self._stop_looking()
        with self._lock:
            if self.busy:
                self.message = Message("Something is being done; wait, or cancel it, then undo.")
            elif not self.undo_stack:
                self.message = Message("There is nothing to undo.", is_error=False)
            else:
                self._undo_last()
            self._touch()

    def _undo_last(self) -> None:
        last = self.undo_stack[-1]
        if not self.toml.exists() or self.toml.read_bytes() != last.text_after:
            self.message = Message(
                f"{self.toml.name} was edited since; undoing would lose that. Edit it by hand, or "
                "use Remove."
            )
            return
        history = self.directory / "build" / HISTORY
        try:
            write_text(self.toml, last.text.decode("utf-8"))
            if last.history is None:
                history.unlink(missing_ok=True)
            else:
                write_text(history, last.history.decode("utf-8"))
        except (OSError, InputError) as error:
            self.message = Message(f"Undo failed: {error}")
            return
        self.undo_stack.pop()
        self.revision = None
        self.message = Message(f"Undone: {last.title}.", is_error=False)
        self.look()

    def _read_files(self) -> tuple[bytes, bytes | None]:
        history = self.directory / "build" / HISTORY
        return self.toml.read_bytes(), history.read_bytes() if history.exists() else None

    # --- a new project --------------------------------------------------------------------------

    def place_upload(self, name: str, size: int | None) -> Path:
        """Return where a dropped log goes: into logs/, under its own name.

        Raises:
            InputError: the name or the size is not one that can be taken.
        """
        if size is None or size > LARGEST_UPLOAD:
            told = "of unknown size" if size is None else f"{size / 1e9:.1f} GB"
            raise InputError(
                f"{name}: is {told}; the page takes files up to {LARGEST_UPLOAD / 1e9:.1f} GB. "
                f"Copy it into {self.directory / LOGS} and choose it there."
            )
        plain = Path(name.replace("\\", "/")).name
        if plain != name or not plain or plain.startswith("."):
            raise InputError(f"{name!r}: is no plain file name; expected one without folders.")
        if Path(plain).suffix.lower() not in SUFFIXES:
            raise InputError(f"{plain}: is no log; expected {' or '.join(SUFFIXES)}.")
        target = self.directory / LOGS / plain
        if target.exists():
            raise InputError(f"{LOGS}/{plain}: exists already; rename the one that you drop.")
        return target

    def list_logs(self) -> list[str]:
        """Return the logs in the directory and its logs/, relative to it."""
        found = [
            path
            for place in (self.directory, self.directory / LOGS)
            if place.is_dir()
            for path in sorted(place.iterdir())
            if path.suffix.lower() in SUFFIXES and path.is_file()
        ]
        return [path.relative_to(self.directory).as_posix() for path in found]

    def tell(self, text: str, *, is_error: bool = True) -> None:
        """Show a message."""
        with self._lock:
            self.message = Message(text, is_error)
            self._touch()

    def dismiss(self) -> None:
        """Take the message away."""
        with self._lock:
            self.message = None
            self._touch()

    def describe(self) -> Mapping[str, Any]:
        """Return where things stand, for the page's polling."""
        with self._lock:
            job = self.job if self.busy else None
            return {
                "version": self.version,
                "job": None
                if job is None
                else {
                    "name": job.name,
                    "title": job.title,
                    "progress": job.progress,
                    "seconds": int(job.seconds),
                },
            }

    def close(self) -> None:
        """End what runs, and let others open the directory."""
        self.cancel()
        self._scratch.cleanup()
        if self._hold is not None:
            os.close(self._hold)
            self._hold = None

    def _touch(self) -> None:
        self.version += 1


def explain_guess(told: Mapping[str, Any]) -> str:
    """Return what `init` guessed, and what of it to check."""
    outputs = "; ".join(
        f"{name} in {o['unit']}: {o['measured']} against {o['reference'] or 0}, full scale "
        f"{o['full_scale']:g} {o['unit']}"
        for name, o in told["outputs"].items()
    )
    lines = [
        f"Guessed: time {told['time']}, a row every {told['sample_period_s']:g} s; temperature "
        f"{told['temperature']}; {outputs}.",
        *(f"Check: {check}" for check in told["check"]),
        "All of it stands in zerodrift.toml and can be edited there; the page follows.",
    ]
    return "\n".join(lines)


def _hold_directory(directory: Path) -> int | None:
    """Hold a directory against another workbench, as long as this process lives.

    Raises:
        InputError: another one holds it.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows
        return None
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise InputError(
            f"{directory}: another workbench is open on this directory; expected one at a time. "
            "Use its page, or end it with Ctrl-C where it was started."
        ) from error
    return handle
