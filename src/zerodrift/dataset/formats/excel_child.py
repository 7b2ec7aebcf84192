"""Writes the sheets of a workbook as text in a process of its own; started by `excel.py` as a
script, without a package.

The library keeps every cell between the first and the last that hold something, and ends its
process where memory does not suffice: two cells in opposite corners of a file of 1 KB take 500 GB.
"""

import csv
import datetime
import json
import sys
from pathlib import Path

from python_calamine import CalamineSheet, CalamineWorkbook

TOO_LARGE = 3
"""Exit code: a sheet spans more cells than is allowed."""
CELL_BYTES = 32
"""Of one cell in the library's memory, empty ones too."""
PROGRAM_BYTES = 2**30
"""Of address space for the interpreter, the library, its copy of the file and the text."""


def main(path: str, folder: str, most_cells: int) -> None:
    """Write each sheet into a file of the folder; print names and files as JSON.

    Args:
        path: the workbook.
        folder: for the files, 0.tsv and so on.
        most_cells: that a sheet may span.
    """
    limit_memory(PROGRAM_BYTES + CELL_BYTES * most_cells)
    workbook = CalamineWorkbook.from_path(path)
    written = []
    for number, name in enumerate(workbook.sheet_names):
        print(json.dumps([name]), flush=True)  # which one, should this be the end
        sheet = workbook.get_sheet_by_name(name)
        if sheet.start is None or sheet.end is None:
            continue
        height, width = sheet.end[0] + 1, sheet.end[1] + 1
        if height * width > most_cells:
            sys.exit(TOO_LARGE)
        if height < 2:
            continue
        file = Path(folder) / f"{number}.tsv"
        _write_sheet(sheet, file)
        written.append([name, file.name])
    print(json.dumps(written))


def limit_memory(size: int) -> None:
    """Limit this process's address space, where the system knows such a limit."""
    try:
        import resource
    except ImportError:  # Windows
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (size, soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))


def _write_sheet(sheet: CalamineSheet, file: Path) -> None:
    assert sheet.start is not None
    dated = {
        number
        for row in sheet.iter_rows()
        for number, cell in enumerate(row)
        if isinstance(cell, datetime.datetime)
    }
    with file.open("w", encoding="utf-8", newline="") as target:
        writer = csv.writer(target, delimiter="\t", lineterminator="\n")
        shift = [""] * sheet.start[1]  # rows above the first cell are given, columns are not
        for row in sheet.iter_rows():
            writer.writerow([*shift, *(_write(cell, k in dated) for k, cell in enumerate(row))])


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


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
