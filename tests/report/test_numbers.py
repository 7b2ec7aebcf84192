"""A number has one value, wherever it is shown."""

import pytest
from benchmarks.bench_numbers import ShownNumber, list_numbers, write_case
from benchmarks.shown_tables import ShownTable, list_page, list_report, list_terminal, read_text

pytestmark = pytest.mark.long

dash = pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

TERMINAL = """
                RMSE per run

  run                      Fx N
 ──────────────────────────────
  chamber_1   in sample   0.3536
  walk_1      held out    0.5146

Held-out errors are those of the test logs.
"""


@pytest.mark.parametrize(
    "number", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3, 4))]
)
def test_terminal_page_report_and_json_say_the_same(tmp_path, number):
    write_case(tmp_path, number)
    shown = list(list_numbers(tmp_path))
    assert len(shown) > 200
    assert {one.where for one in shown} == {"terminal", "page", "report", "JSON"}
    assert [one for one in shown if one.differs] == []
    promised = [one for one in shown if "promised" in one.what]
    assert (len(promised) > 0) == (number != 3)  # of that one no effect is named


def test_number_that_differs_in_its_last_digit_is_found():
    assert ShownNumber("page", "error", "0.8779", "0.8778").differs
    assert ShownNumber("page", "error", "0.8779", "").differs
    assert not ShownNumber("page", "error", "-0.8779", "−0.8779").differs


def test_tables_are_read_back_as_they_are_shown():
    (terminal,) = list_terminal(TERMINAL)
    assert terminal.title == "RMSE per run"
    assert terminal.find("walk_1", "Fx N") == "0.5146"
    assert terminal.find("walk_2", "Fx N") == terminal.find("walk_1", "Fy N") == ""
    text = (
        "<h2>Errors</h2><table><caption>RMSE &amp; more</caption><tr><th>run</th><th>N</th></tr>"
        "<tr><td>a</td><td>1.5</td></tr></table>"
    )
    assert list_report(text) == [ShownTable("RMSE & more", ("run", "N"), (("a", "1.5"),))]
    assert read_text("<style>p</style><p>a &lt; 1 %</p>") == "a < 1 %"


def test_tables_and_words_of_the_page_are_read_back():
    from dash import html

    told = '{"head": ["run", "N"], "rows": [["a", "1.5"]], "texts": 1}'
    parts = [html.Div([html.H3("Errors"), html.Div(**{"data-table": told})]), html.P(["a", " b"])]
    assert list_page(parts) == [ShownTable("Errors", ("run", "N"), (("a", "1.5"),))]
    assert read_text(parts) == "Errors a b"
