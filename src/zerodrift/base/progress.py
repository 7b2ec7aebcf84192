"""Progress in lines that another program reads, such as the page over the commands."""

import sys

PROGRESS_LINES = "ZERODRIFT_PROGRESS_LINES"
"""Environment variable: progress is told in lines that begin with PROGRESS_MARK."""
PROGRESS_MARK = "progress: "


def print_progress(text: str) -> None:
    """Print a line of progress for another program."""
    print(f"{PROGRESS_MARK}{text}", file=sys.stderr, flush=True)
