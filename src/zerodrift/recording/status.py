"""What a recording tells of itself: while it runs, and at its end."""

import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.files import make_directory, name_beside, write_beside
from zerodrift.base.records import from_json, to_dict
from zerodrift.dataset.units import write_duration
from zerodrift.recording.coverage import Coverage, Covered, CoveredRange
from zerodrift.recording.recorder import Show, name_journal

# What `record` prints, and its sentences.


@dataclass(frozen=True, kw_only=True)
class RecordingSummary(Covered):
    """A log that was recorded."""

    file: str
    """The log."""
    source: str
    interrupted: bool
    """Whether it was ended by Ctrl-C or by the system."""
    why: str
    """Where the wanted ranges come from: a plan, the model's logs, or nothing."""
    notes: tuple[str, ...]
    """What arrived and is in no row."""


def explain_missing(covered: Covered) -> list[str]:
    """Return a sentence for each thing that is still to be covered."""
    return [_explain(one) for one in covered.wanted if not one.enough]


def _explain(one: CoveredRange) -> str:
    unit = f" {one.unit}" if one.unit else ""
    if one.what == "time":
        left = max(one.wanted_high - one.high, 0.0)
        reached, whole = write_duration(one.high), write_duration(one.wanted_high)
        return f"time: {reached} of {whole}, {write_duration(left)} more"
    if one.what in ("heating", "cooling"):
        return f"{one.what}: {one.high:.3g} of {one.wanted_high:.3g}{unit}"
    if one.low == one.high == 0.0 and one.share == 0.0:
        return f"{one.what}: nothing of {one.wanted_low:g} to {one.wanted_high:g}{unit}"
    lacks = []
    span = one.wanted_high - one.wanted_low
    if one.low > one.wanted_low + 0.01 * span:
        lacks.append(f"down to {one.wanted_low:g}")
    if one.high < one.wanted_high - 0.01 * span:
        lacks.append(f"up to {one.wanted_high:g}")
    return (
        f"{one.what}: {one.low:.4g} to {one.high:.4g}{unit} so far; go {' and '.join(lacks)}{unit}"
    )


# What a recording that runs tells of itself, for whoever looks: the page shows it.
#
# A file for each recording lies in `build/recordings/` of the project. It is replaced as a whole
# each second. A recorder that was killed leaves it behind; it is then told by its age.

FOLDER = "recordings"
"""In build/."""
EVERY_S = 1.0
"""Between two of the recorder's words."""
LATE_S = 6.0
"""A recorder that said nothing for so long has stopped, or is stuck."""
LOST_S = 60.0
"""After so long its number may be another program's."""
LIVE, STUCK, CUT_OFF, ENDED = "live", "stuck", "cut off", "ended"


@dataclass(frozen=True)
class RecordingStatus:
    """A recording, as its recorder tells of it."""

    file: str
    """The log, an absolute path."""
    source: str
    why: str
    """Where the wanted ranges come from."""
    pid: int
    host: str
    at_s: float
    """Unix time of these words."""
    silent: str
    """What is to be said of the source; empty: rows come."""
    ended: bool
    covered: Covered

    def judge(self, now_s: float) -> str:
        """Return live | stuck | cut off | ended, by what is known of its recorder."""
        if self.ended:
            return ENDED
        late_s = now_s - self.at_s
        if late_s < LATE_S:
            return LIVE
        is_there = self.host == platform.node() and is_alive(self.pid)
        return STUCK if is_there and late_s < LOST_S else CUT_OFF


def is_alive(pid: int) -> bool:
    """Return whether there is a process of that number; on Windows nothing is known of that."""
    if sys.platform == "win32":
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def name_status(build: Path, log: Path) -> Path:
    """Return where the status of the recording of a log lies."""
    mark = hashlib.sha256(str(log.resolve()).encode()).hexdigest()[:16]
    return build / FOLDER / f"{mark}.json"


def read_status(path: Path) -> RecordingStatus | None:
    """Return what a recorder told; None where there is nothing, or of another version."""
    try:
        return from_json(RecordingStatus, json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return None


def list_statuses(build: Path) -> dict[Path, RecordingStatus]:
    """Return the recordings of a project that run or have ended, by where they tell of it."""
    found = {path: read_status(path) for path in sorted((build / FOLDER).glob("*.json"))}
    return {path: status for path, status in found.items() if status is not None}


def end_status(build: Path, log: Path, covered: Covered | None = None) -> None:
    """Note that a recording has ended, where one told of itself."""
    path = name_status(build, log)
    status = read_status(path)
    if status is not None:
        _write(path, replace(status, ended=True, covered=covered or status.covered, silent=""))


@contextmanager
def telling_status(
    build: Path | None, log: Path, source: str, coverage: Coverage, why: str
) -> Iterator[Callable[[Show], Show]]:
    """Tell of a recording while the block runs, and then that it has ended.

    A status that cannot be written ends no recording.

    Args:
        build: the project's build/; None: nothing is told.
        log: that is recorded.
        source: as the user wrote it.
        coverage: follows the recording.
        why: where the wanted ranges come from.

    Yields:
        What makes of a function that shows a recording one that tells of it, too.
    """
    if build is None:
        yield lambda show: show
        return
    path = name_status(build, log)
    first = RecordingStatus(
        file=str(log.resolve()),
        source=source,
        why=why,
        pid=os.getpid(),
        host=platform.node(),
        at_s=time.time(),
        silent="",
        ended=False,
        covered=coverage.describe(),
    )
    with suppress(InputError):
        make_directory(path.parent)
    for other, status in list_statuses(build).items():
        if status.ended:
            other.unlink(missing_ok=True)
    _write(path, first)
    told_s = time.monotonic()

    def tell_too(show: Show) -> Show:
        def show_and_tell(covered: Covered, silent: str) -> None:
            nonlocal told_s
            show(covered, silent)
            if time.monotonic() - told_s >= EVERY_S:
                told_s = time.monotonic()
                _write(path, replace(first, at_s=time.time(), silent=silent, covered=covered))

        return show_and_tell

    try:
        yield tell_too
    finally:
        covered = coverage.describe()
        if not covered.rows:
            path.unlink(missing_ok=True)
        elif not name_journal(log).exists():  # else the log is not whole, and time tells so
            _write(path, replace(first, at_s=time.time(), ended=True, covered=covered))


def _write(path: Path, status: RecordingStatus) -> None:
    """Replace a status; nothing waits for the disk."""
    with suppress(InputError, OSError):
        content = json.dumps(to_dict(status), ensure_ascii=False).encode()
        beside = name_beside(path)
        try:
            write_beside(beside, content, like=path, durable=False)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
