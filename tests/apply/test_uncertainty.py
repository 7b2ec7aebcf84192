"""The uncertainty's parts add up to what runs left out show, and cover what comes later."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from scipy.stats import t as student

import zerodrift as zd
from zerodrift.base.config import load_config
from zerodrift.base.records import Json, from_json, read_sealed
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.report.results import ApplyResult, CompareResult, ReportResult
from zerodrift.verify.uncertainty import (
    COVERAGE,
    OutputUncertainty,
    Uncertainty,
    combine_degrees,
    count_degrees,
)


def make(**changes: float) -> OutputUncertainty:
    values = {"noise": 3.0, "parameters": 0.0, "left_out": 4.0, "rounding": 0.0, "span": 10.0}
    return OutputUncertainty(unit="N", degrees_of_freedom=1e6, **(values | changes))


def test_parts_add_as_squares() -> None:
    assert make().standard == 5.0
    assert make(parameters=12.0).standard == 13.0


def test_inside_it_is_twice_the_standard_uncertainty() -> None:
    assert make().expand(np.zeros(2)) == pytest.approx([10.0, 10.0], rel=1e-4)


def test_beyond_the_range_a_rectangle_is_added() -> None:
    (expanded,) = make(noise=0.0, left_out=0.0).expand(np.array([0.3]))
    assert expanded == pytest.approx(2.0 * 10.0 * 0.3 / np.sqrt(3.0))


def test_few_degrees_of_freedom_widen_it() -> None:
    narrow, wide = make(), OutputUncertainty("N", 3.0, 0.0, 4.0, 0.0, 10.0, 4.0)
    assert narrow.widening == pytest.approx(1.0, abs=1e-3)
    assert wide.widening == pytest.approx(student.ppf((1 + COVERAGE) / 2, 4) / 2)


def test_degrees_are_those_of_a_known_spread() -> None:
    """Mean squares of chi-square numbers with 6 degrees each: 10 runs have 60."""
    rng = np.random.default_rng(5)
    found = [count_degrees(rng.chisquare(6, size=10) / 6, np.full(10, 0.1)) for _ in range(400)]
    assert np.median(found) == pytest.approx(60.0, rel=0.25)
    assert count_degrees(np.ones(1), np.ones(1)) == 2.0


def test_what_firmware_keeps_is_the_error_left_out(built: Path) -> None:
    kept = from_json(Uncertainty, read_sealed((built / "build/uncertainty.json").read_bytes()))
    assert kept.method == "leave one run out"
    assert kept.outputs["y"].standard == pytest.approx(0.02, rel=0.1), "the simulated noise"
    told = json.loads((built / "build/firmware.json").read_text())
    assert kept.model_hash == told["model_hash"]


def run(*arguments: object) -> dict[str, Json]:
    result = CliRunner().invoke(cli, [*map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    told: dict[str, Json] = json.loads(result.stdout)
    return told


def test_one_number_everywhere(built: Path, tmp_path: Path) -> None:
    """Apply, compare, report, datasheet, the Python face and the file of rows state the same."""
    log, out = built / "logs/run3.csv", tmp_path / "o.parquet"
    applied = from_json(ApplyResult, run("apply", log, "-C", built, "--out", out))
    compared = from_json(CompareResult, run("compare", "-C", built))
    options = ("--datasheet", "--no-diagnose", "-o", tmp_path / "r.html")
    reported = from_json(ReportResult, run("report", "-C", built, *options))
    assert applied.uncertainty is not None and compared.uncertainty is not None
    stated = applied.uncertainty["y"]
    assert stated.expanded == pytest.approx(0.04, rel=0.1), "twice the simulated noise"
    assert compared.uncertainty["y"] == stated
    assert reported.compare.uncertainty == compared.uncertainty
    assert reported.datasheet is not None
    (row,) = (r for r in reported.datasheet if r.quantity == "expanded uncertainty (k = 2)")
    assert (row.after, row.unit) == ((stated.expanded, None), "N") and "left out" in row.note
    inside = pl.read_parquet(out).filter(pl.col("flags") == 0)["y_uncertainty"]
    assert (
        inside.unique().to_list() == [stated.expanded] == [applied.logs[0].outputs["y"].uncertainty]
    )
    html = zd.Project(built).compare()._repr_html_()
    assert "<h4>uncertainty</h4>" in html and "left_out" in html
    printed = CliRunner().invoke(cli, ["compare", "-C", str(built)]).output
    assert "Uncertainty of a compensated value" in printed and f"{stated.expanded:.2g}" in printed
    assert "expanded, k = 2" in (tmp_path / "r.html").read_text()


def test_the_parts_make_the_whole(built: Path) -> None:
    compared = from_json(CompareResult, run("compare", "-C", built))
    assert compared.uncertainty is not None
    one = compared.uncertainty["y"]
    root = np.sqrt(np.sum(np.square([one.noise, one.parameters, one.left_out, one.rounding])))
    widening = student.ppf((1 + COVERAGE) / 2, one.degrees_of_freedom) / 2
    assert one.expanded == pytest.approx(2 * root * widening)


def test_the_share_covered_is_that_of_the_test_rows(built: Path, tmp_path: Path) -> None:
    log, out = built / "logs/run3.csv", tmp_path / "o.parquet"
    applied = from_json(ApplyResult, run("apply", log, "-C", built, "--out", out))
    assert applied.uncertainty is not None
    rows = pl.read_parquet(out).filter(pl.col("flags") == 0)
    (test,) = load_dataset(load_config(built)).test
    assert applied.uncertainty["y"].covered_readings == len(rows) == len(test)
    error = np.abs(rows["y_compensated"].to_numpy() - test.reference[:, 0])
    share = float(np.mean(error <= applied.uncertainty["y"].expanded))
    assert applied.uncertainty["y"].covered == pytest.approx(share, abs=1e-12)


def test_without_firmware_nothing_is_stated(built: Path, tmp_path: Path) -> None:
    project = Path(shutil.copytree(built, tmp_path / "project"))
    shutil.rmtree(project / "build")
    assert "uncertainty" not in run("compare", "-C", project)
    options = ("--datasheet", "--no-diagnose", "-o", tmp_path / "r.html")
    reported = from_json(ReportResult, run("report", "-C", project, *options))
    assert reported.datasheet is not None
    row = reported.datasheet[-1]
    assert row.after is None and "zerodrift firmware" in row.note


def test_one_run_is_one_observation_of_what_is_no_noise() -> None:
    assert combine_degrees(slow=4.0, noise=0.0, runs=1) == 1.0
    assert combine_degrees(slow=4.0, noise=0.0, runs=5) == 5.0
    assert combine_degrees(slow=1.0, noise=9.0, runs=2) == 200.0, "noise is known well"
    assert combine_degrees(slow=0.0, noise=9.0, runs=1) > 1e5
