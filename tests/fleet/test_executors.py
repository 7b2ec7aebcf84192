"""Ray that is missing, that goes away, and that works; interrupts."""

import json
import sys
from types import SimpleNamespace

import pytest

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError
from zerodrift.fleet.run import OverRay, Serial, run_fleet
from zerodrift.fleet.sensors import Design

pytestmark = pytest.mark.long


class RayError(Exception):
    """What Ray raises when its cluster is lost."""


class LostRay:
    """Ray as a fleet sees it, whose cluster goes away after some batches."""

    exceptions = SimpleNamespace(RayError=RayError)

    def __init__(self, batches: int) -> None:
        self.left = batches
        self.is_open = False

    def init(self, **_):
        self.is_open = True

    def shutdown(self):
        self.is_open = False

    def remote(self, **_):
        return lambda function: SimpleNamespace(remote=lambda *arguments: (function, arguments))

    def cluster_resources(self):
        return {"CPU": 1.0}

    def put(self, value):
        return value

    def wait(self, pending, num_returns):
        return pending[:num_returns], pending[num_returns:]

    def get(self, task):
        if self.left == 0:
            raise RayError("The node died.\nmore lines")
        self.left -= 1
        function, arguments = task
        return function(*arguments)


def test_cluster_that_goes_away_keeps_what_was_done(fleet, monkeypatch):
    ray = LostRay(batches=1)
    monkeypatch.setitem(sys.modules, "ray", ray)
    design = Design(load_config(fleet))
    with pytest.raises(CheckError) as caught:
        run_fleet(design, OverRay("ray://host:10001", 1), batch=1)
    assert "the Ray cluster went away or a worker died (RayError: The node died.)" in str(
        caught.value
    )
    assert not ray.is_open
    assert (fleet / "build/fleet/SN01/result.json").exists()
    outcomes = run_fleet(design, Serial())
    assert [o.kept for o in outcomes] == [True, False, False]
    assert all(o.result is not None for o in outcomes)


def test_command_tells_how_far_a_lost_cluster_got(fleet, zerodrift, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", LostRay(batches=2))
    result = zerodrift("fleet", "-C", fleet, "--ray", "--batch", 1)
    assert result.code == 1
    assert "stopped: 2 of 3 sensors are done and kept" in result.err
    assert "the same command goes on" in result.err


def test_ray_that_is_not_installed_is_told(fleet, zerodrift, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    result = zerodrift("fleet", "-C", fleet, "--ray")
    assert result.code == 2
    assert "pip install 'ray>=" in result.err
    assert not (fleet / "firmware").exists()


def test_interrupt_keeps_what_was_done(fleet, zerodrift, monkeypatch):
    from zerodrift.fleet import run

    work_on, done = run.work_here, []

    def interrupt(design, sensors):
        if done:
            raise KeyboardInterrupt
        done.append(sensors)
        return work_on(design, sensors)

    monkeypatch.setattr(run, "work_here", interrupt)
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--batch", 1)
    assert result.code == 130
    assert "stopped: 1 of 3 sensors are done and kept" in result.err
    monkeypatch.setattr(run, "work_here", work_on)
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    assert [r["kept"] for r in json.loads(result.out)["results"]] == [True, False, False]


@pytest.mark.slow
def test_fleet_over_ray_on_this_machine(done_fleet, fleet, zerodrift):
    pytest.importorskip("ray", reason="Ray is not installed: requirements-fleet.lock")
    result = zerodrift("fleet", "-C", fleet, "--ray", "--jobs", 1, "--batch", 2, "--json")
    assert result.code == 0, result.err
    path = "firmware/SN03/ft40.c"
    assert (fleet / path).read_bytes() == (done_fleet / path).read_bytes()
