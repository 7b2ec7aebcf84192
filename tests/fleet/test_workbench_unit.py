"""The page on one unit of a fleet: its logs, its model; what changes is the design of all."""

import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.fleet.conftest import SENSORS

from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.fleet.sensors import FOLDER
from zerodrift.report.results import TrainResult
from zerodrift.workbench.early import tell_project
from zerodrift.workbench.server import Workbench, press
from zerodrift.workbench.workplace import Workplace


def wait(place: Workplace) -> None:
    """Return when nothing runs, a survey that follows a command included."""
    deadline = time.monotonic() + 600.0
    while time.monotonic() < deadline:
        job = place.job
        assert job is not None
        job.wait(600.0)
        if job is place.job:
            return
    raise AssertionError("still busy")


@pytest.mark.long
def test_the_page_works_on_the_unit_that_is_named(fleet: Path) -> None:
    unit, other = SENSORS[1], SENSORS[0]
    bench = Workbench(fleet, sensor=unit)
    place = bench.place
    try:
        wait(place)
        assert place.findings is not None, place.message
        files = {source.file for source in place.findings.provenance.files}
        logs = files - {"zerodrift.toml"}
        assert logs and all(file.startswith(f"fleet/{unit}/") for file in logs)
        press(place, "remove", {"present": "dark_current"})
        wait(place)
        assert place.message is None, place.message
        assert "dark_current" not in (fleet / "zerodrift.toml").read_text()
        press(place, "undo", {})
        wait(place)
        assert "dark_current" in (fleet / "zerodrift.toml").read_text()
        assert (fleet / "build" / FOLDER / unit / "history.json").is_file()
        assert not (fleet / "build" / FOLDER / other).exists()
        press(place, "train", {})
        wait(place)
        assert isinstance(place.outcome, TrainResult), place.message
        assert (fleet / "build" / FOLDER / unit / "compensator.json").is_file()
    finally:
        bench.close()


def test_the_first_page_names_the_unit_and_counts_its_logs(fleet: Path) -> None:
    sensor, _, logs, _ = tell_project(fleet, SENSORS[1])
    assert f"unit {SENSORS[1]}" in sensor
    assert f"fleet/{SENSORS[1]}/chamber_*.csv (2 files" in logs


def test_a_unit_that_is_not_there_is_refused_before_a_page_is_promised(fleet: Path) -> None:
    result = CliRunner().invoke(
        cli, ["workbench", "-C", str(fleet), "--sensor", "SN1", "--no-browser"]
    )
    assert isinstance(result.exception, InputError)
    assert "has no such sensor" in str(result.exception)
    assert "Workbench on" not in result.output


@pytest.mark.parametrize("unit", SENSORS[:1])
def test_what_is_built_of_the_unit_counts_as_changed_from_outside(fleet: Path, unit: str) -> None:
    from zerodrift.workbench.workplace import mark_files

    built = fleet / "build" / FOLDER / unit
    built.mkdir(parents=True)
    before = mark_files(fleet, None, sensor=unit)
    (built / "firmware.json").write_text("{}")
    after = mark_files(fleet, None, sensor=unit)
    assert set(after) - set(before) == {f"build/{FOLDER}/{unit}/firmware.json"}
