"""Outliers and limits, on results made by hand."""

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fleet.conftest import TOML

from zerodrift.base.config import parse_config
from zerodrift.base.records import to_dict
from zerodrift.fleet.outliers import find_outliers
from zerodrift.fleet.report import (
    ERROR,
    FAIL,
    PASS,
    judge_fleet,
    render_csv,
    render_markdown,
    summarise_report,
)
from zerodrift.fleet.result import (
    OutputResult,
    ParameterResult,
    SensorOutcome,
    SensorResult,
    load_result,
    save_result,
)
from zerodrift.fleet.sensors import Design


def make_result(
    number: int, rmse: float = 1.0, tau_s: float = 60.0, std_error: float = 0.1
) -> SensorResult:
    return SensorResult(
        sensor=f"S{number:03d}",
        mark="m",
        held_out="held out",
        floor="dwell",
        outputs={"Fz": OutputResult("N", 30.0, rmse, rmse, 0.9)},
        parameters={
            "thermal_lag.tau_s": ParameterResult(tau_s, std_error, "s", True),
            "Fz offset": ParameterResult(0.0, 0.0, "N"),
        },
        temperature_degC=(-20.0, 60.0),
        network=False,
        notes=(),
        model_hash="abc",
        files={},
    )


def make_fleet(count: int = 100) -> list[SensorResult]:
    rng = np.random.default_rng(5)
    return [
        make_result(i, math.exp(0.05 * rng.normal()), 60.0 * math.exp(0.1 * rng.normal()))
        for i in range(count)
    ]


def test_ordinary_fleet_has_no_outliers():
    assert find_outliers(make_fleet(), 5.0) == {}


def test_outliers_are_found_in_errors_and_in_parameters():
    fleet = make_fleet()
    fleet[7] = make_result(7, rmse=3.0)
    fleet[9] = make_result(9, tau_s=6.0)
    found = find_outliers(fleet, 5.0)
    assert set(found) == {"S007", "S009"}
    assert found["S007"][0].quantity in ("Fz rmse", "Fz ratio to the floor")
    assert found["S007"][0].z > 5.0
    [outlier] = found["S009"]
    assert (outlier.quantity, outlier.value, outlier.unit) == ("thermal_lag.tau_s", 6.0, "s")
    assert outlier.z < -5.0
    assert "the fleet's median is" in str(outlier)


def test_unusually_small_error_is_no_outlier():
    fleet = make_fleet()
    fleet[3] = make_result(3, rmse=0.01)
    assert find_outliers(fleet, 5.0) == {}


def test_badly_determined_parameter_is_no_outlier():
    fleet = make_fleet()
    fleet[3] = make_result(3, tau_s=6.0, std_error=6.0)
    assert find_outliers(fleet, 5.0) == {}


def test_two_populations_are_no_outliers_of_each_other():
    fleet = [make_result(i, tau_s=(30.0 if i % 3 == 0 else 90.0) + 0.01 * i) for i in range(60)]
    assert find_outliers(fleet, 5.0) == {}


def test_outliers_need_a_fleet():
    assert find_outliers([*make_fleet(6), make_result(7, rmse=1e3)], 5.0) == {}


@pytest.fixture
def design(tmp_path):
    text = TOML + "ratio_limit = 2.0\n[fleet.limits]\nFz = 1.5\n"
    return Design(parse_config(text, tmp_path / "zerodrift.toml"))


def test_verdicts_hold_results_against_the_limits(design):
    outcomes = [
        SensorOutcome("S000", make_result(0)),
        SensorOutcome("S001", make_result(1, rmse=1.6)),
        SensorOutcome("S002", make_result(2, rmse=5.0)),
        SensorOutcome("S003", None, "log|1.csv:3: bad\nrow"),
        SensorOutcome("S004", make_result(4, rmse=math.nan)),
    ]
    report = judge_fleet(design, outcomes)
    assert [v.status for v in report.verdicts] == [PASS, FAIL, FAIL, ERROR, FAIL]
    assert report.verdicts[1].reasons == ("Fz: RMSE 1.6 N > 1.5 N",)
    assert len(report.verdicts[2].reasons) == 2
    values = json.loads(json.dumps(to_dict(summarise_report(report)), allow_nan=False))
    assert (values["passed"], values["failed"], values["errors"]) == (1, 3, 1)
    rows = list(csv.DictReader(io.StringIO(render_csv(report))))
    assert [row["status"] for row in rows] == ["pass", "fail", "fail", "error", "fail"]
    assert rows[2]["Fz rmse [N]"] == "5"
    assert rows[3]["reasons"] == "log|1.csv:3: bad\nrow"
    text = render_markdown(report)
    assert "1 of 5 sensors pass (20.0 %)" in text
    assert "**S003**: log\\|1.csv:3: bad row" in text


def test_firmwares_error_is_judged_where_there_is_one(design):
    result = make_result(0)
    worse = {"Fz": replace(result.outputs["Fz"], rmse_integer=1.7)}
    report = judge_fleet(design, [SensorOutcome("S000", replace(result, outputs=worse))])
    assert report.verdicts[0].reasons == ("Fz: RMSE 1.7 N > 1.5 N",)


def test_result_is_read_back_as_it_was_written(tmp_path):
    file = tmp_path / "a.c"
    saved = save_result(tmp_path, tmp_path, make_result(1, rmse=math.nan), {file: b"int x;"})
    assert file.read_text() == "int x;"
    loaded = load_result(tmp_path, tmp_path, "m")
    assert loaded is not None
    assert loaded.files == saved.files and set(loaded.files or {}) == {"a.c"}
    assert math.isnan(loaded.outputs["Fz"].rmse)
    assert loaded.parameters == saved.parameters
    assert load_result(tmp_path, tmp_path, "another mark") is None
    file.write_text("int y;")
    assert load_result(tmp_path, tmp_path, "m") is None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": 99}', '{"format": 1, "sensor": 3}'])
def test_damaged_result_is_computed_anew(tmp_path, text):
    (tmp_path / "result.json").write_text(text)
    assert load_result(tmp_path, tmp_path, "m") is None
