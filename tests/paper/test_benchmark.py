"""The benchmark's ratios: of errors, and of the drift's errors with the noise taken off."""

import pytest
from benchmarks.bench_paper import BENCH, divide, list_cells, over_floor, pool_drift

from zerodrift_lab.paper.store import Cell
from zerodrift_lab.paper.study import Outcome
from zerodrift_lab.paper.summary import Outcomes


def make_outcome(method: str, error: float) -> Outcome:
    test = {"rmse": [error, error], "floor": [3.0, 3.0]}
    return Outcome(Cell(method, 1), {"scale": [1.0, 1.0], "tests": dict.fromkeys(BENCH, test)})


def test_noise_is_taken_off_in_squares():
    theirs, ours = make_outcome("gru_window_paper", 13.0**0.5), make_outcome("lag_bank", 10.0**0.5)
    outcomes = Outcomes([theirs, ours])
    assert divide(outcomes, [[theirs]], [ours], BENCH).median == pytest.approx(1.3**0.5)
    assert divide(outcomes, [[theirs]], [ours], BENCH, pool_drift).median == pytest.approx(2.0)


def test_better_of_two_trainings_counts():
    one, other = make_outcome("gru_window_paper", 6.0), make_outcome("gru_window_projected", 4.0)
    ours = make_outcome("lag_bank", 3.5)
    outcomes = Outcomes([one, other, ours])
    assert divide(outcomes, [[one], [other]], [ours], BENCH).median == pytest.approx(4.0 / 3.5)
    assert over_floor(BENCH, [one], [other]).median == pytest.approx(4.0 / 3.0)


def test_rows_on_the_bench_need_no_loads_and_no_recipe():
    groups = list_cells(2, 1, 500, "bench")
    cells = [cell for group in groups.values() for cell in group]
    assert {cell.logs for cell in cells} == {"chamber", "varied", "unwalked"}
    assert all(cell.schedule == "quick" for cell in cells)
    assert "recipe" in list_cells(2, 1, 500, "all")
