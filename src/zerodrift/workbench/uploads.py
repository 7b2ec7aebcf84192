"""Logs that are dropped on the page: into logs/, whole or not at all, replacing nothing."""

from pathlib import Path
from typing import IO

from zerodrift.base.errors import InputError
from zerodrift.dataset.selectors import list_suffixes

LOGS = "logs"
LARGEST_UPLOAD = 1 << 30
"""Bytes; larger logs are put into the project's folder by other means."""
CHUNK = 1 << 20
LONGEST_NAME = 255
"""Bytes of a file's name that every usual file system takes."""
PART = "..part"
"""What the name of a file has more while it arrives."""


def place_upload(directory: Path, name: str, size: int | None) -> Path:
    """Return where a dropped log goes: into logs/, under its own name.

    Args:
        directory: of the project.
        name: of the file, as the browser tells it.
        size: bytes; None where the browser does not tell.

    Raises:
        InputError: the name or the size is not one that can be taken.
    """
    if size is None or size > LARGEST_UPLOAD:
        told = "of unknown size" if size is None else f"{size / 1e9:.1f} GB"
        raise InputError(
            f"{name}: is {told}; the page takes files up to {LARGEST_UPLOAD / 1e9:.1f} GB. "
            f"Copy it into {directory / LOGS} and choose it there."
        )
    plain = Path(name.replace("\\", "/")).name
    if plain != name or not plain or plain.startswith("."):
        raise InputError(f"{name!r}: is no plain file name; expected one without folders.")
    if Path(plain).suffix.lower() not in list_suffixes():
        raise InputError(f"{plain}: is no log; expected one of {', '.join(list_suffixes())}.")
    longest = LONGEST_NAME - len(PART)
    if len(plain.encode()) > longest:
        raise InputError(
            f"{plain[:40]}…: its name has {len(plain.encode())} bytes; expected at most {longest}. "
            "Rename the file."
        )
    target = directory / LOGS / plain
    if target.exists():
        raise InputError(f"{LOGS}/{plain}: exists already; rename the one that you drop.")
    return target


def list_logs(directory: Path) -> list[str]:
    """Return the logs in a directory and its logs/, relative to it."""
    found = [
        path
        for place in (directory, directory / LOGS)
        if place.is_dir()
        for path in sorted(place.iterdir())
        if path.suffix.lower() in list_suffixes() and path.is_file()
    ]
    return [path.relative_to(directory).as_posix() for path in found]


def receive(stream: IO[bytes], target: Path, size: int) -> None:
    """Write what is sent to a file, whole or not at all.

    Raises:
        InputError: it ended early, or cannot be written to the disk.
    """
    part = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(exist_ok=True)
        got = 0
        with part.open("wb") as file:
            while chunk := stream.read(CHUNK):
                file.write(chunk)
                got += len(chunk)
        if got != size:
            raise InputError(f"{target.name}: {got} of {size} bytes arrived; drop the file again.")
        part.replace(target)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); nothing of it was kept. Make "
            "room, or make the directory writable."
        ) from error
    finally:
        part.unlink(missing_ok=True)
