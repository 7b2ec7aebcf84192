"""Where progress goes: a terminal, a notebook's cell, or lines that another program reads."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module

PROGRESS_LINES = "ZERODRIFT_PROGRESS_LINES"
"""Environment variable: progress is told in lines that begin with PROGRESS_MARK."""
PROGRESS_MARK = "progress: "
NOTEBOOK_SECONDS = 0.2
"""Between two texts in a notebook."""


def print_progress(text: str) -> None:
    """Print a line of progress for another program."""
    print(f"{PROGRESS_MARK}{text}", file=sys.stderr, flush=True)


def is_watched() -> bool:
    """Return whether stderr is a terminal; a colour that is forced on a pipe makes it none."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def open_text_progress() -> Iterator[Callable[[str], None] | None]:
    """Yield a function that shows progress as text, for `PROGRESS_LINES` or a notebook.

    None elsewhere: a terminal has a progress bar, and a pipe needs none.
    """
    if os.environ.get(PROGRESS_LINES):
        yield print_progress
        return
    show = _find_notebook()
    if show is None:
        yield None
        return
    try:
        yield show
    finally:
        show("")


def _find_notebook() -> Callable[[str], None] | None:
    """Return a function that writes into the notebook's running cell; "" clears it."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None or not hasattr(shell, "kernel"):
        return None
    display = import_module("IPython.display").display
    handle = display({"text/plain": ""}, raw=True, display_id=True)
    shown_s = 0.0

    def show(text: str) -> None:
        nonlocal shown_s
        now_s = time.monotonic()
        if text and now_s - shown_s < NOTEBOOK_SECONDS:
            return
        shown_s = now_s
        handle.update({"text/plain": text}, raw=True)

    return show
