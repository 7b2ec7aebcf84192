"""Changes several files together: all or none, whenever the process ends or the disk fails.

A change goes through these steps; its record is in `build/.zerodrift/` and is renamed on the way.

1. `ID.begin` names every file, the paths of its new and old contents, and their SHA-256.
2. The new contents are written beside the files, the old ones get a second name beside them.
3. `ID.begin` becomes `ID.forward`: from here on the change is decided.
4. Every new file is renamed into place; files that the change removes are removed.
5. The second names and the record are removed.

Whatever ends the process, the next command finds the record: before step 3 it removes what was
written, after it finishes the change. If the disk fails in step 4, the record becomes `ID.back`,
and the old contents are restored. After each step the data is flushed to the disk.
"""

import hashlib
import os
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.files import (
    AS_BEFORE,
    REMAINDER,
    explain_write,
    sync_directory,
    telling_of_writes,
    write_beside,
    write_whole,
)
from zerodrift.base.lock import (
    LOCK,
    STATE,
    clean_scratch,
    find_state,
    lock_project,
    take_turns,
    try_lock,
)
from zerodrift.base.records import from_json, read_sealed, render_sealed, to_dict
from zerodrift.base.terminal import tell

FORMAT = 1
BEGIN, FORWARD, BACK = ".begin", ".forward", ".back"
OLD = ".zd-old"
UNFINISHED = (
    "The change is not finished: the next zerodrift command on this project takes it back or ends"
    " it before it does anything else."
)
PATIENCE_S = 60.0
"""How long a reader waits for a writer that is putting files in their places."""
T = TypeVar("T")

_gathered: dict[Path, dict[Path, bytes | None]] = {}
"""Projects whose files are changed together at the end of a block -> what they will hold."""


@dataclass(frozen=True)
class _FileStep:
    """One file of a change."""

    path: str
    new: str
    """Path of the new contents until they are put in place; "" where the file is removed."""
    old: str
    """A second name of the old contents; "" where there was no file."""
    new_sha256: str
    old_sha256: str


@dataclass(frozen=True)
class _Record:
    """A change, as its record has it."""

    steps: tuple[_FileStep, ...]
    made: tuple[str, ...]
    """Directories that did not exist before, outermost first."""
    durable: bool

    def to_bytes(self, project: Path) -> bytes:
        """Return the record's file; names inside the project are relative to it, which may move."""

        def shorten(name: str) -> str:
            inside = name and Path(name).is_relative_to(project)
            return str(Path(name).relative_to(project)) if inside else name

        return render_sealed({"format": FORMAT, **to_dict(self._rename(shorten))})

    @classmethod
    def from_bytes(cls, content: bytes, project: Path) -> "_Record":
        """Return what `to_bytes` wrote.

        Raises:
            ValueError, KeyError, TypeError, AttributeError: it is incomplete.
        """
        body = read_sealed(content)
        if body.get("format") != FORMAT:
            raise ValueError(f"format {body.get('format')}")
        return from_json(cls, body)._rename(lambda name: str(project / name) if name else "")

    def _rename(self, change: Callable[[str], str]) -> "_Record":
        steps = tuple(
            replace(s, path=change(s.path), new=change(s.new), old=change(s.old))
            for s in self.steps
        )
        return replace(self, steps=steps, made=tuple(change(name) for name in self.made))

    @property
    def count(self) -> str:
        return "a file" if len(self.steps) == 1 else f"{len(self.steps)} files"

    @property
    def directories(self) -> list[Path]:
        return list(dict.fromkeys(Path(step.path).parent for step in self.steps))


def write_text(path: Path, text: str, project: Path | None = None) -> None:
    """Write a file whole or not at all, in UTF-8 with line feeds.

    Args:
        path: the file.
        text: its new content.
        project: the folder of zerodrift.toml, where the file is the project's own.

    Raises:
        InputError: the directory is missing, may not be written to, or has no room.
    """
    if project is None:
        write_whole(path, text.encode())
    else:
        write_all(project, {path: text.encode()})


def write_all(
    project: Path,
    contents: Mapping[Path, bytes | None],
    *,
    durable: bool = True,
    under_lock: bool = False,
    at_once: bool = False,
    patient: bool = True,
) -> None:
    """Change files together.

    Args:
        project: the folder of zerodrift.toml, which the record of the change lies below.
        contents: file -> its new content; None removes it. Directories are made.
        durable: False does not wait for the disk: the change survives a kill, but perhaps not a
            power failure.
        under_lock: another process holds the lock for this one.
        at_once: do not wait for the end of `change_together`.
        patient: wait for another command that holds the lock.

    Raises:
        InputError: something cannot be written; the message says how the files are now.
    """
    if not at_once and find_state(project) in _gathered:
        _gathered[find_state(project)].update(contents)
        return
    if under_lock:
        _change(find_state(project), contents, durable)
        return
    with hold_project(project, patient=patient):
        _change(find_state(project), contents, durable)


@contextmanager
def change_together(project: Path) -> Iterator[None]:
    """Collect the calls of `write_all` within this context, and write them at the end as one
    change.

    Raises:
        InputError: as `write_all`.
    """
    state = find_state(project)
    if state in _gathered:
        yield
        return
    with hold_project(project):
        contents = _gathered[state] = {}
        try:
            yield
        finally:
            del _gathered[state]
        _change(state, contents, durable=True)


@contextmanager
def gather_changes(project: Path) -> Iterator[dict[Path, bytes | None]]:
    """Collect the calls of `write_all` within this context, and write none of them.

    Yields:
        File -> its new content; None is for one that is removed.
    """
    state = find_state(project)
    contents = _gathered[state] = {}
    try:
        yield contents
    finally:
        del _gathered[state]


@contextmanager
def hold_project(project: Path, *, patient: bool = True) -> Iterator[None]:
    """Lock a project against other writers; first complete, or reverse, an interrupted change.

    Args:
        project: the folder of zerodrift.toml.
        patient: wait for another command that holds it.

    Raises:
        InputError: as `lock_project`; or an unfinished change can be neither completed nor
            reversed.
    """
    with lock_project(project, patient=patient):
        state = find_state(project)
        _recover(state)
        clean_scratch(state)
        yield


def settle_project(project: Path) -> None:
    """Complete or reverse an unfinished change before a command reads the project.

    Without one, this only lists one folder. It waits for a writer at work.

    Raises:
        InputError: a change is unfinished and the folder cannot be written.
    """
    state = find_state(project)
    for _ in take_turns(PATIENCE_S, 0.02):
        if not _list_records(state):
            return
        try:
            release = try_lock(state / LOCK)
        except FileNotFoundError:
            continue  # ended meanwhile
        except OSError as error:
            raise InputError(
                f"{state}: holds an unfinished change of this project's files"
                f" ({error.strerror or error}), so that they do not belong together; expected a"
                " folder that may be written. Run a command where the project may be written."
            ) from error
        if release is None:
            continue
        try:
            _recover(state)
        finally:
            release()
    if found := _list_records(state):
        raise InputError(
            f"{found[0]}: the change of files that it records has not ended for"
            f" {PATIENCE_S:g} s; expected a change of less than one. Run this again when the"
            " command that makes it is done, and look after the disk if none is."
        )


def read_together(project: Path, folders: Sequence[Path], read: Callable[[], T]) -> T:
    """Return what `read` returns, sure that no command changed its files meanwhile.

    Args:
        project: the folder of zerodrift.toml.
        folders: the folders of the files that belong together.
        read: reads them; called again where a change came between.

    Raises:
        InputError: as `settle_project`; or a change came between every time.
    """
    for _ in take_turns(PATIENCE_S, 0.02):
        settle_project(project)
        before = _mark_files(folders)
        try:
            found = read()
        except ZerodriftError:
            if before == _mark_files(folders):
                raise
            continue
        if before == _mark_files(folders):
            return found
    raise InputError(
        f"{', '.join(map(str, folders))}: files there have changed during every attempt to read"
        f" them for {PATIENCE_S:g} s; expected files that stay as they are for one. Run this again"
        " when the program that changes them is done."
    )


def _mark_files(folders: Sequence[Path]) -> frozenset[tuple[str, int, int]]:
    """Return names, inodes and times of the files in folders; any change alters them."""
    marks = set()
    for folder in folders:
        with suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_file():
                    stat = entry.stat()
                    marks.add((entry.path, stat.st_ino, stat.st_mtime_ns))
    return frozenset(marks)


def _change(state: Path, contents: Mapping[Path, bytes | None], durable: bool) -> None:
    """Go through the steps of one change."""
    if not contents:
        return
    name = secrets.token_hex(6)
    record = _plan(name, contents, durable)
    begin = state / f"{name}{BEGIN}"
    place = state
    forward = begin.with_suffix(FORWARD)
    try:
        state.mkdir(parents=True, exist_ok=True)
        write_beside(begin, record.to_bytes(_find_project(state)), like=begin, durable=durable)
        for directory in record.made:
            place = Path(directory)
            place.mkdir(exist_ok=True)
        for step, content in zip(record.steps, contents.values(), strict=True):
            place = Path(step.path)
            if content is not None:
                write_beside(Path(step.new), content, like=place, durable=durable)
            if step.old:
                _keep_old(place, Path(step.old), durable)
        _sync(record, [*(Path(d).parent for d in record.made), *record.directories, state])
        place = state
        begin.replace(forward)
        _sync(record, [state])
        for step in record.steps:
            place = Path(step.path)
            _put(step)
        _sync(record, record.directories)
    except BaseException as error:
        told = _take_back(begin, record, forward.exists())
        if isinstance(error, OSError):
            raise explain_write(place, error, told) from error
        raise
    _clean(forward, record)


def _plan(name: str, contents: Mapping[Path, bytes | None], durable: bool) -> _Record:
    """Return what a change will do, before it does anything.

    Raises:
        InputError: a path to be written is something other than a file.
    """
    steps = []
    made: dict[str, None] = {}
    for number, (given, content) in enumerate(contents.items()):
        path = Path(os.path.realpath(given))
        if path.is_dir():
            raise InputError(
                f"{given}: is a directory; expected a file, or nothing, in this place. Move it"
                f" away, or name another by -C. {AS_BEFORE}"
            )
        with telling_of_writes(given):
            there = path.exists()
            old_sha256 = _hash(path) if there else ""
            missing = [p for p in (path.parent, *path.parent.parents) if not p.exists()]
        made |= dict.fromkeys(str(p) for p in reversed(missing))
        stem = str(path.with_name(f".{name}.{number}"))
        steps.append(
            _FileStep(
                path=str(path),
                new="" if content is None else stem + REMAINDER,
                old=stem + OLD if there else "",
                new_sha256="" if content is None else hashlib.sha256(content).hexdigest(),
                old_sha256=old_sha256,
            )
        )
    return _Record(tuple(steps), tuple(made), durable)


def _keep_old(path: Path, old: Path, durable: bool) -> None:
    """Give the old contents a second name; where the file system has none, a copy."""
    try:
        os.link(path, old)
    except OSError:
        old.unlink(missing_ok=True)
        write_beside(old, path.read_bytes(), like=path, durable=durable)


def _put(step: _FileStep) -> None:
    """Put one file in its place, or remove it."""
    if step.new:
        os.replace(step.new, step.path)  # noqa: PTH105 - a string from the record
    else:
        Path(step.path).unlink(missing_ok=True)


def _take_back(begin: Path, record: _Record, decided: bool) -> str:
    """Restore the old contents after a failure; return a sentence on how the files are now."""
    try:
        if not decided:
            _clean(begin, record)
            _remove_made(record)
            return AS_BEFORE
        back = begin.with_suffix(BACK)
        begin.with_suffix(FORWARD).replace(back)
        _return_old(record)
        with suppress(OSError):
            _sync(record, record.directories)
        _clean(back, record)
        _remove_made(record)
    except OSError:
        return (
            UNFINISHED if decided else f"{AS_BEFORE} What is left is removed by the next command."
        )
    return AS_BEFORE


def _return_old(record: _Record) -> list[str]:
    """Restore the old contents; return the files that somebody else has changed since."""
    foreign = []
    for step in reversed(record.steps):
        path = Path(step.path)
        found = _hash(path) if path.is_file() else ""
        if found == step.old_sha256:
            continue
        if found != step.new_sha256:
            foreign.append(step.path)
        elif step.old:
            os.replace(step.old, path)  # noqa: PTH105 - a string from the record
        else:
            path.unlink()
    return foreign


def _clean(place: Path, record: _Record) -> None:
    """Remove second names and what was not put in place, then the record; the files stay.

    The next command repeats what fails here.
    """
    with suppress(OSError):
        for step in record.steps:
            for name in (step.new, step.old):
                if name:
                    Path(name).unlink(missing_ok=True)
        place.unlink(missing_ok=True)
        _sync(record, [place.parent])


def _remove_made(record: _Record) -> None:
    """Remove the directories that a reversed change has made."""
    with suppress(OSError):
        for directory in reversed(record.made):
            Path(directory).rmdir()


def _list_records(state: Path) -> list[Path]:
    """Return the records of changes that are decided, which a reader must not read through."""
    return [p for p in _list_state(state) if p.suffix in (FORWARD, BACK)]


def _list_state(state: Path) -> list[Path]:
    try:
        return sorted(state.iterdir())
    except OSError:
        return []


def _recover(state: Path) -> None:
    """Complete or reverse every unfinished change; the lock is held.

    Raises:
        InputError: the disk fails.
    """
    for place in _list_state(state):
        if place.suffix in (BEGIN, FORWARD, BACK):
            with telling_of_writes(place):
                try:
                    record = _Record.from_bytes(place.read_bytes(), _find_project(state))
                except (ValueError, KeyError, TypeError, AttributeError):
                    # An incomplete record: nothing else was begun either.
                    place.unlink(missing_ok=True)
                    continue
                _end(place, record)


def _end(place: Path, record: _Record) -> None:
    """Complete one change, or reverse it, and say so."""
    is_done = place.suffix == FORWARD and _finish(record)
    if is_done:
        tell(f"a command that was cut off was changing {record.count}; that is done now")
    elif place.suffix != BEGIN:
        back = place.with_suffix(BACK)
        place.replace(back)
        place = back
        kept = "".join(f"; {name} was edited since and stays" for name in _return_old(record))
        tell(f"a command that was cut off was changing {record.count}; taken back{kept}")
    _sync(record, [d for d in record.directories if d.is_dir()])
    _clean(place, record)
    if not is_done:
        _remove_made(record)


def _finish(record: _Record) -> bool:
    """Put the remaining files in place; return False where that is not possible as planned.

    A file that somebody has edited since is not replaced, nor are contents used that differ from
    those that were written.
    """
    waiting = [step for step in record.steps if not _is_put(step)]
    for step in waiting:
        path = Path(step.path)
        found = _hash(path) if path.is_file() else ""
        new = _hash(Path(step.new)) if step.new and Path(step.new).is_file() else ""
        if found not in (step.old_sha256, step.new_sha256) or new != step.new_sha256:
            return False
    for step in waiting:
        _put(step)
    return True


def _is_put(step: _FileStep) -> bool:
    """Return whether a file was put in place, whatever happened to it afterwards."""
    return not Path(step.new).exists() if step.new else not Path(step.path).exists()


def _find_project(state: Path) -> Path:
    return state.parents[len(STATE.parts) - 1]


def _sync(record: _Record, directories: list[Path]) -> None:
    if record.durable:
        for directory in directories:
            sync_directory(directory)


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
