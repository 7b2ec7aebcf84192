"""What a task tells while it works: to a terminal, a notebook's cell, or another program.

A task is handed a `Progress` and calls it with what it is doing; the one it is handed by default is
silent. Where that goes is decided here; the command line adds how the user is told and asked.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, TypeVar

from zerodrift.base.terminal import open_terminal

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID
    from rich.status import Status

PROGRESS_LINES = "ZERODRIFT_PROGRESS_LINES"
"""Environment variable: progress is told in lines that begin with PROGRESS_MARK."""
PROGRESS_MARK = "progress: "
NOTEBOOK_SECONDS = 0.2
"""Between two texts in a notebook."""


@dataclass(frozen=True)
class Stage:
    """How far a piece of work is whose end is known."""

    done: float
    """Share of the work, 0 .. 1."""
    text: str


class Display:
    """Where progress is shown; this one is nowhere, for a pipe."""

    def say(self, text: str) -> None:
        """Show what is being done now."""

    @contextmanager
    def measure(self, title: str) -> Iterator[Callable[[Stage], None]]:
        """Show how far a piece of work is, for as long as the block runs."""
        yield lambda stage: self.say(f"{title}, {100.0 * stage.done:.0f} %: {stage.text}")

    @contextmanager
    def count(self, title: str) -> Iterator[Callable[[int, int, str], None]]:
        """Show how many things of how many are done, for as long as the block runs."""
        yield lambda done, total, text: self.say(f"{done} of {total} {title} {text}".strip())

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Show nothing for as long as the block runs."""
        yield

    def close(self) -> None:
        """Take away what is shown."""


class Progress:
    """What a task tells its user while it works; as it stands, nobody hears it.

    Called with a text, it says what is being done now.

    Args:
        screen: where it is shown.
    """

    def __init__(self, screen: Display | None = None) -> None:
        self.screen = screen or Display()

    def __call__(self, text: str) -> None:
        """Say what is being done now."""
        self.screen.say(text)

    def measure(self, title: str) -> AbstractContextManager[Callable[[Stage], None]]:
        """Return a block; it yields what is called with each stage of work whose end is known."""
        return self.screen.measure(title)

    def count(self, title: str) -> AbstractContextManager[Callable[[int, int, str], None]]:
        """Return a block; it yields what is called with how many of how many are done."""
        return self.screen.count(title)

    def tell(self, text: str) -> None:
        """Tell the user a sentence before the work goes on."""

    def note(self, text: str) -> None:
        """Tell the user what was noticed, before the work goes on."""
        self.tell(f"note: {text}")

    def show(self, found: object) -> None:
        """Show the user what a part of the work has found, before the rest goes on."""

    def confirm(self, question: str) -> bool | None:
        """Return whether the user agrees; None where nobody can be asked."""
        return None


SILENT = Progress()
Kind = TypeVar("Kind", bound=Progress)


@contextmanager
def show_progress(kind: type[Kind], first: str = "") -> Iterator[Kind]:
    """Show on stderr, or in a notebook's cell, what is being done; yields what a task is handed.

    Args:
        kind: the class of what is yielded.
        first: what is being done first.
    """
    screen = _find_screen()
    try:
        if first:
            screen.say(first)
        yield kind(screen)
    finally:
        screen.close()


def is_watched() -> bool:
    """Return whether stderr is a terminal; a colour that is forced on a pipe makes it none."""
    return sys.stderr is not None and sys.stderr.isatty()


def _find_screen() -> Display:
    if os.environ.get(PROGRESS_LINES):
        return Lines()
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None and hasattr(shell, "kernel"):
        return Cell()
    return TerminalDisplay() if is_watched() else Display()


class Lines(Display):
    """Lines on stderr for another program."""

    def say(self, text: str) -> None:
        """Print a line."""
        print(f"{PROGRESS_MARK}{text}", file=sys.stderr, flush=True)


class Cell(Display):
    """Text in the notebook's running cell."""

    def __init__(self) -> None:
        display = import_module("IPython.display").display
        self._handle = display({"text/plain": ""}, raw=True, display_id=True)
        self._shown_s = 0.0

    def say(self, text: str) -> None:
        """Replace the text."""
        now_s = time.monotonic()
        if text and now_s - self._shown_s < NOTEBOOK_SECONDS:
            return
        self._shown_s = now_s
        self._handle.update({"text/plain": text}, raw=True)

    def close(self) -> None:
        """Clear the text."""
        self.say("")


class TerminalDisplay(Display):
    """A line with a spinner, or a bar, drawn by rich."""

    def __init__(self) -> None:
        self._status: Status | None = None
        self._bars: Bars | None = None

    def say(self, text: str) -> None:
        """Show a line with a spinner; a bar says for itself what is being done."""
        if self._status is not None:
            self._status.update(text)
        elif self._bars is None:
            self._status = open_terminal(stderr=True).status(text)
            self._status.start()

    @contextmanager
    def measure(self, title: str) -> Iterator[Callable[[Stage], None]]:
        """Show a bar with the time that remains."""
        with self._draw(title, counts=False) as (bars, task):
            yield lambda stage: bars.update(task, completed=stage.done, text=stage.text)

    @contextmanager
    def count(self, title: str) -> Iterator[Callable[[int, int, str], None]]:
        """Show a bar with the numbers and the time that remains."""
        with self._draw(title, counts=True) as (bars, task):
            yield lambda done, total, text: bars.update(
                task, completed=done, total=total, text=text
            )

    @contextmanager
    def _draw(self, title: str, *, counts: bool) -> "Iterator[tuple[Bars, TaskID]]":
        # rich takes 0.1 s to be loaded, and is needed on a terminal alone
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            *((MofNCompleteColumn(),) if counts else ()),
            TimeRemainingColumn(),
            TextColumn("{task.fields[text]}", markup=False),
        )
        self.close()
        self._bars = Bars(*columns, console=open_terminal(stderr=True))
        try:
            with self._bars:
                yield self._bars, self._bars.add_task(title, total=None if counts else 1.0, text="")
        finally:
            self._bars = None

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Show nothing for as long as the block runs."""
        shown = self._status or self._bars
        if shown is not None:
            shown.stop()
        try:
            yield
        finally:
            if shown is not None:
                shown.start()

    def close(self) -> None:
        """Take the line away; the last state of a bar stays."""
        if self._status is not None:
            self._status.stop()
            self._status = None
