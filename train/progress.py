"""A progress bar on stderr for anything that takes longer than a moment."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from zerodrift.base.progress import is_watched, open_text_progress
from zerodrift.base.terminal import open_terminal
from zerodrift.train.scores import Stage


@contextmanager
def show_progress(title: str) -> Iterator[Callable[[Stage], None]]:
    """Show a bar while the block runs; yields what is called with each stage.

    Where stderr is no terminal nothing is shown, or text (`base.progress`).
    """
    with open_text_progress() as show:
        if show is not None:
            yield lambda stage: show(f"{title}, {100.0 * stage.done:.0f} %: {stage.text}")
            return
    console = open_terminal(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}", markup=False),
    )
    with Progress(*columns, console=console, disable=not is_watched()) as progress:
        task = progress.add_task(title, total=1.0, text="fitting physics")

        def report(stage: Stage) -> None:
            progress.update(task, completed=stage.done, text=stage.text)

        yield report
