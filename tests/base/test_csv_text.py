"""What goes out as CSV is shown by a spreadsheet, and never run."""

import csv
import io

import polars as pl
import pytest

from zerodrift.base.csv_text import mark_frame, mark_text, render_rows

EVIL = [
    "=HYPERLINK(1)",
    "+cmd|' /C calc'!A0",
    "-2+A1",
    "@SUM(A1)",
    "\t=1+A1",
    "\r=1+A1",
    "-1 to A1",
]
PLAIN = [
    "Fz_N",
    "-1.5",
    "+3",
    "-",
    "-3.1 .. 2e-5",
    "",
    "a=b",
    "20 %",
    "-0.5 ± 0.1",
    "-10.5 to 90.5",
]


@pytest.mark.parametrize("cell", EVIL)
def test_what_a_spreadsheet_would_run_is_marked_as_text(cell: str) -> None:
    assert mark_text(cell) == "'" + cell


@pytest.mark.parametrize("cell", PLAIN)
def test_numbers_and_other_texts_are_left_alone(cell: str) -> None:
    assert mark_text(cell) == cell


def test_a_table_is_marked_cell_by_cell() -> None:
    told = list(csv.reader(io.StringIO(render_rows(["=a", "b"], [["@x", "-1"]]))))
    assert told == [["'=a", "b"], ["'@x", "-1"]]


def test_a_frame_is_marked_as_single_cells_are() -> None:
    frame = pl.DataFrame({"=a": [*EVIL, *PLAIN], "n": [-1.0] * len([*EVIL, *PLAIN])})
    marked = mark_frame(frame)
    assert marked.columns == ["'=a", "n"]
    assert marked["'=a"].to_list() == [mark_text(cell) for cell in [*EVIL, *PLAIN]]
    assert marked["n"].to_list() == frame["n"].to_list()
