"""One writer at a time on a project; the next one waits, and prints for whom.

The lock is a file in `build/.zerodrift/`, held by the operating system for as long as the process
lives, so that a kill frees it.
"""

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.files import find_dangling, telling_of_writes
from zerodrift.base.records import from_json, to_dict

STATE = Path("build") / ".zerodrift"
"""Below the project: the lock, changes under way, scratch folders."""
LOCK, HOLDER = "lock", "holder.json"
WAIT_VARIABLE = "ZERODRIFT_WAIT_S"
WAIT_S = 600.0
"""How long a second writer waits, unless the variable says otherwise."""
POLL_S = 0.1
REMOVAL_S = 0.5
"""How long the folder may be missing again and again, as it is while a holder leaves, who removes
two names; a folder that cannot be made there at all is told after this time."""
LONGEST_COMMAND = 120

_held: dict[Path, int] = {}
"""Projects that this process holds -> how many times over."""


def find_state(project: Path) -> Path:
    """Return the folder of a project's lock and journal."""
    return Path(os.path.realpath(project)) / STATE


@contextmanager
def lock_project(project: Path, *, patient: bool = True) -> Iterator[None]:
    """Hold a project against other writers; within one process it may be held several times over.

    Args:
        project: the folder of zerodrift.toml.
        patient: wait for another process that holds it.

    Raises:
        InputError: another process held it the whole time, or the folder cannot be written.
    """
    state = find_state(project)
    if _held.get(state):
        _held[state] += 1
        try:
            yield
        finally:
            _held[state] -= 1
        return
    wait_s = _read_wait() if patient else 0.0
    is_told = not patient
    release = None
    for _ in take_turns(wait_s):
        release = _open_lock(state)
        if release is not None:
            break
        if not is_told:
            tell(f"waiting for {describe_holder(state)}, up to {wait_s:g} s")
            is_told = True
    if release is None:
        raise InputError(
            f"{project}: is being changed by {describe_holder(state)}; waited {wait_s:g} s for"
            f" it. Run this again when that is done, or set {WAIT_VARIABLE} to wait longer."
            " Nothing was changed."
        )
    _held[state] = 1
    try:
        _sign(state)
        yield
    finally:
        del _held[state]
        _leave(state)
        release()


def take_turns(wait_s: float, poll_s: float = POLL_S) -> Iterator[None]:
    """Yield at once, then after each sleep until a deadline: every loop that waits is one of these.

    Args:
        wait_s: from now to the last turn; 0 is one turn.
        poll_s: length of a sleep.
    """
    deadline = time.monotonic() + wait_s
    while True:
        yield
        if time.monotonic() >= deadline:
            return
        time.sleep(poll_s)


def _open_lock(state: Path) -> Callable[[], None] | None:
    """Make the folder of the lock and take it; None where another process holds it.

    Raises:
        InputError: the folder cannot be made or written.
    """
    with telling_of_writes(state):
        gone: OSError | None = None
        for _ in take_turns(REMOVAL_S, REMOVAL_S / 20.0):
            try:
                state.mkdir(parents=True, exist_ok=True)
                return try_lock(state / LOCK)
            except (FileNotFoundError, FileExistsError, NotADirectoryError) as error:
                for folder in (state.parent, state):
                    if folder.exists() and not folder.is_dir():
                        raise InputError(
                            f"{folder}: is a file; expected a folder, or nothing, where zerodrift"
                            " keeps what it computes. Move the file away."
                        ) from None
                if isinstance(error, NotADirectoryError) or find_dangling(state) is not None:
                    raise
                gone = error  # the last holder was removing the empty folder; or it cannot be
        assert gone is not None
        raise gone


def try_lock(path: Path) -> Callable[[], None] | None:
    """Return the function that releases the lock, or None where another process holds it.

    Raises:
        OSError: the file cannot be made.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock.release


@dataclass(frozen=True)
class _Holder:
    """Who holds the lock."""

    process: int
    machine: str
    command: str
    since: str


def describe_holder(state: Path) -> str:
    """Return who holds the lock, as far as its file says."""
    try:
        told = from_json(_Holder, json.loads((state / HOLDER).read_text(encoding="utf-8")))
        return f"`{told.command}` (process {told.process} on {told.machine}, since {told.since})"
    except (OSError, ValueError):
        return "another zerodrift command"


def _sign(state: Path) -> None:
    """Write who holds the lock; a failure to write is ignored."""
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:LONGEST_COMMAND]
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    told = to_dict(_Holder(os.getpid(), platform.node(), command, since))
    with suppress(OSError):
        (state / HOLDER).write_text(json.dumps(told) + "\n", encoding="utf-8")


def _leave(state: Path) -> None:
    """Remove the folder if it is empty; the lock is still held.

    A process that has opened the lock already finds that it is gone, and starts again.
    """
    with suppress(OSError):
        (state / HOLDER).unlink(missing_ok=True)
        (state / LOCK).unlink(missing_ok=True)
        state.rmdir()
        state.parent.rmdir()


def _read_wait() -> float:
    text = os.environ.get(WAIT_VARIABLE, "")
    try:
        value = float(text) if text else WAIT_S
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise InputError(
            f"{WAIT_VARIABLE}={text}: expected a number of seconds, 0 or more, such as 60."
        )
    return value


def tell(text: str) -> None:
    """Print to stderr without buffering; stdout has the command's result only."""
    print(f"note: {text}", file=sys.stderr, flush=True)
