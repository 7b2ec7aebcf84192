"""`--sensor NAME`: what speaks of one model speaks of one unit of a fleet."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result
from tests.fleet.conftest import SENSORS

from zerodrift.app.cli import cli
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import predict_integer
from zerodrift.export.model_files import load_model
from zerodrift.fleet.sensors import open_sensor


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


@pytest.fixture(scope="module")
def worked_on(fresh_fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    project = Path(shutil.copytree(fresh_fleet, tmp_path_factory.mktemp("one") / "project"))
    result = invoke("fleet", "-C", project, "--jobs", 1)
    assert result.exit_code in (0, 1), result.output
    return project


def test_compare_speaks_of_one_unit(worked_on: Path) -> None:
    told = {}
    for sensor in SENSORS:
        result = invoke("compare", "-C", worked_on, "--sensor", sensor, "--json")
        assert result.exit_code == 0, result.output
        told[sensor] = json.loads(result.stdout)["outputs"]
    report = json.loads((worked_on / "build/fleet/report.json").read_text())
    for one in report["results"]:
        for name, output in one["outputs"].items():
            found = told[one["sensor"]][name]["rmse_heldout"]
            assert found == pytest.approx(output["rmse"], rel=1e-6)


def test_the_units_integers_are_compared_and_applied(worked_on: Path, tmp_path: Path) -> None:
    sensor = SENSORS[1]
    result = invoke("compare", "-C", worked_on, "--sensor", sensor, "--model", "integer", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["model"] == "integer"
    (log,) = (worked_on / "fleet" / sensor).glob("test_*.csv")
    out = tmp_path / "out.parquet"
    result = invoke("apply", log, "-C", worked_on, "--sensor", sensor, "--out", out)
    assert result.exit_code == 0, result.output
    (run,) = load_dataset(open_sensor(load_config(worked_on), sensor)).test
    model = load_model(worked_on / "build/fleet" / sensor / "model.json")
    expected = predict_integer(model, run)
    drift = [pl.read_parquet(out)[f"{o.name}_drift"].to_numpy() for o in model.outputs]
    assert np.array_equal(np.stack(drift, axis=1), expected)


def test_diagnose_and_report_take_it_too(worked_on: Path, tmp_path: Path) -> None:
    sensor = SENSORS[0]
    result = invoke("diagnose", "-C", worked_on, "--sensor", sensor, "--json")
    assert result.exit_code == 0 and json.loads(result.stdout)["verdict"], result.output
    page = tmp_path / "r.html"
    words = ("--sensor", sensor, "--no-diagnose", "-o", page)
    assert invoke("report", "-C", worked_on, *words).exit_code == 0
    assert page.is_file()


def test_a_unit_that_is_not_there_is_refused_by_name(worked_on: Path, tmp_path: Path) -> None:
    refused = invoke("compare", "-C", worked_on, "--sensor", "SN1").exception
    assert isinstance(refused, InputError) and refused.exit_code == 2
    assert "no such sensor; did you mean" in str(refused) and "SN01" in str(refused)
    (tmp_path / "zerodrift.toml").write_text(
        (worked_on / "zerodrift.toml").read_text().split("[fleet]")[0]
    )
    refused = invoke("compare", "-C", tmp_path, "--sensor", "SN01").exception
    assert isinstance(refused, InputError) and "{sensor}" in str(refused)
