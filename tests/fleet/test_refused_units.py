"""A unit whose firmware the gate refuses fails; the others go on, and the report says why."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.fleet.conftest import SENSORS

from zerodrift.cli.main import cli

pytestmark = pytest.mark.long


def spoil(log: Path) -> None:
    """Write a log's outputs in thousandths of their units."""
    header, *lines = log.read_text().splitlines()
    names = header.split(",")
    columns = [i for i, name in enumerate(names) if name in ("Fz_N", "Mx_Nm")]
    rows = [line.split(",") for line in lines]
    for row in rows:
        for i in columns:
            row[i] = f"{1000.0 * float(row[i]):.6f}"
    log.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")


def take_on(fleet: Path, entry: str) -> None:
    """Accept a note on wrong data."""
    toml = fleet / "zerodrift.toml"
    toml.write_text(toml.read_text().replace("[logs]\n", f'[logs]\naccept = ["{entry}"]\n'))


def test_unit_with_wrong_data_fails_before_it_is_fitted(fleet: Path) -> None:
    spoil(fleet / "fleet" / SENSORS[1] / "chamber_1.csv")
    result = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1", "--json"])
    assert result.exit_code == 1
    told = {r["sensor"]: r for r in json.loads(result.stdout)["results"]}
    assert [told[sensor]["status"] for sensor in SENSORS] == ["pass", "error", "pass"]
    assert 'accept = ["chamber_1: gain"]' in told[SENSORS[1]]["reasons"][0]


def test_refused_unit_fails_with_its_reason_and_the_others_pass(fleet: Path) -> None:
    spoil(fleet / "fleet" / SENSORS[1] / "chamber_1.csv")
    take_on(fleet, "chamber_1: gain")  # what the gate says is looked at, not the referee
    result = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1", "--json"])
    assert result.exit_code == 1
    report = json.loads(result.stdout)
    told = {r["sensor"]: r for r in report["results"]}
    assert [told[sensor]["status"] for sensor in SENSORS] == ["pass", "fail", "pass"]
    refused = told[SENSORS[1]]
    assert refused["refused"] and refused["reasons"][0] == refused["refused"][0]
    assert "no compensation" in refused["reasons"][0]
    assert set(refused["outputs"]["Fz"]["chip_error"]) == {
        "rounding",
        "out_of_range",
        "clamped",
        "saturated",
    }
    assert not (fleet / "firmware" / SENSORS[1]).exists()
    assert (fleet / "firmware" / SENSORS[0] / "ft40.h").is_file()
    assert "no compensation" in (fleet / "build" / "fleet" / "report.md").read_text()

    again = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1"])
    assert again.exit_code == 1 and "3 kept" in again.stdout  # kept, and still refused
    assert "no compensation" in again.stdout

    forced = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1", "--force"])
    assert forced.exit_code == 0 and "2 of 3 sensors pass (66.7 %), 1 forced, 0 fail" in " ".join(
        forced.stdout.split()
    )
    folder = fleet / "firmware" / SENSORS[1]
    assert "#define FT40_FORCED 1" in (folder / "ft40.h").read_text()
    assert json.loads((folder / "manifest.json").read_text())["forced"] == refused["refused"]
    told = json.loads((fleet / "build/fleet/report.json").read_text())
    assert told["forced"] == 1 and told["results"][1]["status"] == "forced"
    assert [r["kept"] for r in told["results"]] == [True, False, True]
    kept = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1", "--force"])
    assert kept.exit_code == 0 and "3 kept" in kept.stdout

    later = CliRunner().invoke(cli, ["fleet", "-C", str(fleet), "--jobs", "1", "--json"])
    assert later.exit_code == 1  # and says what lies there
    reasons = json.loads(later.stdout)["results"][1]["reasons"]
    assert reasons[-1] == f"what lies in firmware/{SENSORS[1]}/ is the firmware of an earlier run"
