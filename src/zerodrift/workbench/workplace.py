"""One project as the page knows it: what was found, what is being done, what can be undone.

The page changes nothing itself: it runs the commands, in processes of their own, and shows what
they print. All state is here, behind one lock, for the page may be open in several windows.
"""

import json
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json
from zerodrift.diagnosis.diagnosis import ExplainedDiagnosis
from zerodrift.diagnosis.drivers import DriftDriver
from zerodrift.diagnosis.history import FILE_NAME as HISTORY
from zerodrift.diagnosis.history import Step, find_timeline, list_settings
from zerodrift.fleet.sensors import FOLDER
from zerodrift.report.cause import read_driven
from zerodrift.report.findings import Findings, Trace, load_findings
from zerodrift.report.results import (
    AddResult,
    ApplyResult,
    HistoryResult,
    InitResult,
    PlanResult,
    ProposeResult,
    RemoveResult,
    ReportResult,
    TrainResult,
    is_done,
    read_result,
)
from zerodrift.verify.summary import FirmwareSummary, LogsRefused, VerifySummary
from zerodrift.workbench.chip import LiveAnswers, LiveChip, PageReplay, read_replay
from zerodrift.workbench.first_look import FirstLook, read_look
from zerodrift.workbench.hold import hold_directory
from zerodrift.workbench.jobs import (
    CHIP_READY,
    DIAGNOSED,
    DIAGNOSIS,
    PREVIEWED,
    SENSOR,
    SKIP_INVALID,
    SURVEYED,
    Job,
    name_preview,
)
from zerodrift.workbench.state import JobState, PageState
from zerodrift.workbench.uploads import LOGS
from zerodrift.workbench.watch import RecordingWatch, UnitsWatch

# Whether a file of the project was changed from outside of the page.

BUILT = (HISTORY, "firmware.json", "refused.json", "compensator.json")
"""Files of build/ that other commands write and the page shows."""

Marks = dict[str, tuple[int, int]]
"""File, relative to the project -> its size in bytes and the time of its last change in ns."""


def mark_files(
    directory: Path,
    findings: Findings | None,
    recorded: frozenset[Path] = frozenset(),
    sensor: str | None = None,
) -> Marks:
    """Return size and time of zerodrift.toml, the logs, the user's effects, and what was built.

    Whatever went into the findings counts, and new files where logs usually lie, except hidden ones
    and those in `recorded`: a log that grows would never let the page rest. A unit of a fleet has a
    folder of its own below build/.
    """
    places = {directory / FILE_NAME, *directory.glob("*.py"), *directory.glob("*.csv")}
    places |= set(directory.glob(f"{LOGS}/*"))
    built = directory / "build" if sensor is None else directory / "build" / FOLDER / sensor
    places |= {built / name for name in BUILT}
    if findings is not None:
        places |= {directory / source.file for source in findings.provenance.files}
    marks = {}
    for path in sorted(places):
        if path in recorded or path.name.startswith("."):
            continue
        try:
            told = path.stat()
        except OSError:
            continue
        marks[path.relative_to(directory).as_posix()] = (told.st_size, told.st_mtime_ns)
    return marks


# What the page tells its user in words of its own.


@dataclass(frozen=True)
class Message:
    """Something to tell the user."""

    text: str
    is_error: bool = True


def explain_guess(guess: InitResult) -> str:
    """Return what `init` guessed, and what of it to check."""
    outputs = "; ".join(
        f"{name} in {o.unit}: {o.measured} against {o.reference or 0}, full scale "
        f"{o.full_scale:g} {o.unit}"
        for name, o in guess.outputs.items()
    )
    lines = [
        f"Guessed: time {guess.time}, a row every {guess.sample_period_s:g} s; temperature "
        f"{guess.temperature}; {outputs}.",
        *(f"Check: {check}" for check in guess.check),
        "All of it stands in zerodrift.toml and can be edited there; the page follows.",
    ]
    return "\n".join(lines)


# One project as the page knows it: what was found, what is being done, what can be undone.

CHILD = "zerodrift.workbench.worker"
LOOKS_AT = ("verify", "report", "apply", "propose", "plan", "chip")
"""Commands after which the project is as it was."""
CHANGES = ("add", "remove", "restore")
"""Commands that change the model, so that what was found of it is out of date."""
Outcome = (
    TrainResult
    | FirmwareSummary
    | LogsRefused
    | VerifySummary
    | ReportResult
    | ProposeResult
    | PlanResult
    | ApplyResult
)
OUTCOMES = (
    *(TrainResult, FirmwareSummary, LogsRefused, VerifySummary, ReportResult, ProposeResult),
    *(PlanResult, ApplyResult),
)
MOST_READ = 12
"""Drivers of runs that are kept in memory."""
READS_LOGS = ("add", "remove", "propose", "plan", "train", "firmware", "report")
"""Commands that the page runs and that can drop invalid rows."""
OF_ONE_MODEL = (*READS_LOGS, "restore", "verify", "apply")
"""Commands that the page runs and that take a unit of a fleet."""


class Workplace:
    """A project directory, its findings, and the job that runs."""

    def __init__(
        self, directory: Path, *, skip_invalid: bool = False, sensor: str | None = None
    ) -> None:
        """Open a directory.

        Args:
            directory: of zerodrift.toml, or where a new project is to be.
            skip_invalid: drop invalid rows of the logs, in every command that reads them.
            sensor: the unit of a fleet whose model and logs these are; every command gets it.

        Raises:
            InputError: another workbench is open on it.
        """
        self.directory = directory.resolve()
        self.sensor = sensor
        self._skip_invalid = [SKIP_INVALID] if skip_invalid else []
        self._unit = [] if sensor is None else [SENSOR, sensor]
        self._lock = threading.RLock()
        self._hold = hold_directory(self.directory)
        self._scratch = tempfile.TemporaryDirectory(prefix="zerodrift-workbench-")
        self._looks = 0
        self._is_anew = False
        self._result: Path | None = None
        self._marks: Marks = {}
        self.read_sketch: Callable[[], str] = lambda: ""
        """What was read of one log, until there are findings; see `look_first`."""
        self.recordings = RecordingWatch(self.directory, sensor)
        self.units = UnitsWatch(self.directory)
        self._read: dict[tuple[int, str, DriftDriver], Array] = {}
        self.findings: Findings | None = None
        self.previews: tuple[str, ...] = ()
        self.job: Job | None = None
        self.message: Message | None = None
        self.revision: AddResult | RemoveResult | None = None
        """What the last `add` or `remove` found."""
        self.outcome: Outcome | None = None
        """What the last command found that leaves the model as it is."""
        self.refused: dict[str, str] = {}
        """Effect -> why `add` refused it, of this model on these logs."""
        self.done: set[str] = set()
        """What was done with the firmware as it is: verify | apply | report | propose | plan."""
        self.chip: PageReplay | None = None
        """What the page's own run of the C needs."""
        self.chip_folder: Path | None = None
        self._live: LiveChip | None = None
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
    def outdated(self) -> bool:
        """Whether what is shown is of a model that is being changed, or was."""
        job = self.job
        if job is None or not job.running:
            return False
        return job.name in CHANGES or (job.name == "look" and self._is_anew)

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

    def look_first(self) -> FirstLook | None:
        """Return what can be shown of one log before anything is found."""
        return read_look(self.read_sketch())

    def read(self, trace: Trace, driver: DriftDriver) -> Array:
        """Return a driver [n] of a run; the last few are kept, since each zoom asks again."""
        findings = self.findings
        assert findings is not None
        key = (self.shown, trace.run, driver)
        with self._lock:
            known = self._read.get(key)
        if known is None:
            known = read_driven(findings, trace, driver)
            with self._lock:
                while len(self._read) >= MOST_READ:
                    self._read.pop(next(iter(self._read)))
                self._read[key] = known
        return known

    # --- looking --------------------------------------------------------------------------------

    def look(self) -> None:
        """Survey and diagnose the project; what is shown is kept until the new findings are in."""
        with self._lock:
            if not self.has_project or self.busy:
                return
            self._looks += 1
            result = Path(self._scratch.name) / str(self._looks)
            try:
                result.mkdir()
            except OSError as error:
                self.message = Message(
                    f"{result}: cannot be made ({error.strerror}); make room in the system's "
                    "temporary directory, then Look again."
                )
                self._touch()
                return
            self.recordings.begin_look()
            self._marks = self._mark_files()
            arguments = [str(self.directory), str(result), *self._skip_invalid, *self._unit]
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
            if self.busy:
                return
            if not self.has_project:
                self._tell_loss()
                return
            marks = self._mark_files()
            if marks != self._marks:
                changed = sorted(
                    name
                    for name in {*marks, *self._marks}
                    if marks.get(name) != self._marks.get(name)
                )
                if any(not name.startswith("build/") for name in changed):
                    self._begin_anew()
                if self._marks:
                    self.message = Message(
                        f"{', '.join(changed[:3])} changed outside of this page; looking again.",
                        is_error=False,
                    )
                self.look()

    def _mark_files(self) -> Marks:
        recorded = self.recordings.list_logs()
        return mark_files(self.directory, self.findings, recorded, self.sensor)

    def forget_recording(self, file: str) -> None:
        """Show a recording no longer, and follow its log as any other.

        Raises:
            InputError: there is no recording of that log.
        """
        with self._lock:
            self.recordings.forget(file)
            self._touch()

    def _tell_loss(self) -> None:
        """Say once that zerodrift.toml is gone; what was found is still shown."""
        if self.findings is None or not self._marks:
            return
        self._marks = {}
        self.message = Message(
            f"{self.toml}: is gone; what is shown was found before. Put it back, and the page "
            "looks again."
        )
        self._touch()

    def _take(self, event: str, result: Path) -> None:
        """Take over what a child made ready."""
        with self._lock:
            try:
                self._take_over(event, result)
            except (OSError, ValueError, KeyError) as error:
                self.message = Message(f"What was found cannot be read: {error}. Look again.")
            self._touch()

    def _take_over(self, event: str, result: Path) -> None:
        if event == SURVEYED:
            kept = self.findings.diagnosed if self._result == result and self.findings else None
            self.findings = load_findings(result)
            # The findings name logs elsewhere in the project; what was known stays as it was.
            self._marks = {**self._mark_files(), **self._marks}
            known = self.findings.provenance.files
            self.recordings.end_look(frozenset(self.directory / source.file for source in known))
            if kept is not None:
                self.findings = replace(self.findings, diagnosed=kept)
            if self._result != result:
                self._forget(self._result)
                self._result, self.previews = result, ()
            self._read_diagnosis(result)
            self.shown += 1
            self._is_anew = False
        elif event == DIAGNOSED and self._result == result:
            self._read_diagnosis(result)
        elif event == CHIP_READY:
            self._forget(self.chip_folder)
            self.chip, self.chip_folder, self._live = read_replay(result), result, None
        elif event == PREVIEWED:
            names = {p.name.split(".")[1] for p in result.glob("preview.*.npy")}
            self.previews = tuple(bytes.fromhex(name).decode() for name in sorted(names))

    def _forget(self, result: Path | None) -> None:
        """Take earlier findings off the disk; arrays that are still being drawn stay readable."""
        if result is not None:
            shutil.rmtree(result, ignore_errors=True)

    def _read_diagnosis(self, result: Path) -> None:
        path = result / DIAGNOSIS
        if path.exists():
            assert self.findings is not None
            found = json.loads(path.read_text(encoding="utf-8"))
            self.findings = replace(self.findings, diagnosed=from_json(ExplainedDiagnosis, found))

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
            self.message = None
            options = [
                *(self._skip_invalid if name in READS_LOGS else []),
                *(self._unit if name in OF_ONE_MODEL else []),
            ]
            self.job = Job(
                name,
                title,
                [["zerodrift", *arguments, *options, "-C", str(self.directory)]],
                on_end=self._end,
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

    def _end(self, job: Job) -> None:
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
            if isinstance(told, AddResult | RemoveResult):
                self.revision = told
                if is_done(told):
                    self._begin_anew()
                else:
                    self.refused[told.effect] = told.reason
                    text = f"{told.effect} was not added: {told.reason}."
                    self.message = Message(text, is_error=False)
            elif isinstance(told, HistoryResult):
                self.revision = None
                self._begin_anew()
                self.message = Message(f"{job.title}: done.", is_error=False)
            elif isinstance(told, OUTCOMES):
                self.outcome = told
                if isinstance(told, FirmwareSummary):
                    self.done.clear()
                if not isinstance(told, VerifySummary) or told.bit_exact:
                    self.done.add(job.name)
            elif isinstance(told, InitResult):
                self.message = Message(explain_guess(told), is_error=False)
            self._touch()
            # What refuses firmware keeps its reasons in build/, which the page shows, too.
            ended = isinstance(told, OUTCOMES) or not job.failures
            if ended and not job.cancelled and job.name not in ("look", *LOOKS_AT):
                self.look()

    def _begin_anew(self) -> None:
        """Forget what was found out about a model that is another one now."""
        self.refused.clear()
        self.done.clear()
        self._is_anew = True

    def _read_result(self, job: Job) -> object | None:
        """Return what a command found; None where it printed no such record."""
        own = job.name in ("look", "chip")
        return None if own else read_result("".join(job.children[0].out))

    def load_chip(self) -> None:
        """Compile the firmware's C for the page, and ask the reference about the runs."""
        self._stop_looking()
        with self._lock:
            if self.busy:
                self.message = Message("Something is being done already; wait, or cancel it.")
                self._touch()
                return
            self.message = None
            self._looks += 1
            result = Path(self._scratch.name) / f"chip-{self._looks}"
            result.mkdir()
            self.job = Job(
                "chip",
                "Bringing the C into the page",
                [
                    [
                        CHILD,
                        "chip",
                        str(self.directory),
                        str(result),
                        *self._skip_invalid,
                        *self._unit,
                    ]
                ],
                on_event=lambda event: self._take(event, result),
                on_end=self._end,
            )
            self._touch()

    def answer_live(self, text: str, *, anew: bool) -> LiveAnswers:
        """Return the steps that a live sensor's lines make, with the reference's answers.

        Args:
            text: whole lines.
            anew: begin at rest with the first of them.

        Raises:
            InputError: no C is in the page, or a line lacks what the model reads.
        """
        if self.chip_folder is None:
            raise InputError("no C is in the page yet; expected it to run. Press the button first.")
        if anew or self._live is None:
            self._live = LiveChip(self.directory, self.chip_folder, self.sensor)
        return self._live.take(text)

    def undo(self) -> None:
        """Go back to the step before the last change, by the history."""
        self._return(find_timeline(self._list_steps()).undo, "undo")

    def redo(self) -> None:
        """Go forward again to the step that the last undo left."""
        self._return(find_timeline(self._list_steps()).redo, "redo")

    def restore(self, number: int) -> None:
        """Go to a step of the history; all but the effects stays as it is in zerodrift.toml."""
        self._return(number, "restore")

    def _list_steps(self) -> tuple[Step, ...]:
        return self.findings.steps if self.findings is not None else ()

    def _return(self, number: int | None, what: str) -> None:
        steps = self._list_steps()
        if number is None or not 0 <= number < len(steps):
            self.tell(f"There is nothing to {what}.", is_error=False)
            return
        try:
            now = list_settings(load_config(self.directory).effects)
        except InputError as error:
            self.tell(str(error))
            return
        if sorted(now, key=repr) != sorted(steps[-1].settings, key=repr):
            self.tell(
                f"{FILE_NAME} was edited since; going back would lose that. Edit it by hand, or "
                "use Remove."
            )
            return
        title = f"{what.capitalize()}: step {number}, {steps[number].label}"
        self.run("restore", title, ["history", "--restore", str(number), "--json"])

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

    def describe(self) -> PageState:
        """Return where things stand, for the page's polling."""
        with self._lock:
            job = self.job if self.busy else None
            if job is None:
                return PageState(self.version, None)
            return PageState(self.version, JobState(job.title, job.progress, int(job.seconds)))

    def close(self) -> None:
        """End what runs, and let others open the directory."""
        self.cancel()
        self._scratch.cleanup()
        if self._hold is not None:
            os.close(self._hold)
            self._hold = None

    def _touch(self) -> None:
        self.version += 1
