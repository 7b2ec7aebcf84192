"""What stands beside the page: recordings, as recorders tell of themselves, and the registry."""

import time
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.dataset.selectors import matches_logs
from zerodrift.field.registry import FILE_NAME, Event, UnitStanding, open_registry
from zerodrift.fleet.sensors import load_unit
from zerodrift.recording.status import (
    ENDED,
    RecordingStatus,
    list_statuses,
    name_status,
)


@dataclass(frozen=True)
class WatchedRecording:
    """A recording as the page shows it."""

    file: str
    """The log, an absolute path."""
    name: str
    """The log, as people know it."""
    state: str
    """live | stuck | cut off | ended."""
    status: RecordingStatus
    is_named: bool
    """Whether it has ended and [logs] selects it."""


class RecordingWatch:
    """The recordings of a project."""

    def __init__(self, directory: Path, sensor: str | None = None) -> None:
        self._directory, self._sensor = directory, sensor
        self._compared: frozenset[str] = frozenset()
        """Logs of recordings that had ended when the project was looked at last."""

    def look(self) -> tuple[WatchedRecording, ...]:
        """Return the recordings as they are now, those that have ended at the end."""
        found = list(self._find().values())
        return tuple(sorted(found, key=lambda one: (one.state == ENDED, one.file)))

    def list_logs(self) -> frozenset[Path]:
        """Return the logs that are recorded, or were and have not been looked at since."""
        files = {one.file for one in self._find().values()} - self._compared
        return frozenset(Path(file) for file in files)

    def begin_look(self) -> None:
        """Note that the project is looked at."""
        ended = (one.file for one in self._find().values() if one.state == ENDED)
        self._compared = frozenset(ended)

    def end_look(self, known: frozenset[Path]) -> None:
        """Forget recordings that had ended before a look, and that were found in it.

        Args:
            known: files that the findings are of.
        """
        for file in self._compared:
            if Path(file) in known:
                self._find_path(file).unlink(missing_ok=True)

    def forget(self, file: str) -> None:
        """Forget a recording.

        Raises:
            InputError: there is no recording of that log.
        """
        self.check(file)
        self._find_path(file).unlink(missing_ok=True)

    def check(self, file: str) -> None:
        """Refuse a log that no recording is of.

        Raises:
            InputError: there is no recording of that log.
        """
        if file not in {one.file for one in self._find().values()}:
            raise InputError(f"{file}: is no recording of this project; expected one that is shown")

    def _find_path(self, file: str) -> Path:
        return name_status(self._directory / "build", Path(file))

    def _find(self) -> dict[Path, WatchedRecording]:
        now_s = time.time()
        found = {}
        for path, status in list_statuses(self._directory / "build").items():
            log = Path(status.file)
            state = status.judge(now_s)
            if state == ENDED and not log.is_file():  # it was moved away
                continue
            inside = log.is_relative_to(self._directory)
            found[path] = WatchedRecording(
                file=status.file,
                name=log.relative_to(self._directory).as_posix() if inside else str(log),
                state=state,
                status=status,
                is_named=state == ENDED and _is_named(self._directory, log, self._sensor),
            )
        return found


def _is_named(directory: Path, log: Path, sensor: str | None) -> bool:
    try:
        return matches_logs(load_unit(directory, sensor), log)
    except InputError:
        return False


@dataclass(frozen=True)
class UnitsSeen:
    """The registry at a moment."""

    is_there: bool
    standings: tuple[UnitStanding, ...] = ()
    wrong: str = ""
    """Why it could not be read."""


class UnitsWatch:
    """Looks at a project's registry; reads it only where its file has changed."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / FILE_NAME

    def mark(self) -> str:
        """Return what changes whenever the registry does; never empty."""
        # In write-ahead mode what was written last lies beside the file.
        parts = []
        for path in (self._path, self._path.with_name(f"{FILE_NAME}-wal")):
            try:
                told = path.stat()
            except OSError:
                told = None
            changed = told is not None and told.st_size
            parts.append(f"{told.st_size} {told.st_mtime_ns}" if told and changed else "none")
        return "; ".join(parts)

    def look(self) -> UnitsSeen:
        """Return the units as they stand."""
        if not self._path.is_file():
            return UnitsSeen(is_there=False)
        try:
            with open_registry(self._path) as registry:
                return UnitsSeen(is_there=True, standings=registry.list_standings())
        except InputError as error:
            return UnitsSeen(is_there=True, wrong=str(error))

    def tell_history(self, serial: str) -> tuple[Event, ...]:
        """Return what happened to a unit, the oldest first.

        Raises:
            InputError: there is no such unit, or the registry cannot be read.
        """
        with open_registry(self._path) as registry:
            return registry.tell_history(serial)
