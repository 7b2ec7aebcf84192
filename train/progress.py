"""A progress bar on stderr for anything that takes longer than a moment."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from zerodrift.train.scores import Stage

LINES = "ZERODRIFT_PROGRESS_LINES"
"""Environment variable: progress is told in lines that begin with `progress: `."""


@contextmanager
def show_progress(title: str) -> Iterator[Callable[[Stage], None]]:
    """Show a bar while the block runs; yields what is called with each stage.

    Where stderr is no terminal nothing is shown, or lines for another program (`LINES`).
    """
    if os.environ.get(LINES):

        def tell(stage: Stage) -> None:
            text = f"{title}, {100.0 * stage.done:.0f} %: {stage.text}"
            print(f"progress: {text}", file=sys.stderr, flush=True)

        yield tell
        return
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=1.0, text="fitting physics")

        def report(stage: Stage) -> None:
            progress.update(task, completed=stage.done, text=stage.text)

        yield report
