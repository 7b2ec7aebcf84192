"""Taking a change back: zerodrift.toml and the history as they were before it."""

from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import FILE_NAME
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.diagnosis.history import FILE_NAME as HISTORY


@dataclass(frozen=True)
class Snapshot:
    """The files that `add` and `remove` change, as they were."""

    text: bytes
    history: bytes | None


@dataclass(frozen=True)
class Undo:
    """The files before a change, and zerodrift.toml as the change left it."""

    title: str
    before: Snapshot
    text_after: bytes


def take_snapshot(directory: Path) -> Snapshot:
    """Return the files of a project as they are now.

    Raises:
        InputError: zerodrift.toml cannot be read.
    """
    history = directory / "build" / HISTORY
    try:
        return Snapshot(
            (directory / FILE_NAME).read_bytes(),
            history.read_bytes() if history.exists() else None,
        )
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror}).") from error


def take_back(directory: Path, last: Undo) -> None:
    """Put the files back, both or neither.

    Raises:
        InputError: zerodrift.toml was edited since, or a file cannot be written.
    """
    toml, history = directory / FILE_NAME, directory / "build" / HISTORY
    try:
        is_edited = toml.read_bytes() != last.text_after
    except OSError:
        is_edited = True
    if is_edited:
        raise InputError(
            f"{FILE_NAME} was edited since; undoing would lose that. Edit it by hand, or use "
            "Remove."
        )
    try:
        write_all(directory, {toml: last.before.text, history: last.before.history})
    except (OSError, InputError) as error:
        raise InputError(f"Undo failed: {error}") from error
