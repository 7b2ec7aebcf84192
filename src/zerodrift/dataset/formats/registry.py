"""The reader for a file's suffix, and the message where the file cannot be read."""

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.extras import tell_install
from zerodrift.base.plugins import FORMATS as GROUP
from zerodrift.base.plugins import load_parts
from zerodrift.dataset.formats.tables import FormatTable


@dataclass(frozen=True)
class Format:
    """A kind of file that holds one table or several; an installed package may add its own."""

    suffixes: tuple[str, ...]
    """Small letters, with the dot."""
    name: str
    """For messages, with its article."""
    module: str
    """Has `read(path) -> Iterable[FormatTable]`; imported where such a file is read."""
    packages: tuple[str, ...] = ()
    """What it imports, by the names of the packages that hold it."""


_OWN = "zerodrift.dataset.formats."
FORMATS = (
    Format(
        (".xlsx", ".xls", ".xlsm", ".ods"), "a spreadsheet", f"{_OWN}excel", ("python-calamine",)
    ),
    Format((".h5", ".hdf5", ".hdf", ".mat"), "HDF5", f"{_OWN}hdf5", ("h5py",)),
    Format((".mcap",), "MCAP", f"{_OWN}mcap_log", ("mcap", "mcap-ros2-support")),
    Format((".db3",), "a rosbag2", f"{_OWN}rosbag", ("rosbags",)),
    Format((".ulg",), "ULog", f"{_OWN}ulog", ("pyulog",)),
    Format((".bin",), "an ArduPilot log", f"{_OWN}ardupilot", ("pymavlink",)),
)
_SHOWN = 6


@cache
def list_formats() -> dict[str, Format]:
    """Return suffix -> format; those of installed packages do not replace zerodrift's own."""
    found: dict[str, Format] = {}
    for part in (*FORMATS, *load_parts(GROUP, Format)):
        for suffix in part.suffixes:
            found.setdefault(suffix, part)
    return found


def find_format(path: Path) -> Format | None:
    """Return the format of a file by its suffix; None for text, Parquet and Arrow."""
    return list_formats().get(path.suffix.lower())


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
        module = importlib.import_module(known.module)
    except ImportError as error:
        own = known in FORMATS
        remedy = f"Run: {tell_install('formats')}" if own else "Install it, or mend the plug-in."
        raise InputError(
            f"{label}: is {known.name}, which is read by"
            f" {' and '.join(known.packages) or known.module}: not installed here ({error})."
            f" Expected that library. {remedy}"
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
