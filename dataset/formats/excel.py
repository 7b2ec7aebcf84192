"""Sheets of a workbook (.xlsx, .xls, .ods), by python-calamine."""

import csv
import datetime
import itertools
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from python_calamine import CalamineWorkbook

from zerodrift.dataset.formats.tables import FormatTable

_NUMBERS = itertools.count()


def read(path: Path) -> Iterable[FormatTable]:
    """Yield each sheet as text, one line per row, so that lines above a header are recognised."""
    workbook = CalamineWorkbook.from_path(str(path))
    for name in workbook.sheet_names:
        rows = workbook.get_sheet_by_name(name).to_python(skip_empty_area=False)
        if len(rows) < 2:
            continue
        dated = {
            number
            for row in rows
            for number, cell in enumerate(row)
            if isinstance(cell, datetime.datetime)
        }
        target = _folder() / f"{next(_NUMBERS)}.tsv"
        with target.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, delimiter="\t", lineterminator="\n")
            for row in rows:
                writer.writerow([_write(cell, k in dated) for k, cell in enumerate(row)])
        yield FormatTable(name, None, text=target)


def _write(cell: object, is_dated: bool) -> str:
    """Return a cell as text that is read as the same value.

    In a column of dates and times midnight is a date without one.
    """
    if is_dated and isinstance(cell, datetime.date) and not isinstance(cell, datetime.datetime):
        return f"{cell.isoformat()}T00:00:00"
    if isinstance(cell, datetime.datetime):
        return cell.isoformat(sep="T")
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, datetime.date | datetime.time):
        return cell.isoformat()
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, float):
        return repr(cell)
    return str(cell).replace("\n", " ").replace("\t", " ")


@cache
def _folder() -> Path:
    """Return a folder for this process, removed when it ends."""
    folder = tempfile.TemporaryDirectory(prefix="zerodrift-sheets-", ignore_cleanup_errors=True)
    _KEPT.append(folder)
    return Path(folder.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []
