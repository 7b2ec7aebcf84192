"""Workers that see none of the driver's files: the same bytes come back, and no wrong ones."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from tests.fleet.hidden_ray import HiddenRay, RayError

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError
from zerodrift.fleet.parcels import Sealed
from zerodrift.fleet.report import judge_fleet, write_report
from zerodrift.fleet.run import OverRay, Serial, run_fleet
from zerodrift.fleet.sensors import Design

CLUSTER = "host:6379"


def read_all(project: Path) -> dict[str, bytes]:
    """Return what a fleet's run has written."""
    return {
        path.relative_to(project).as_posix(): path.read_bytes()
        for folder in ("build", "firmware")
        for path in (project / folder).rglob("*")
        if path.is_file() and ".zerodrift" not in path.parts
    }


def run_hidden(project, monkeypatch, *hidden, spoil=lambda parcel: parcel, batch=2):
    ray = HiddenRay(project, *hidden, spoil=spoil)
    monkeypatch.setitem(sys.modules, "ray", ray)
    return run(project, OverRay(CLUSTER, 1), batch), ray


def run(project, executor, batch=None):
    design = Design(load_config(project))
    outcomes = run_fleet(design, executor, batch=batch)
    write_report(design, judge_fleet(design, outcomes))
    return outcomes


@pytest.mark.long
def test_workers_that_see_no_file_give_the_same_bytes(done_fleet, fleet, monkeypatch):
    _, ray = run_hidden(fleet, monkeypatch)
    assert ray.ran == 2
    assert read_all(fleet) == read_all(done_fleet)
    outcomes, ray = run_hidden(fleet, monkeypatch)
    assert ray.ran == 0
    assert all(outcome.kept for outcome in outcomes)


OWN = """
from zerodrift.effects import Effect, register
register(Effect(kind="mine", title="mine", build=lambda ops, signals, p: []))
"""


@pytest.mark.long
def test_absolute_logs_and_own_effects_travel(fleet, monkeypatch, tmp_path, edit):
    logs = tmp_path / "logs"
    shutil.move(fleet / "fleet", logs)
    (fleet / "own.py").write_text(OWN)
    edit('"fleet/{sensor}"', f'"{logs}/{{sensor}}"\n\n[plugins]\nfiles = ["own.py"]')
    here = Path(shutil.copytree(fleet, tmp_path / "here"))
    run(here, Serial())
    outcomes, ray = run_hidden(fleet, monkeypatch, logs, batch=3)
    assert ray.ran == 1 and all(outcome.result for outcome in outcomes)
    assert read_all(fleet) == read_all(here)


@pytest.mark.long
def test_bad_log_spoils_its_own_sensor_and_is_told_by_the_drivers_path(fleet, monkeypatch):
    log = fleet / "fleet/SN02/chamber_1.csv"
    lines = log.read_text().splitlines()
    lines[40] = "abc" + lines[40][lines[40].index(",") :]
    log.write_text("\n".join(lines) + "\n")
    here = Path(shutil.copytree(fleet, fleet.with_name("here")))
    outcomes, _ = run_hidden(fleet, monkeypatch)
    assert [outcome.result is None for outcome in outcomes] == [False, True, False]
    assert outcomes == run_fleet(Design(load_config(here)), Serial())


@pytest.mark.long
def test_sensor_without_logs_is_told_as_ever(fleet, monkeypatch):
    (fleet / "fleet/SN01/test_chamber_1.csv").unlink()
    expected = run_fleet(Design(load_config(fleet)), Serial())
    shutil.rmtree(fleet / "build")
    outcomes, _ = run_hidden(fleet, monkeypatch)
    assert outcomes[0] == expected[0]
    assert str(fleet) in outcomes[0].error


@pytest.mark.parametrize("which", ["log", "configuration"])
def test_file_that_is_spoilt_on_its_way_is_refused(fleet, monkeypatch, which):
    def cut(files):
        name = next(iter(files))
        return {**files, name: replace(files[name], content=files[name].content[:-1])}

    def spoil(parcel):
        if which == "configuration":
            return replace(parcel, shared=cut(parcel.shared))
        return replace(parcel, own={**parcel.own, "SN02": cut(parcel.own["SN02"])})

    outcomes, _ = run_hidden(fleet, monkeypatch, spoil=spoil, batch=3)
    broken = [o.sensor for o in outcomes if o.result is None]
    assert broken == (["SN02"] if which == "log" else ["SN01", "SN02", "SN03"])
    assert all("arrived with the SHA-256" in o.error for o in outcomes if o.result is None)
    assert not (fleet / "build/fleet/SN02/result.json").exists()


def test_worker_of_another_version_is_refused(fleet, monkeypatch):
    outcomes, _ = run_hidden(
        fleet, monkeypatch, spoil=lambda parcel: replace(parcel, version="0.0")
    )
    assert all("expected 0.0" in outcome.error for outcome in outcomes)


@pytest.mark.long
def test_foreign_file_stays_where_a_worker_could_not_see_it(fleet, monkeypatch):
    foreign = fleet / "firmware/SN02/ft40.c"
    foreign.parent.mkdir(parents=True)
    foreign.write_text("int mine;")
    outcomes, _ = run_hidden(fleet, monkeypatch)
    assert "was not written by zerodrift" in outcomes[1].error
    assert foreign.read_text() == "int mine;"
    assert not (fleet / "build/fleet/SN02/result.json").exists()


def test_sealed_content_is_what_was_sent():
    sealed = Sealed.of(b"rows")
    assert sealed.open("log") == b"rows"
    with pytest.raises(Exception, match=r"log: arrived with the SHA-256"):
        replace(sealed, content=b"row").open("log")


@pytest.mark.long
def test_blocks_come_back_the_same(fleet, zerodrift, monkeypatch, edit):
    edit("[fleet]", '[firmware]\ncoefficients = "block"\ncalibrated = 2026-03-01\n\n[fleet]')
    here = Path(shutil.copytree(fleet, fleet.with_name("here")))
    assert zerodrift("fleet", "-C", here, "--jobs", 1).code == 0
    monkeypatch.setitem(sys.modules, "ray", HiddenRay(fleet))
    result = zerodrift("fleet", "-C", fleet, "--ray-address", CLUSTER, "--batch", 2)
    assert result.code == 0, result.err
    assert read_all(fleet) == read_all(here)


@pytest.mark.long
def test_worker_that_dies_again_and_again_loses_nothing_that_is_done(fleet, monkeypatch):
    ray = HiddenRay(fleet)
    monkeypatch.setitem(sys.modules, "ray", ray)
    get = ray.get

    def die(task):
        if ray.ran == 1:
            raise RayError("The worker died unexpectedly.")
        return get(task)

    ray.get = die
    with pytest.raises(CheckError, match="a worker died"):
        run(fleet, OverRay(CLUSTER, 1), 1)
    ray.get = get
    outcomes = run(fleet, OverRay(CLUSTER, 1), 1)
    assert [outcome.kept for outcome in outcomes] == [True, False, False]
