"""Logs that are named by a URL: fetched whole or refused, told by sensor and URL."""

import hashlib
import json
import re
import shutil
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from tests.fleet.hidden_ray import HiddenRay

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.fleet.run import OverRay, Serial, run_fleet
from zerodrift.fleet.sensors import Design, fetch

fsspec = pytest.importorskip("fsspec")
FOLDER = '"fleet/{sensor}"'


@pytest.fixture
def memory():
    """Return an empty store in this process's memory."""
    store = fsspec.filesystem("memory")
    store.store.clear()
    yield store
    store.store.clear()


def upload(fleet: Path, store) -> None:
    for log in (fleet / "fleet").rglob("*.csv"):
        store.pipe(f"/plant/{log.relative_to(fleet).as_posix()}", log.read_bytes())


def run(fleet: Path, executor=None):
    return run_fleet(Design(load_config(fleet)), executor or Serial(), batch=2)


@pytest.mark.long
def test_logs_in_a_store_give_the_same_c(done_fleet, fleet, memory, edit):
    upload(fleet, memory)
    shutil.rmtree(fleet / "fleet")
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    outcomes = run(fleet)
    assert [outcome.error for outcome in outcomes] == ["", "", ""]
    for name in ("ft40.c", "ft40.h", "certificate.json"):
        path = f"firmware/SN02/{name}"
        assert (fleet / path).read_bytes() == (done_fleet / path).read_bytes()
    assert not list(fleet.rglob("*.csv")) and not list(fleet.rglob("memory*"))
    assert all(outcome.kept for outcome in run(fleet))
    name = "/plant/fleet/SN02/test_chamber_1.csv"
    memory.pipe(name, memory.cat_file(name) + b"\n")
    assert [outcome.kept for outcome in run(fleet)] == [True, False, True]


@pytest.mark.long
def test_cluster_fetches_logs_itself(fleet, memory, edit, monkeypatch):
    upload(fleet, memory)
    shutil.rmtree(fleet / "fleet")
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    here = Path(shutil.copytree(fleet, fleet.with_name("here")))
    run(here)
    seen = []

    def look(parcel):
        seen.extend(name for own in parcel.own.values() for name in own)
        return parcel

    monkeypatch.setitem(sys.modules, "ray", HiddenRay(fleet, spoil=look))
    run(fleet, OverRay("host:1", 1))
    assert seen == []
    for path in (p for p in (here / "build").rglob("*") if p.is_file()):
        assert (fleet / path.relative_to(here)).read_bytes() == path.read_bytes(), path


@pytest.mark.long
def test_selector_of_a_url_takes_runs_parts_and_the_sensors_name(fleet, memory, edit):
    for log in (fleet / "fleet").rglob("*.csv"):
        use = log.name.split("_")[0]
        memory.pipe(f"/plant/{use}/{log.parent.name}-{log.name}", log.read_bytes())
    edit("\n[fleet]\nfolder = " + FOLDER, "")
    edit('"chamber_*.csv"', '"memory://plant/chamber/{sensor}-*.csv@0%:90%"')
    edit('"test_*.csv"', '"memory://plant/test/{sensor}-*.csv"')
    outcomes = run(fleet)
    assert [(outcome.sensor, outcome.error) for outcome in outcomes] == [
        ("SN01", ""),
        ("SN02", ""),
        ("SN03", ""),
    ]


@pytest.mark.long
def test_bad_rows_are_told_by_url(fleet, memory, edit):
    upload(fleet, memory)
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    name = "/plant/fleet/SN02/chamber_1.csv"
    memory.pipe(name, memory.cat_file(name).replace(b"\n1", b"\nabc", 1))
    outcomes = run(fleet)
    assert "memory://plant/fleet/SN02/chamber_1.csv:" in outcomes[1].error
    assert outcomes[0].result is not None and outcomes[2].result is not None


def test_store_that_lacks_a_log_is_told(fleet, memory, edit):
    upload(fleet, memory)
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    memory.rm("/plant/fleet/SN03/test_chamber_1.csv")
    error = run(fleet)[2].error
    assert "sensor SN03: nothing matches 'memory://plant/fleet/SN03/test_*.csv'" in error


@pytest.mark.parametrize("is_right", [True, False])
def test_stated_hash_is_checked(fleet, memory, is_right, tmp_path):
    content = b"time_s,temperature_degC\n"
    told = content if is_right else content[:-1]
    memory.pipe("/plant/a.csv", content)
    memory.pipe("/plant/SHA256SUMS", f"{hashlib.sha256(told).hexdigest()}  a.csv\n".encode())
    if is_right:
        assert [p.read_bytes() for p in fetch("memory://plant/a.csv", tmp_path)] == [content]
        return
    with pytest.raises(InputError, match=r"memory://plant/a\.csv: has the SHA-256 .* expected"):
        fetch("memory://plant/a.csv", tmp_path)


class CutShort(SimpleHTTPRequestHandler):
    """Ends the answer early for the logs of one sensor."""

    def copyfile(self, source, outputfile):
        content = source.read()
        if "SN02" in self.path and self.path.endswith(".csv"):
            content = content[: len(content) // 2]
        outputfile.write(content)

    def log_message(self, *_):
        pass


@pytest.fixture
def server(fleet):
    """Return the address of a server of the fleet's logs that breaks off."""
    httpd = ThreadingHTTPServer(("127.0.0.1", 0), partial(CutShort, directory=fleet))
    Thread(target=httpd.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{httpd.server_port}"
    httpd.shutdown()


def test_answer_that_breaks_off_spoils_its_own_sensor(done_fleet, fleet, server, edit):
    pytest.importorskip("aiohttp", reason="fsspec's HTTP is not installed: the extra `fleet`")
    edit(FOLDER, f'"{server}/fleet/{{sensor}}"')
    outcomes = run(fleet)
    assert [outcome.result is None for outcome in outcomes] == [False, True, False]
    assert f"{server}/fleet/SN02/chamber_1.csv: cannot be read" in outcomes[1].error
    path = "firmware/SN03/ft40.c"
    assert (fleet / path).read_bytes() == (done_fleet / path).read_bytes()


def test_size_that_the_store_does_not_keep_to_is_refused(memory, monkeypatch, tmp_path):
    memory.pipe("/plant/a.csv", b"0123456789")
    monkeypatch.setattr(type(memory), "cat_file", lambda *_, **__: b"01234")
    with pytest.raises(InputError, match=r"memory://plant/a\.csv: 5 bytes came, the store states"):
        fetch("memory://plant/a.csv", tmp_path)


def test_local_file_is_linked_and_not_copied(fleet, tmp_path):
    (found, *_) = fetch(f"file://{fleet}/fleet/SN01/chamber_*.csv", tmp_path / "near")
    assert found.is_symlink() and found.resolve() == fleet / "fleet/SN01/chamber_1.csv"


def test_store_that_is_unknown_or_away_is_told(fleet, zerodrift, edit):
    edit(FOLDER, '"nope://plant/{sensor}"')
    result = zerodrift("fleet", "-C", fleet)
    assert result.code == 2
    assert "nope://plant/*: cannot be read (ValueError: Protocol not known: nope)" in result.err
    edit("nope://plant", "http://127.0.0.1:9/plant")
    result = zerodrift("fleet", "-C", fleet)
    assert result.code == 2 and "http://127.0.0.1:9/plant/*: cannot be read" in result.err


def test_other_commands_refuse_a_url(fleet, memory, zerodrift, edit):
    upload(fleet, memory)
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    result = zerodrift("compare", "-C", fleet, "--sensor", "SN01")
    assert result.code == 2
    assert "is a URL, by which `zerodrift fleet` alone reads logs" in result.err


@pytest.mark.long
def test_blocks_and_registry_with_logs_in_a_store(fleet, memory, zerodrift, edit):
    edit("[fleet]", '[firmware]\ncoefficients = "block"\ncalibrated = 2026-03-01\n\n[fleet]')
    upload(fleet, memory)
    shutil.rmtree(fleet / "fleet")
    edit(FOLDER, '"memory://plant/fleet/{sensor}"')
    assert zerodrift("registry", "init", "-C", fleet).code == 0
    result = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    assert result.code == 0, result.err
    assert json.loads(result.out)["passed"] == 3
    assert re.search(
        rb"memory:/+plant/fleet/SN01/test_chamber_1.csv", (fleet / "registry.sqlite").read_bytes()
    )
