"""One workbench at a time on a directory."""

import os
from pathlib import Path

from zerodrift.base.errors import InputError


def hold_directory(directory: Path) -> int | None:
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


def release_directory(handle: int | None) -> None:
    """Let others hold a directory again."""
    if handle is not None:
        os.close(handle)
