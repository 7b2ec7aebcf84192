"""A number has one value, wherever it is shown."""

import pytest
from benchmarks.bench_numbers import ShownNumber, list_numbers, write_case

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")


@pytest.mark.parametrize(
    "number", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3, 4))]
)
def test_terminal_page_and_report_say_what_the_json_says(tmp_path, number):
    write_case(tmp_path, number)
    shown = list(list_numbers(tmp_path))
    assert len(shown) == 3 * 2 * 3 + 5
    assert {one.where for one in shown} == {"terminal", "page", "report"}
    assert [one for one in shown if one.differs] == []


def test_number_that_differs_in_its_last_digit_is_found():
    assert ShownNumber("page", "error", "0.8779", "Fz N 0.8778 0.04982").differs
    assert not ShownNumber("page", "error", "0.8779", "Fz N 0.8779 0.04982").differs
