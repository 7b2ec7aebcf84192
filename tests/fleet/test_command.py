"""`zerodrift fleet` from logs to C and report, through bad logs, reruns and interruptions."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.fleet.conftest import NETWORK, SENSORS

from zerodrift.base.config import load_config
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.model_files import load_model
from zerodrift.fleet.sensors import configure_sensor
from zerodrift.train.training import train
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences


def read_report(project: Path) -> dict:
    return json.loads((project / "build" / "fleet" / "report.json").read_text())


def list_files(project: Path) -> dict[str, tuple[int, bytes]]:
    folders = [project / "firmware", project / "build"]
    return {
        str(p.relative_to(project)): (p.stat().st_mtime_ns, p.read_bytes())
        for folder in folders
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name[:7] != "report."
    }


def test_fleet_writes_checked_c_for_every_sensor(done_fleet, tmp_path):
    report = read_report(done_fleet)
    assert (report["sensors"], report["passed"], report["errors"]) == (3, 3, 0)
    hashes = set()
    for result in report["results"]:
        folder = done_fleet / "firmware" / result["sensor"]
        names = {path.name for path in folder.iterdir()}
        assert names == {
            *("ft40.h", "ft40.c", "parameters.json", "certificate.json", "manifest.json")
        }
        assert result["model_hash"] in (folder / "ft40.h").read_text()
        assert json.loads((folder / "parameters.json").read_text())["model_hash"] in hashes | {
            result["model_hash"]
        }
        hashes.add(result["model_hash"])
        assert result["vectors"] > 5000
        for output in result["outputs"].values():
            assert output["rmse_integer"] == pytest.approx(output["rmse"], rel=0.01)
            assert output["rmse"] < 0.1 * output["rmse_uncompensated"]
        # What lies there is the model's C, and equal to the reference on inputs it has not seen.
        build = done_fleet / "build" / "fleet" / result["sensor"]
        model = load_model(build / "model.json")
        texts = ((folder / name).read_text() for name in ("ft40.h", "ft40.c"))
        code = GeneratedCode("ft40", *texts, generate(model).harness)
        host = HostModel(model, code, tmp_path / result["sensor"])
        for codes in draw_sequences(model, 1000).values():
            assert check_host(host, codes).mismatch is None
    assert len(hashes) == 3
    runtime = {path.name for path in (done_fleet / "firmware" / "runtime").iterdir()}
    assert {"zd_runtime.h", "zd_runtime.c"} <= runtime
    rows = list(csv.DictReader((done_fleet / "build/fleet/report.csv").open()))
    assert [row["sensor"] for row in rows] == list(SENSORS)


def test_sensor_of_a_fleet_is_the_sensor_alone(done_fleet):
    config = configure_sensor(load_config(done_fleet), "SN02")
    alone = train(config, load_dataset(config)).compensator.physics
    kept = json.loads((done_fleet / "build/fleet/SN02/compensator.json").read_text())
    assert kept["physics"]["coefficients"] == alone.coefficients.tolist()


def test_rerun_does_only_what_has_changed(copy_of_done, zerodrift):
    before = list_files(copy_of_done)
    result = zerodrift("fleet", "-C", copy_of_done, "--jobs", 1, "--json")
    assert result.code == 0
    assert [r["kept"] for r in json.loads(result.out)["results"]] == [True] * 3
    assert list_files(copy_of_done) == before

    log = copy_of_done / "fleet" / "SN02" / "chamber_1.csv"
    log.write_text("\n".join(log.read_text().splitlines()[:-1]) + "\n")
    (copy_of_done / "firmware" / "SN03" / "ft40.c").unlink()
    result = zerodrift("fleet", "-C", copy_of_done, "--jobs", 1, "--json")
    assert [r["kept"] for r in json.loads(result.out)["results"]] == [True, False, False]
    after = list_files(copy_of_done)
    changed = {name.split("/")[-2] for name in after if after[name] != before[name]}
    assert changed == {"SN02", "SN03"}
    # What was missing is there again, to the byte.
    assert after["firmware/SN03/ft40.c"][1] == before["firmware/SN03/ft40.c"][1]


def test_files_of_the_users_are_never_replaced(copy_of_done, zerodrift):
    mine = copy_of_done / "firmware" / "SN02" / "ft40.c"
    mine.write_text("mine")
    mine.with_name("manifest.json").unlink()
    result = zerodrift("fleet", "-C", copy_of_done, "--jobs", 1)
    assert result.code == 1 and "2 of 3 sensors pass" in result.out
    (error,) = [r for r in read_report(copy_of_done)["results"] if r["status"] == "error"]
    assert error["sensor"] == "SN02" and "ft40.c: is there and was not written" in str(error)
    assert mine.read_text() == "mine"

    shared = copy_of_done / "firmware" / "runtime" / "zd_runtime.h"
    shared.write_text("mine")
    before = list_files(copy_of_done)
    result = zerodrift("fleet", "-C", copy_of_done, "--jobs", 1)
    assert result.code == 2 and "zd_runtime.h: is there and was not written" in result.err
    assert list_files(copy_of_done) == before


def test_limits_are_judged_anew_without_work(copy_of_done, zerodrift):
    toml = copy_of_done / "zerodrift.toml"
    toml.write_text(toml.read_text() + "[fleet.limits]\nFz = 1e-6\n")
    result = zerodrift("fleet", "-C", copy_of_done, "--jobs", 1)
    assert result.code == 1
    assert "SN01: Fz: RMSE" in result.out
    assert "0 of 3 sensors pass (0.0 %), 3 fail" in result.out
    assert "3 kept from earlier runs" in result.out


def test_bad_log_spoils_its_own_sensor_only(fleet, zerodrift):
    log = fleet / "fleet" / "SN02" / "chamber_1.csv"
    lines = log.read_text().splitlines()
    lines[99] = lines[99].replace(",", ",abc", 1)
    log.write_text("\n".join(lines) + "\n")
    (fleet / "fleet" / "SN03" / "test_chamber_1.csv").unlink()
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1)
    assert result.code == 1
    assert "SN02: fleet/SN02/chamber_1.csv:100: column 'temperature_degC' holds" in result.out
    assert "1 of 3 sensors pass" in result.out
    assert (fleet / "firmware" / "SN01" / "ft40.c").exists()
    for sensor in ("SN02", "SN03"):
        assert not (fleet / "firmware" / sensor).exists()
        assert not (fleet / "build" / "fleet" / sensor / "result.json").exists()
    results = read_report(fleet)["results"]
    assert [r["status"] for r in results] == ["pass", "error", "error"]
    assert "no file matches 'fleet/SN03/test_*.csv'" in results[2]["reasons"][0]


@pytest.mark.long
def test_networks_of_a_fleet_are_those_trained_alone(fleet, zerodrift, edit):
    edit('[[effect]]\nkind = "dark_current"\n', NETWORK)
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    results = json.loads(result.out)["results"]
    refused = any(r["refused"] for r in results)  # a network of so few epochs may be
    assert result.code == int(refused), result.err
    assert any(r["network"] for r in results)
    config = configure_sensor(load_config(fleet), "SN01")
    scores = train(config, load_dataset(config)).scores
    for k, output in enumerate(results[0]["outputs"].values()):
        assert output["rmse"] == pytest.approx(scores.held_out.compensated[k], rel=1e-3)


def test_fleet_without_firmware_writes_none(fleet, zerodrift):
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--no-firmware")
    assert result.code == 0
    assert "no firmware was generated" in result.out
    assert not (fleet / "firmware").exists()
    assert (fleet / "build" / "fleet" / "SN01" / "parameters.json").exists()


@pytest.mark.long
def test_units_have_prefixes_of_their_own(fleet, zerodrift):
    toml = fleet / "zerodrift.toml"
    text = toml.read_text()
    toml.write_text(text + '\n[firmware]\nprefix = "unit {sensor}"\nguard = true\n')
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1).code == 0
    for sensor in ("SN01", "SN02"):
        names = {path.name for path in (fleet / "firmware" / sensor).iterdir()}
        assert {f"unit_{sensor.lower()}.h", f"unit_{sensor.lower()}.c"} <= names
    (fleet / "fleet" / "SN01").rename(fleet / "fleet" / "sn-02")
    (fleet / "fleet" / "SN02").rename(fleet / "fleet" / "SN_02")
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1)
    assert result.code == 2 and "'unit_sn_02'" in result.err


def test_fleet_that_nothing_describes_exits_2_and_writes_nothing(fleet, zerodrift, edit):
    edit('[fleet]\nfolder = "fleet/{sensor}"\n', "")
    result = zerodrift("fleet", "-C", fleet)
    assert result.code == 2
    assert 'folder = "fleet/{sensor}"' in result.err
    assert not (fleet / "build").exists() and not (fleet / "firmware").exists()


@pytest.mark.slow
def test_killed_fleet_goes_on_where_it_was(fleet, zerodrift):
    command = [sys.executable, "-m", "zerodrift", "fleet", "-C", str(fleet), "--batch", "1"]
    process = subprocess.Popen([*command, "--jobs", "1"], env=os.environ)
    first = fleet / "build" / "fleet" / "SN01" / "result.json"
    while not first.exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = [s for s in SENSORS if (fleet / "build" / "fleet" / s / "result.json").exists()]
    assert done
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    assert result.code == 0
    kept = [r["sensor"] for r in json.loads(result.out)["results"] if r["kept"]]
    assert kept == done
    assert not list(fleet.rglob("*.part"))


@pytest.mark.slow
def test_worker_processes_give_the_same_bytes(done_fleet, fleet, zerodrift):
    result = zerodrift("fleet", "-C", fleet, "--jobs", 2)
    assert result.code == 0, result.err
    for sensor in SENSORS:
        for name in ("ft40.c", "ft40.h", "certificate.json"):
            path = f"firmware/{sensor}/{name}"
            assert (fleet / path).read_bytes() == (done_fleet / path).read_bytes()
