"""The reader for a file's suffix, and the message where the file cannot be read."""

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.extras import tell_install
from zerodrift.dataset.formats.tables import FormatTable


@dataclass(frozen=True)
class Format:
    """A kind of file that holds one table or several."""

    name: str
    """For messages."""
    module: str
    """Of this package; has `read(path) -> Iterable[FormatTable]`."""
    packages: tuple[str, ...]
    """What it imports, by the names of the packages that hold it."""


FORMATS = {
    (".xlsx", ".xls", ".xlsm", ".ods"): Format("a spreadsheet", "excel", ("python-calamine",)),
    (".h5", ".hdf5", ".hdf", ".mat"): Format("HDF5", "hdf5", ("h5py",)),
    (".mcap",): Format("MCAP", "mcap_log", ("mcap", "mcap-ros2-support")),
    (".db3",): Format("a rosbag2", "rosbag", ("rosbags",)),
    (".ulg",): Format("ULog", "ulog", ("pyulog",)),
    (".bin",): Format("an ArduPilot log", "ardupilot", ("pymavlink",)),
}
_SHOWN = 6
FORMAT_SUFFIXES = tuple(suffix for suffixes in FORMATS for suffix in suffixes)


def find_format(path: Path) -> Format | None:
    """Return the format of a file by its suffix; None for text, Parquet and Arrow."""
    suffix = path.suffix.lower()
    return next((each for suffixes, each in FORMATS.items() if suffix in suffixes), None)


def read_tables(path: Path, label: str, known: Format) -> list[FormatTable]:
    """Read all tables of a file.

    Args:
        path: the file.
        label: how messages name it.
        known: its format.

    Raises:
        InputError: its library is not installed, the file is damaged, or it has no table.
    """
    try:
        module = importlib.import_module(f"zerodrift.dataset.formats.{known.module}")
    except ImportError as error:
        raise InputError(
            f"{label}: is {known.name}, which is read by {' and '.join(known.packages)}: not "
            f"installed here ({error}). Expected that library. Run: {tell_install('formats')}"
        ) from error
    read: Callable[[Path], Iterable[FormatTable]] = module.read
    try:
        found = [table for table in read(path) if table.holds_rows]
    except InputError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{label}: cannot be read as {known.name} ({reason[:200]}); expected a whole file. "
            "Copy it again, or export the log as CSV."
        ) from error
    tables = [table for table in found if table.holds_numbers]
    if not tables:
        bare = ", ".join(table.name for table in found[:_SHOWN])
        told = f" (found: {bare}, without a number in it)" if bare else ""
        raise InputError(
            f"{label}: {known.name} without a table that has numbers{told}; expected rows of "
            "numbers and their times, such as a topic of wrenches. Record the log again, or take it"
            " out of [logs]."
        )
    return tables
