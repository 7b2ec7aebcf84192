"""Files: written whole or not at all, and which of a folder's are zerodrift's own."""

import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from zerodrift.base.errors import InputError

# Writes one file as a whole or not at all, with one message where it cannot be written.
#
# Files that belong together are changed together by `zerodrift.base.journal`.

NOT_THERE = (FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Answers of the system that say that there is no such file; any other says nothing of it."""
REMAINDER = ".zd-new"
"""End of the name of a file that is not in its place yet."""
AS_BEFORE = "Every file is as it was before."
NOTHING_HALF = "No file was left half-written."
_REMEDIES = {
    errno.ENOSPC: "Make room on that disk",
    errno.EDQUOT: "Make room in this user's quota",
    errno.EROFS: "Name a place that is not read-only",
    errno.EACCES: "Make the directory writable for this user",
    errno.EPERM: "Make the directory writable for this user",
    errno.EIO: "Look after that disk",
    errno.EFBIG: "Name a disk that takes files of this size",
    errno.ENAMETOOLONG: "Choose a shorter name",
    errno.EMFILE: "Allow this process more open files (ulimit -n)",
    errno.ENFILE: "Close programs: this machine has too many files open",
    errno.EISDIR: "Move the directory of that name away",
    errno.ENOTDIR: "Move the file away that stands where a directory is needed",
    errno.EEXIST: "Move away what stands there",
}
"""What a disk answers when it does not take a file, and what helps."""
_OF_WRITES = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EEXIST}
_KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def write_whole(path: Path, content: bytes) -> None:
    """Write one file under another name beside it, then rename it.

    After a full disk, an error or the end of the process the old file remains. For the files of a
    project see `zerodrift.base.journal.write_all`.

    Raises:
        InputError: the directory is missing, may not be written to, or has no room.
    """
    with telling_of_writes(path):
        place = Path(os.path.realpath(path))
        temporary = name_beside(place)
        try:
            write_beside(temporary, content, like=place)
            temporary.replace(place)
            with suppress(OSError):
                sync_directory(place.parent)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def name_beside(path: Path) -> Path:
    """Return a temporary name beside a file; remove leftovers of writers that were killed."""
    for left in path.parent.glob(f".{_escape(path.name)}.*{REMAINDER}"):
        left.unlink(missing_ok=True)
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{REMAINDER}")


def write_new(path: Path, content: bytes) -> None:
    """Write a new file as a whole, unless it exists already.

    Of two processes the first one's file stays. On a file system without links, the later of two
    that start at the same time may replace the first.

    Raises:
        InputError: the directory is missing, may not be written to, or has no room.
    """
    with telling_of_writes(path):
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}{REMAINDER}")
        try:
            if not path.exists():
                write_beside(temporary, content, like=path)
                _link(temporary, path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        for left in path.parent.glob(f".{_escape(path.name)}.*{REMAINDER}"):
            left.unlink(missing_ok=True)


def _link(temporary: Path, path: Path) -> None:
    """Give a new file its name, if nothing has it."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        pass
    except OSError:  # a file system without links, or another process has cleaned up
        if not path.exists():
            temporary.replace(path)


def write_beside(path: Path, content: bytes, *, like: Path, durable: bool = True) -> None:
    """Write a new file and wait until the disk has it.

    Args:
        path: of the new file, which must not be there.
        content: its bytes.
        like: the file whose permissions it takes, where that exists.
        durable: False does not wait for the disk.
    """
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
        file.flush()
        if durable:
            os.fsync(file.fileno())
    with suppress(OSError):  # a file system without permissions, or no file there yet
        shutil.copymode(like, path)


def sync_directory(directory: Path) -> None:
    """Wait until a directory's names are on the disk; does nothing where that is not supported."""
    if os.name == "nt":
        return
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (
            errno.EINVAL,
            errno.ENOTSUP,
        ):  # file systems that need no such call
            raise
    finally:
        os.close(handle)


@contextmanager
def telling_of_writes(path: Path) -> Iterator[None]:
    """Turn an OSError while `path` is written into one message."""
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


def explain_write(path: Path | str, error: OSError, state: str = AS_BEFORE) -> InputError:
    """Return the error for a file or directory that could not be written.

    Args:
        path: what was to be written.
        error: the system's error.
        state: a sentence on how the files are now.
    """
    remedy = _REMEDIES.get(error.errno or 0, "Check the directory")
    if (link := find_dangling(Path(path))) is not None:
        return InputError(
            f"{path}: cannot be written: {link} is a link to {os.readlink(link)}, which is not"  # noqa: PTH115
            f" there; expected a directory. Mount or make it, or remove the link. {state}"
        )
    return InputError(
        f"{path}: cannot be written ({error.strerror or error}); expected a directory with room"
        f" that this user may write to. {remedy}, or name another by -C. {state}"
    )


def find_dangling(path: Path) -> Path | None:
    """Return the link on the way to a path that leads nowhere, if there is one."""
    for place in (path, *path.parents):
        with suppress(OSError):
            if place.is_symlink() and not place.exists():
                return place
    return None


def name_kind(path: Path) -> str:
    """Return the kind of what is at a path, with its article: `a directory`, `a named pipe`, ..."""
    kind = stat.S_IFMT(path.stat().st_mode)
    return _KINDS.get(kind, "no ordinary file")


def explain_refusal(error: OSError) -> str | None:
    """Return the text for an error of the system on a file; None if it is another error.

    Reading and writing have the same errors (EIO, EMFILE, EACCES), so the text claims neither.
    Polars has the system's error in its text only: "Too many open files (os error 24): PATH".
    """
    place, answer = error.filename, error.strerror
    if found := re.fullmatch(r"(.+) \(os error \d+\): (.+)", str(error)):
        answer, place = found.groups()
    if is_vanished():
        return (
            "the current directory was removed, or its disk was taken away; expected one that is"
            " there. Change to another, by `cd`, and run the command again. Nothing was changed."
        )
    if not place and error.errno not in _REMEDIES:
        return None
    place = place or f"standard output, or a file in {tempfile.gettempdir()}"
    return (
        f"{place}: cannot be opened, read or written ({answer}); expected a file that the system"
        f" hands out. {NOTHING_HALF} See to the disk, to the rights, or to the limit on open files"
        " (ulimit -n), and run the command again."
    )


def show_path(path: Path, directory: Path) -> str:
    """Return a path relative to the project where it lies inside it."""
    return str(path.relative_to(directory)) if path.is_relative_to(directory) else str(path)


def is_vanished() -> bool:
    """Tell whether the current directory is gone, so that no relative name stands for a file."""
    try:
        Path.cwd()
    except OSError:
        return True
    return False


def is_refused_write(error: OSError) -> bool:
    """Tell whether an error is one that only writing can raise."""
    return error.errno in _OF_WRITES


def _escape(name: str) -> str:
    """Return a name with the special characters of `glob` escaped."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


# Which files of a folder zerodrift wrote; no others are replaced or removed.
#
# A file is ours if the folder's `manifest.json` lists it, or, in folders from before manifests, if
# it carries in its first lines what the generator writes there.

MANIFEST = "manifest.json"
LISTED = "firmware"
"""Key of a manifest: path relative to it -> SHA-256."""
FIRST_BYTES = 600
MARKS = (
    re.compile(rb"generated by zerodrift |zerodrift runtime: |Written by zerodrift "),
    re.compile(rb'\AVERSION "[0-9a-f]{16}"\s+NS_ :\s+BS_:\s+BU_: SENSOR\s'),
)
KEYS = ({"model", "bounds"}, {"model", "firmware"}, {"design", "model_hash"})
"""Of JSON files: certificates, manifests, a fleet's parameters."""


def refuse_foreign(contents: Iterable[Path], folder: Path) -> None:
    """Refuse to replace what zerodrift did not write.

    Args:
        contents: files that are to be written below the folder.
        folder: the folder of its own that they belong to, with its manifest.

    Raises:
        InputError: one of them exists and zerodrift did not write it.
    """
    listed = list_own(folder)
    for path in contents:
        if path.is_file() and _name(path, folder) not in listed and not carries_mark(path):
            raise InputError(
                f"{path}: is there and was not written by zerodrift; expected a folder of its own"
                f" for what is generated. Move the file away, or name another folder than"
                f" {folder.name} by `out` under [firmware]. Nothing was written."
            )


def list_own(folder: Path) -> frozenset[str]:
    """Return the names in a folder's manifest, itself included; none without one of ours.

    Raises:
        OSError: it exists and cannot be read.
    """
    try:
        content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        if not _is_own(content):
            return frozenset()
        return frozenset((*map(str, content[LISTED]), MANIFEST))
    except (*NOT_THERE, ValueError, KeyError, TypeError, RecursionError):
        return frozenset()


def carries_mark(path: Path) -> bool:
    """Return whether a file says in itself that zerodrift wrote it.

    Raises:
        OSError: it cannot be read.
    """
    try:
        if path.suffix == ".json":
            return _is_own(json.loads(path.read_text(encoding="utf-8")))
        with path.open("rb") as file:
            start = file.read(FIRST_BYTES)
    except (ValueError, RecursionError):
        return False
    return any(mark.search(start) for mark in MARKS)


def render_manifest(files: Mapping[str, bytes], **told: object) -> bytes:
    """Return a manifest of files by their names below its folder.

    Args:
        files: name -> content.
        told: further entries; `model` marks the manifest as one of ours.
    """
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}
    return (json.dumps({"format": 1, **told, LISTED: hashes}, indent=1) + "\n").encode()


def _is_own(content: object) -> bool:
    return isinstance(content, dict) and any(keys <= content.keys() for keys in KEYS)


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)
