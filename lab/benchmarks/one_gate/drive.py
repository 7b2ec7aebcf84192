"""Runs the command line on a folder and reads nothing but its exit code and its JSON."""

import json
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from click.testing import CliRunner

from zerodrift.base.threads import use_one_thread
from zerodrift.cli.main import cli

CRASHED = -1
"""Stands for an exit code where a command ended with an error of its own making, or not at all."""
LIMIT_S = 120.0
"""Processor time of one command; on such small logs a firmware takes 1 to 3 s."""


class TooLongError(Exception):
    """A command went on beyond its processor time."""


@contextmanager
def limit(seconds: float) -> Iterator[None]:
    """Raise TooLongError once what is within has taken so much processor time of this process."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"no answer within {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@dataclass(frozen=True)
class Entry:
    """One entry of `refused` or of `notes`, as text; what is not there is ""."""

    kind: str = ""
    run: str = ""
    column: str = ""
    text: str = ""

    @property
    def of_data(self) -> bool:
        """Whether it speaks of wrong data: entries of the gate have an output, no run or column."""
        return bool(self.run or self.column)


@dataclass(frozen=True)
class Answer:
    """What a command said.

    Attributes:
        code: exit code, or CRASHED.
        told: its JSON object, empty where there is none.
        message: what went to stderr, or the error's text.
    """

    code: int
    told: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""

    def list_entries(self, key: str) -> list[Entry]:
        """Return `refused` or `notes`."""
        return [
            Entry(*(str(plain.get(name) or "") for name in ("kind", "run", "column", "text")))
            for plain in self.told.get(key) or []
        ]

    @property
    def stopped(self) -> bool:
        """Whether no firmware was written."""
        return self.code != 0


def ask(folder: Path, command: str, *words: str) -> Answer:
    """Run `zerodrift COMMAND -C FOLDER --json WORDS` in this process."""
    use_one_thread()
    with limit(LIMIT_S):
        done = CliRunner().invoke(cli, [command, "-C", str(folder), "--json", *words])
    code, message = done.exit_code, done.stderr.strip()
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        code = int(getattr(done.exception, "exit_code", CRASHED))
        message = f"{type(done.exception).__name__}: {done.exception}"
    try:
        told = json.loads(done.stdout)
    except ValueError:
        told = {}
    return Answer(code, told if isinstance(told, dict) else {}, message)
