"""Files that are there entirely or not at all, and one message where they cannot be written."""

import errno
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from zerodrift.errors import InputError

_REMEDIES = {
    errno.ENOSPC: "Make room on that disk",
    errno.EDQUOT: "Make room in this user's quota",
    errno.EROFS: "Name a place that is not read-only",
    errno.EACCES: "Make the directory writable for this user",
    errno.EPERM: "Make the directory writable for this user",
    errno.EIO: "Look after that disk",
    errno.EFBIG: "Name a disk that takes files of this size",
    errno.ENAMETOOLONG: "Choose a shorter name",
}
"""What a disk answers when it does not take a file, and what helps."""
_KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def write_whole(path: Path, content: bytes) -> None:
    """Write one file; see `write_all`."""
    write_all({path: content})


def write_all(contents: Mapping[Path, bytes]) -> None:
    """Write files beside their places, all of them, and only then put each in its place.

    A disk that is full, an error or the end of the process leaves the old files, and nothing else.

    Args:
        contents: by the file; their directories exist.

    Raises:
        InputError: a directory is missing, may not be written to, or has no room.
    """
    ready: dict[Path, Path] = {}
    try:
        for path, content in contents.items():
            with telling_of_writes(path):
                handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
                ready[path] = Path(name)
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                # mkstemp makes files for the owner alone; an ordinary file follows the umask.
                ready[path].chmod(0o666 & ~_read_umask())
        for path, temporary in ready.items():
            with telling_of_writes(path):
                temporary.replace(path)
    finally:
        for temporary in ready.values():
            temporary.unlink(missing_ok=True)


@contextmanager
def telling_of_writes(path: Path) -> Iterator[None]:
    """Turn what a disk answers while something is written to `path` into one message."""
    try:
        yield
    except OSError as error:
        raise explain_write(path, error) from error


def make_directory(path: Path) -> None:
    """Make a directory and those above it.

    Raises:
        InputError: it cannot be made.
    """
    with telling_of_writes(path):
        path.mkdir(parents=True, exist_ok=True)


def explain_write(path: Path | str, error: OSError) -> InputError:
    """Return the error for a file or directory that could not be written."""
    remedy = _REMEDIES.get(error.errno or 0, "Check the directory")
    return InputError(
        f"{path}: cannot be written ({error.strerror or error}); expected a directory with room"
        f" that this user may write to. {remedy}, or name another by -C. Nothing was left"
        " half-written."
    )


def name_kind(path: Path) -> str:
    """Return what lies at a path, with its article: `a directory`, `a named pipe`, ..."""
    kind = stat.S_IFMT(path.stat().st_mode)
    return _KINDS.get(kind, "no ordinary file")


def is_refused_write(error: OSError) -> bool:
    """Tell whether an error is a disk's answer rather than a mistake in this program."""
    return error.errno in _REMEDIES


def _read_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
