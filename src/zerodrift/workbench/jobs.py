"""Commands run as separate processes: with progress, and cancellable; a crash spares the page.

A child reports progress by lines on stderr that begin with `progress: `, and that something is
ready by lines on stdout that begin with `event: `; all else on stdout is its result.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from zerodrift.base.progress import PROGRESS_LINES, PROGRESS_MARK

# What the processes behind the page say, and where they leave what they found.

SURVEYED, DIAGNOSED, PREVIEWED, CHIP_READY = "surveyed", "diagnosed", "previewed", "chip-ready"
DIAGNOSIS = "diagnosis.json"
SKIP_INVALID, SENSOR = "--skip-invalid", "--sensor"


def name_preview(result: Path, effect: str, run: str) -> Path:
    """Return where the preview of an effect in a run lies; names may hold any character."""
    return result / f"preview.{effect.encode().hex()}.{run.encode().hex()}.npy"


# Commands run as separate processes: with progress, and cancellable; a crash spares the page.

EVENT_MARK = "event: "
GRACE_S = 4.0
"""Seconds after which a child that was asked to end is killed."""
WAYS_TO_END = 3
"""Of `_end_group`, tried in turn."""
NEW_GROUP = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
"""On Windows a child leads a group by this flag, elsewhere by a session of its own."""


@dataclass
class Child:
    """One process and what it said."""

    arguments: tuple[str, ...]
    process: subprocess.Popen[str]
    out: list[str] = field(default_factory=list)
    err: list[str] = field(default_factory=list)

    @property
    def explanation(self) -> str:
        """Why it failed, in its own words."""
        lines = [line.removeprefix("error: ") for line in self.err if line.strip()]
        if any(line.startswith("Traceback") for line in lines):
            lines = [f"{lines[-1]} (the command failed in a way that nobody foresaw)"]
        code = self.process.returncode
        return "\n".join(line for line in lines if not line.startswith("note: ")) or (
            f"`{' '.join(self.arguments)}` ended with code {code} and said nothing."
        )


class Job:
    """Something that was asked for: one or several processes at once."""

    def __init__(
        self,
        name: str,
        title: str,
        commands: Sequence[Sequence[str]],
        *,
        on_event: Callable[[str], None] = lambda _: None,
        on_end: Callable[["Job"], None] = lambda _: None,
    ) -> None:
        """Start the processes.

        Args:
            name: which kind of job.
            title: what is being done, for people.
            commands: arguments after `python -m`.
            on_event: called with each event that a child tells, from a thread of its own.
            on_end: called once when all have ended, from a thread of its own.
        """
        self.name, self.title = name, title
        self.progress = ""
        self.cancelled = False
        self.started_s = time.monotonic()
        self.ended_s: float | None = None
        self._on_event, self._on_end = on_event, on_end
        environment = {**os.environ, PROGRESS_LINES: "1", "PYTHONUNBUFFERED": "1"}
        self.children = [
            Child(
                tuple(command),
                subprocess.Popen(
                    [sys.executable, "-P", "-m", *command],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                    encoding="utf-8",
                    errors="replace",
                    start_new_session=True,
                    creationflags=NEW_GROUP,
                ),
            )
            for command in commands
        ]
        self._readers = [
            threading.Thread(target=read, args=(child, stream), daemon=True)
            for child in self.children
            for read, stream in (
                (self._read_out, child.process.stdout),
                (self._read_err, child.process.stderr),
            )
        ]
        for reader in self._readers:
            reader.start()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.ended_s is None

    @property
    def seconds(self) -> float:
        """How long it has been running, or ran."""
        return (self.ended_s or time.monotonic()) - self.started_s

    @property
    def failures(self) -> list[Child]:
        """The children that ended with an error."""
        return [child for child in self.children if child.process.returncode]

    def cancel(self) -> None:
        """Stop all processes, and what they started themselves."""
        self.cancelled = True
        for way in range(WAYS_TO_END):
            for child in self.children:
                if child.process.poll() is None:
                    _end_group(child.process, way)
            deadline = time.monotonic() + GRACE_S
            while time.monotonic() < deadline:
                if all(child.process.poll() is not None for child in self.children):
                    return
                time.sleep(0.02)

    def wait(self, timeout_s: float | None = None) -> None:
        """Return when the job has ended and everybody was told."""
        self._watcher.join(timeout_s)

    def _read_out(self, child: Child, stream: IO[str]) -> None:
        for line in stream:
            if line.startswith(EVENT_MARK):
                self._on_event(line.removeprefix(EVENT_MARK).strip())
            else:
                child.out.append(line)

    def _read_err(self, child: Child, stream: IO[str]) -> None:
        for line in stream:
            if line.startswith(PROGRESS_MARK):
                self.progress = line.removeprefix(PROGRESS_MARK).strip()
            else:
                child.err.append(line.rstrip("\n"))

    def _watch(self) -> None:
        for child in self.children:
            child.process.wait()
        for reader in self._readers:
            reader.join()
        self.ended_s = time.monotonic()
        self._on_end(self)


def _end_group(process: subprocess.Popen[str], way: int) -> None:
    """End a process that leads a group, and all in it.

    Args:
        process: leads its group.
        way: 0 interrupts, on which a command takes its scratch files away; 1 asks; 2 kills. On
            Windows the last two end the process alone.
    """
    with contextlib.suppress(ProcessLookupError):
        if sys.platform == "win32":
            (
                lambda: process.send_signal(signal.CTRL_BREAK_EVENT),
                process.terminate,
                process.kill,
            )[way]()
        else:
            os.killpg(process.pid, (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[way])
