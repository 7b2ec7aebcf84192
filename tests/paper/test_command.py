import csv
import json

import pytest

from zerodrift_lab.paper.findings import FAILS, HOLDS, REVERSED, UNDECIDED, WEAKER, judge_factor
from zerodrift_lab.paper.published import TABLES
from zerodrift_lab.paper.summary import Spread


@pytest.fixture
def paper(zerodrift, cheap, monkeypatch, tmp_path):
    """Return a function that runs the command with methods that cost next to nothing."""
    monkeypatch.setenv("ZERODRIFT_BROWSER", "no-such-browser")

    def run(*more):
        out = tmp_path / "paper"
        extent = ("--quick", "--sensors", 2, "--recipe-epochs", 2)
        return out, zerodrift("paper", *extent, "--out", out, *more)

    return run


@pytest.mark.long
def test_tables_stand_beside_the_paper_and_say_that_they_are_simulated(paper):
    out, result = paper()
    assert result.code == 0, result.err
    text = (out / "tables.md").read_text()
    assert result.out.startswith(text[:200])
    headings = [line for line in text.splitlines() if line.startswith("### ")]
    assert len(headings) == 4
    assert all("simulated" in heading for heading in headings)
    assert "159.8" in text and "noise floor" in text
    with (out / "tables.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["source"] for row in rows} == {"simulated", "arXiv 2502.17528"}
    printed = [row for row in rows if row["source"] != "simulated"]
    assert len(printed) == sum(len(row) for table in TABLES for row in table.rows.values())
    page = (out / "figures.html").read_text()
    assert page.count("(simulated)") >= 7
    assert "no SVG, PDF or PNG was made" in result.err


@pytest.mark.long
def test_json_holds_tables_findings_and_files(paper):
    out, result = paper("--json")
    told = json.loads(result.out)
    assert told["simulated"] is True
    assert [table["name"] for table in told["tables"]] == [
        "chamber",
        "cooling",
        "heating",
        "walking",
    ]
    assert all(finding["sentence"] for finding in told["findings"])
    assert {entry["logs"] for entry in told["why"]["heat"]} == {
        "the chamber alone",
        "the chamber and bench logs without the walk's plates",
        "the chamber and bench logs",
        "those, with a second thermometer",
    }
    # All networks are the same least squares here, so none can be ahead of another.
    same = next(f for f in told["findings"] if f["name"] == "same information")
    assert same["verdict"] == UNDECIDED
    assert str(out / "tables.md") in told["files"]
    again = paper("--json")[1]
    assert json.loads(again.out) == told


def test_a_place_that_is_a_file_is_refused(zerodrift, tmp_path):
    place = tmp_path / "file"
    place.write_text("")
    result = zerodrift("paper", "--quick", "--out", place / "below")
    assert result.code == 2
    assert "--out" in result.err


@pytest.mark.parametrize(
    ("published", "spread", "verdict"),
    [
        (4.0, (3.9, 3.5, 4.2), HOLDS),
        (4.0, (1.9, 1.5, 2.1), HOLDS),
        (4.0, (1.6, 1.5, 1.7), WEAKER),
        (8.0, (1.16, 1.1, 1.2), FAILS),
        (2.0, (1.0, 0.9, 1.2), UNDECIDED),
        (2.0, (0.7, 0.6, 0.8), REVERSED),
    ],
)
def test_verdicts_follow_from_the_quartiles(published, spread, verdict):
    assert judge_factor(published, Spread(*spread, 5)) == verdict
