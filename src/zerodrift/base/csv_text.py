"""Tables as CSV that a spreadsheet shows and does not run.

A spreadsheet takes a cell that begins with one of `RUN` for a formula, which may start programs
(OWASP, "CSV injection"). Such a text goes out with an apostrophe before it, by which spreadsheets
mark text. Numbers are left alone.
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl

RUN = ("=", "+", "-", "@", "\t", "\r")
MARK = "'"
_HARMLESS = re.compile(r"[-+](?:[-+0-9.,:;eE%± ]| to )*")
"""Signs and numbers, ranges of them too: there is nothing in it that could be called."""


def mark_text(cell: str) -> str:
    """Return a cell that no spreadsheet takes for a formula."""
    return MARK + cell if cell.startswith(RUN) and not _HARMLESS.fullmatch(cell) else cell


def render_rows(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as CSV."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([mark_text(heading) for heading in headings])
    writer.writerows([mark_text(cell) for cell in row] for row in rows)
    return out.getvalue()


def mark_frame(frame: "pl.DataFrame") -> "pl.DataFrame":
    """Return a frame whose names and texts no spreadsheet takes for formulas."""
    import polars as pl

    pattern = "^[" + re.escape("".join(RUN)) + "]"
    risky = pl.col(pl.String).str.contains(pattern)
    plain = pl.col(pl.String).str.contains(f"^{_HARMLESS.pattern}$")
    marked = pl.when(risky & ~plain).then(pl.lit(MARK) + pl.col(pl.String))
    frame = frame.with_columns(marked.otherwise(pl.col(pl.String)).name.keep())
    return frame.rename({name: mark_text(name) for name in frame.columns})
