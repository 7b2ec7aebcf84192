"""`--sensor NAME`: what speaks of one model speaks of one unit of a fleet."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result
from tests.fleet.conftest import NETWORK, SENSORS

import zerodrift as zd
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, read_sealed
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import predict_integer
from zerodrift.export.model_files import load_model
from zerodrift.fleet.sensors import open_sensor
from zerodrift.verify.uncertainty import Uncertainty

pytestmark = pytest.mark.long


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


@pytest.fixture
def own_copy(worked_on: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(worked_on, tmp_path / "project"))


def list_files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def succeed(project: Path, *words: object, sensor: str = SENSORS[0]) -> Result:
    result = invoke(*words, "-C", project, "--sensor", sensor)
    assert result.exit_code == 0, (result.output, result.exception)
    return result


def test_train_and_export_write_into_the_units_folder_alone(own_copy: Path) -> None:
    before = list_files(own_copy)
    told = json.loads(succeed(own_copy, "train", "--json").stdout)
    assert set(told["outputs"]) == {"Fz", "Mx"}
    files = json.loads(succeed(own_copy, "export", "--json").stdout)["files"]
    assert "build/fleet/SN01/model.json" in files
    assert all((own_copy / name).is_file() for name in files)
    changed = {n for n, content in list_files(own_copy).items() if before.get(n) != content}
    assert changed and all(name.startswith("build/fleet/SN01/") for name in changed)


def test_firmware_of_one_unit_is_that_of_the_fleet_and_fleet_goes_on(own_copy: Path) -> None:
    told = json.loads(succeed(own_copy, "firmware", "--json").stdout)
    assert told["bit_exact"] and "firmware/SN01/ft40.c" in told["files"]
    report = json.loads((own_copy / "build/fleet/report.json").read_text())
    hashes = {one["sensor"]: one["model_hash"] for one in report["results"]}
    assert told["model_hash"] == hashes["SN01"]  # the same model by either road
    assert json.loads(succeed(own_copy, "verify", "--json").stdout)["bit_exact"]
    again = json.loads(invoke("fleet", "-C", own_copy, "--jobs", 1, "--json").stdout)
    kept = {one["sensor"]: one["kept"] for one in again["results"]}
    assert kept == {"SN01": False, "SN02": True, "SN03": True}
    assert {one["sensor"]: one["model_hash"] for one in again["results"]} == hashes


def test_verify_holds_what_fleet_wrote(own_copy: Path) -> None:
    told = json.loads(succeed(own_copy, "verify", "--json").stdout)
    assert told["bit_exact"] and {"reference", "onnx"} <= set(told["backends"])
    assert [n for n in told["not_checked"] if "golden.npz" in n["what"]]
    assert json.loads(succeed(own_copy, "verify", "--certificate", "--json").stdout)
    assert json.loads(succeed(own_copy, "verify", "--prove", "--json").stdout)["proven"]
    source = own_copy / "firmware/SN01/ft40.c"
    source.write_text(source.read_text().replace("drift", "dirft", 1))
    spoilt = invoke("verify", "-C", own_copy, "--sensor", "SN01")
    assert spoilt.exit_code != 0 and "ft40.c: was changed" in str(spoilt.exception)
    assert succeed(own_copy, "verify", sensor="SN02")


def test_a_unit_is_packaged_with_the_runtime_that_all_share(own_copy: Path) -> None:
    succeed(own_copy, "package", "cmake")
    place = own_copy / "firmware/SN01/packages/cmake"
    assert (place / "src/ft40.c").read_bytes() == (own_copy / "firmware/SN01/ft40.c").read_bytes()
    runtime = (own_copy / "firmware/runtime/zd_runtime.c").read_bytes()
    assert (place / "src/zd_runtime.c").read_bytes() == runtime


def test_a_change_judged_on_one_unit_is_one_of_the_design(own_copy: Path) -> None:
    before = (own_copy / "zerodrift.toml").read_text()
    kept = succeed(own_copy, "add", "thermal_lag", "--force")
    assert "judged on SN01 alone" in kept.stderr
    assert "thermal_lag" in (own_copy / "zerodrift.toml").read_text()
    steps = json.loads(succeed(own_copy, "history", "--json").stdout)["steps"]
    assert [step["step"] for step in steps] == ["start", "+ thermal_lag"]
    assert not json.loads(succeed(own_copy, "history", "--json", sensor="SN02").stdout)["steps"]
    assert "judged on SN01 alone" in succeed(own_copy, "remove", "thermal_lag").stderr
    assert (own_copy / "zerodrift.toml").read_text() == before
    succeed(own_copy, "history", "--restore", 1)
    assert "thermal_lag" in (own_copy / "zerodrift.toml").read_text()


def test_plan_and_neighbour_take_it_too(own_copy: Path, tmp_path: Path) -> None:
    words = ("--hours", 1, "--budget", 1, "--between", "thermal_lag", "creep")
    told = json.loads(succeed(own_copy, "plan", *words, "--json").stdout)
    assert told["programme"] and (own_copy / "build/fleet/SN01/plan.json").is_file()
    out = tmp_path / "drift.csv"
    succeed(own_copy, "neighbour", "polynomial", "--out", out)
    assert out.is_file()


def test_the_python_face_opens_one_unit(own_copy: Path, worked_on: Path) -> None:
    unit = zd.Project(own_copy, sensor="SN02")
    assert "sensor='SN02'" in repr(unit)
    (log,) = (own_copy / "fleet/SN02").glob("test_*.csv")
    assert unit.apply(log).height > 0
    told = json.loads(invoke("compare", "-C", own_copy, "--sensor", "SN02", "--json").stdout)
    assert unit.compare().outputs["Fz"].rmse_heldout == told["outputs"]["Fz"]["rmse_heldout"]
    follower = unit.add("thermal_lag", force=True)
    assert follower.sensor == "SN02" and len(follower.history().steps) == 2
    with pytest.raises(InputError, match="no such sensor"):
        zd.Project(own_copy, sensor="SN99")


def test_units_of_one_program_are_built_by_fleet_alone(fleet: Path) -> None:
    text = (fleet / "zerodrift.toml").read_text()
    (fleet / "zerodrift.toml").write_text(text + '\n[firmware]\ncoefficients = "block"\n')
    for words in (("firmware",), ("verify",), ("package", "cmake")):
        refused = invoke(*words, "-C", fleet, "--sensor", "SN01").exception
        assert isinstance(refused, InputError) and "no unit has C of its own" in str(refused)


def test_a_fleet_without_a_named_unit_is_told_what_it_lacks(fleet: Path) -> None:
    refused = invoke("train", "-C", fleet).exception
    assert isinstance(refused, InputError) and "--sensor NAME" in str(refused)


def test_each_unit_states_the_uncertainty_that_firmware_states(own_copy: Path) -> None:
    path = own_copy / "build/fleet/SN01/uncertainty.json"
    by_fleet = from_json(Uncertainty, read_sealed(path.read_bytes()))
    stated = json.loads(succeed(own_copy, "compare", "--json").stdout)["uncertainty"]
    assert stated["Fz"]["expanded"] > 0.0 and stated["Fz"]["covered_readings"] > 100
    succeed(own_copy, "firmware")
    by_firmware = from_json(Uncertainty, read_sealed(path.read_bytes()))
    assert by_firmware.model_hash == by_fleet.model_hash
    for name, one in by_fleet.outputs.items():
        other = by_firmware.outputs[name]
        assert (one.noise, one.parameters, one.left_out) == pytest.approx(
            (other.noise, other.parameters, other.left_out), rel=1e-9
        )


def test_a_fleet_can_do_without(fleet: Path) -> None:
    assert invoke("fleet", "-C", fleet, "--jobs", 1, "--no-uncertainty").exit_code in (0, 1)
    assert not list((fleet / "build/fleet").glob("*/uncertainty.json"))
    told = json.loads(invoke("fleet", "-C", fleet, "--jobs", 1, "--json").stdout)
    assert not any(one["kept"] for one in told["results"])
    assert len(list((fleet / "build/fleet").glob("*/uncertainty.json"))) == len(SENSORS)


def test_networks_of_units_are_trained_again_together(fleet: Path) -> None:
    text = (fleet / "zerodrift.toml").read_text()
    effect = '[[effect]]\nkind = "dark_current"\n'
    assert effect in text
    (fleet / "zerodrift.toml").write_text(text.replace(effect, NETWORK))
    assert invoke("fleet", "-C", fleet, "--jobs", 1).exit_code in (0, 1)
    kept = [p for s in SENSORS if (p := fleet / "build/fleet" / s / "compensator.json").is_file()]
    networks = [p.parent for p in kept if (p.parent / "network.onnx").is_file()]
    assert networks, "a GRU learns what the effect explained"
    for folder in networks:
        known = from_json(Uncertainty, read_sealed((folder / "uncertainty.json").read_bytes()))
        assert known.method == "leave one run out" and known.outputs["Fz"].parameters > 0.0


def test_a_unit_that_is_not_there_is_refused_by_name(worked_on: Path, tmp_path: Path) -> None:
    refused = invoke("compare", "-C", worked_on, "--sensor", "SN1").exception
    assert isinstance(refused, InputError) and refused.exit_code == 2
    assert "no such sensor; did you mean" in str(refused) and "SN01" in str(refused)
    (tmp_path / "zerodrift.toml").write_text(
        (worked_on / "zerodrift.toml").read_text().split("[fleet]")[0]
    )
    refused = invoke("compare", "-C", tmp_path, "--sensor", "SN01").exception
    assert isinstance(refused, InputError) and "{sensor}" in str(refused)
