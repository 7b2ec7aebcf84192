"""Runs held against each other are read, and their steps measured, once where there is room."""

import numpy as np
import pytest

from zerodrift.dataset import shared_rows
from zerodrift.dataset.resolution import find_steps
from zerodrift.dataset.shared_rows import Alignment, ReadRun, ReadRuns, confirm

ROWS = 4000


def make_runs(count: int) -> list[list[np.ndarray]]:
    """Return runs of two columns, each with noise of its own."""
    rng = np.random.default_rng(7)
    return [[rng.normal(0, 0.3, ROWS).round(3) for _ in range(2)] for _ in range(count)]


def test_the_steps_of_a_column_are_those_of_the_whole_run() -> None:
    (columns,) = make_runs(1)
    run = ReadRun(columns)
    whole = find_steps(columns[1])
    assert whole.size in (1, ROWS)
    rows = slice(100, 160)
    expected = whole[rows] if whole.size > 1 else whole
    np.testing.assert_array_equal(run.find_steps(1, rows), expected)


def test_runs_are_read_once_where_there_is_room_and_again_where_there_is_none() -> None:
    runs = make_runs(3)
    asked: list[int] = []

    def read(number: int) -> list[np.ndarray]:
        asked.append(number)
        return runs[number]

    roomy = ReadRuns(read)
    for number in (0, 1, 0, 2, 1, 2):
        roomy.take(number)
    assert asked == [0, 1, 2]
    asked.clear()
    narrow = ReadRuns(read, most=2 * ReadRun(runs[0]).values)
    for number in (0, 1, 0, 2, 0, 1):
        np.testing.assert_array_equal(narrow.take(number).columns[0], runs[number][0])
    assert asked == [0, 1, 2, 1]
    asked.clear()
    tight = ReadRuns(read, most=1)
    for number in (0, 1, 0):
        tight.take(number)
    assert asked == [0, 1, 0]


def test_the_cost_of_alignments_by_chance_does_not_grow_with_their_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = make_runs(4)
    runs[3][0][500:900], runs[3][1][500:900] = runs[0][0][100:500], runs[0][1][100:500]
    measured: list[int] = []

    def count(values: np.ndarray) -> np.ndarray:
        measured.append(values.size)
        return find_steps(values)

    monkeypatch.setattr(shared_rows, "find_steps", count)
    by_chance = [
        Alignment(one, other, offset, 700, 50.0)
        for one in range(4)
        for other in range(one + 1, 4)
        for offset in range(-600, -600 + shared_rows.MOST_ALIGNMENTS - 1)
    ]
    found = confirm([*by_chance, Alignment(0, 3, 400, 200, 90.0)], lambda number: runs[number])
    assert [(each.row, each.other_row, each.rows) for each in found.pop((0, 3))] == [
        (100, 500, 400)
    ]
    assert not found
    assert len(measured) <= 8  # four runs of two columns
