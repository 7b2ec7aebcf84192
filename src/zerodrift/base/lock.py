"""One writer at a time on a project, and folders for one command's work."""

import json
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.files import (
    REMAINDER,
    explain_write,
    find_dangling,
    is_refused_write,
    telling_of_writes,
)
from zerodrift.base.records import from_json, to_dict
from zerodrift.base.terminal import tell

# One writer at a time on a project; the next one waits, and prints for whom.
#
# The lock is a file in `build/.zerodrift/`, held by the operating system for as long as the process
# lives, so that a kill frees it.

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


# Folders for the work of one command, which the next command removes if a kill left them.
#
# They are in the project, since libraries that are built there are also loaded from there, which
# the system's folder for temporary files may forbid.

_PLAIN = re.compile(r"[^%\\\"'`$\x00-\x1f\x7f]*" if os.sep == "/" else r"[^%\"'`$\x00-\x1f\x7f]*")
"""Without what a compiler's command line or its list of dependencies gives a meaning to."""
IN_USE = ".in-use"
SCRATCH = "scratch-"
FORSAKEN_S = 3600.0
"""Age at which folders of earlier versions are removed, which do not say if they are in use."""
EARLIER_FOLDERS = {
    "": re.compile(r"\.(report|twin)-[a-z0-9_]{8}"),
    "build": re.compile(r"\.(firmware|verify)-[a-z0-9_]{8}"),
    "firmware/packages": re.compile(r"\.staging-[a-z0-9_]{8}"),
}
"""Folder -> names of scratch folders that earlier versions made there."""
EARLIER_FILES = {
    "": re.compile(r"\.zerodrift\.toml\.[a-z0-9_]{8}"),
    "build": re.compile(r"\.[\w.-]+\.(json|npz|onnx)\.[a-z0-9_]{8}|\.history\.json\.kept"),
    "firmware": re.compile(r"\.[\w.-]+\.(h|c|json|dbc)\.(?=[a-z]*[0-9_])[a-z0-9_]{8}"),
}
"""Folder -> names that earlier versions gave to files which were not in their places yet."""


@contextmanager
def make_scratch(project: Path) -> Iterator[Path]:
    """Make a temporary folder that every compiler can work in.

    It is in the project where that can be written and compilers accept its path, else in the
    system's folder for temporary files.

    Args:
        project: the folder of zerodrift.toml.

    Raises:
        InputError: within this context a file was written, and the disk has no room for it.
    """
    state = find_state(project)
    try:
        if not _PLAIN.fullmatch(str(state)):
            raise OSError
        state.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(prefix=SCRATCH, dir=state, ignore_cleanup_errors=True)
    except OSError:
        folder = tempfile.TemporaryDirectory(prefix="zerodrift-", ignore_cleanup_errors=True)
    try:
        with folder as name:
            release = try_lock(Path(name) / IN_USE)
            try:
                yield Path(name)
            except OSError as error:
                if (
                    is_refused_write(error) and not error.filename
                ):  # of a write the system tells none
                    raise explain_write(name, error) from error
                raise
            finally:
                if release is not None:
                    release()
    finally:
        with suppress(OSError):
            state.rmdir()
            state.parent.rmdir()


def clean_scratch(state: Path) -> None:
    """Remove what killed commands have left in a project's build/; its lock is held."""
    build = state.parent
    with suppress(OSError):
        for folder in state.glob(f"{SCRATCH}*"):
            release = try_lock(folder / IN_USE)
            if release is not None:
                release()
                shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        for folder in (build.parent, build):
            for path in folder.glob(f".*{REMAINDER}"):
                path.unlink(missing_ok=True)
    for name, pattern in EARLIER_FOLDERS.items():
        with suppress(OSError):
            for path in (build.parent / name).glob(".*-*"):
                is_old = path.lstat().st_mtime < time.time() - FORSAKEN_S
                if pattern.fullmatch(path.name) and path.is_dir() and is_old:
                    shutil.rmtree(path, ignore_errors=True)
    for name, pattern in EARLIER_FILES.items():
        with suppress(OSError):
            for path in (build.parent / name).glob(".*"):
                if pattern.fullmatch(path.name) and path.is_file():
                    path.unlink(missing_ok=True)
