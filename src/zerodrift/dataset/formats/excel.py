"""Sheets of a workbook (.xlsx, .xls, .ods), by python-calamine in a process of its own."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import python_calamine  # noqa: F401 - told here that it is not installed, not in the child

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats import excel_child
from zerodrift.dataset.formats.tables import FormatTable

MOST_CELLS = 2**24
"""Of a sheet, from A1 to the last cell that holds something: all 65,536 x 256 of an .xls, or 16
columns through all 1,048,576 rows of an .xlsx. The library takes 32 bytes for each: 0.5 GB."""


def read(path: Path) -> Iterable[FormatTable]:
    """Yield each sheet as text, one line per row, so that lines above a header are recognised.

    Raises:
        InputError: a sheet spans more than `MOST_CELLS`.
        ValueError: the library cannot read the file.
    """
    folder = Path(tempfile.mkdtemp(dir=_folder()))
    done = subprocess.run(
        [sys.executable, "-P", excel_child.__file__, str(path), str(folder), str(MOST_CELLS)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    lines = done.stdout.splitlines()
    told = done.stderr.strip().splitlines()
    if done.returncode == excel_child.TOO_LARGE or done.returncode < 0 or "MemoryError" in told:
        sheet = json.loads(lines[-1])[0] if lines else "?"
        raise InputError(
            f"{path}: sheet '{sheet}' spans more than {MOST_CELLS:,} cells from A1 to the last one"
            " that holds something; expected a log, with nothing far from it. Delete what stands"
            " at the far end (Ctrl+End goes there), split the sheet, or export it as CSV."
        )
    if done.returncode != 0:
        raise ValueError(told[-1].partition(": ")[2] or told[-1] if told else "no reason given")
    for name, file in json.loads(lines[-1]):
        yield FormatTable(name, None, text=folder / file)


@cache
def _folder() -> Path:
    """Return a folder for this process, removed when it ends."""
    folder = tempfile.TemporaryDirectory(prefix="zerodrift-sheets-", ignore_cleanup_errors=True)
    _KEPT.append(folder)
    return Path(folder.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []
