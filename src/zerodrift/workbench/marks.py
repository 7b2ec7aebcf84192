"""Whether a file of the project was changed from outside of the page."""

from pathlib import Path

from zerodrift.base.config import FILE_NAME
from zerodrift.diagnosis.history import FILE_NAME as HISTORY
from zerodrift.fleet.sensors import FOLDER
from zerodrift.report.findings import Findings
from zerodrift.workbench.uploads import LOGS

BUILT = (HISTORY, "firmware.json", "refused.json", "compensator.json")
"""Files of build/ that other commands write and the page shows."""

Marks = dict[str, tuple[int, int]]
"""File, relative to the project -> its size in bytes and the time of its last change in ns."""


def mark_files(
    directory: Path,
    findings: Findings | None,
    recorded: frozenset[Path] = frozenset(),
    sensor: str | None = None,
) -> Marks:
    """Return size and time of zerodrift.toml, the logs, the user's effects, and what was built.

    Whatever went into the findings counts, and new files where logs usually lie, except hidden ones
    and those in `recorded`: a log that grows would never let the page rest. A unit of a fleet has a
    folder of its own below build/.
    """
    places = {directory / FILE_NAME, *directory.glob("*.py"), *directory.glob("*.csv")}
    places |= set(directory.glob(f"{LOGS}/*"))
    built = directory / "build" if sensor is None else directory / "build" / FOLDER / sensor
    places |= {built / name for name in BUILT}
    if findings is not None:
        places |= {directory / source.file for source in findings.provenance.files}
    marks = {}
    for path in sorted(places):
        if path in recorded or path.name.startswith("."):
            continue
        try:
            told = path.stat()
        except OSError:
            continue
        marks[path.relative_to(directory).as_posix()] = (told.st_size, told.st_mtime_ns)
    return marks
