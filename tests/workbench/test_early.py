"""The first page is there before anything is loaded, and the page takes over its port."""

import http.client
import json
import re
import signal
import subprocess
import sys
import threading
import time
from urllib.parse import quote

import pytest
from tests.workbench.pages import DRAWN, expect

from zerodrift.base.errors import InputError
from zerodrift.workbench.early import READING, EarlyPage, tell_project
from zerodrift.workbench.hold import hold_directory, release_directory
from zerodrift.workbench.server import Workbench

pytestmark = pytest.mark.long

LATER = ("scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.optimize", "torch")
"""What takes long to load, and no page needs to begin."""


def ask(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer, text


def draw(early, wish):
    answer, text = ask(early.port, f"/picture?token={early.token}&wish={quote(wish)}")
    assert answer.status == 200
    return json.loads(text)


def list_loaded(module):
    code = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_first_page_needs_the_standard_library_alone():
    loaded = {name.partition(".")[0] for name in list_loaded("zerodrift.workbench.early")}
    assert not loaded & {"numpy", "polars", "scipy", "dash", "flask", "plotly"}


def test_the_page_begins_without_what_it_needs_later():
    assert not list_loaded("zerodrift.workbench.server") & set(LATER)


def test_facts_are_those_of_the_project(project, tmp_path):
    sensor, effects, logs = tell_project(project.directory)
    assert sensor == "Sensor cell: Fz in N, Mx in Nm"
    assert effects == "Effects in the model: zero_tempco"
    assert re.fullmatch(r"Logs to learn from: logs/run_\*\.csv \(5 files, \d\.\d MB\)", logs)
    assert tell_project(tmp_path) == ()
    project.toml.write_text("[sensor")
    assert tell_project(project.directory) == ()


def test_only_the_owner_of_the_token_is_answered(project):
    early = EarlyPage(project.directory)
    early.begin()
    try:
        answer, text = ask(early.port, f"/?token={early.token}")
        assert answer.status == 200 and READING in text and "zero_tempco" in text
        policy = answer.getheader("Content-Security-Policy")
        assert (
            policy.startswith("default-src 'none'") and "'unsafe-inline'; script-src 'sha" in policy
        )
        assert ask(early.port, f"/picture?token={early.token}")[0].status == 200
        for path, headers in (
            ("/", {}),
            ("/?token=x", {}),
            ("/picture?token=x", {}),
            (f"/alive?token={early.token}", {}),
            (f"/?token={early.token}", {"Host": "example.org"}),
            (f"/?token={early.token}", {"Origin": "http://example.org"}),
        ):
            answer, text = ask(early.port, path, **headers)
            assert (answer.status, text) == (403, "")
    finally:
        early.close()


def test_a_first_chart_comes_from_one_log_alone(project):
    early = EarlyPage(project.directory)
    assert early.read_sketch() == ""
    early.begin()
    try:
        until = time.monotonic() + 60.0
        while not early.read_sketch() and time.monotonic() < until:
            time.sleep(0.05)
        told = draw(early, '{"width": 900}')
        assert told["is_drawn"] and told["early"] and told["width"] == 900.0
        assert "drift of Fz as measured, N" in told["svg"] and "temperature, degC" in told["svg"]
        assert told["svg"].count('<path class="line') == 2
        assert "<script" not in told["svg"]
        for odd in ("", "[]", '{"width": NaN}', '{"width": 1e9}', '{"width": "x"}', "[" * 9999):
            assert draw(early, odd)["width"] == 1000.0
    finally:
        early.close()
    assert early.read_sketch() == ""


def test_where_no_log_can_be_read_there_is_no_chart_and_the_facts_stay(project):
    for log in (project.directory / "logs").glob("run_*.csv"):
        log.write_text("nothing\n")
    target = project.directory.parent / "first.json"
    words = ["-m", "zerodrift.workbench.sketch", str(project.directory), str(target)]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")
    assert not target.exists()


def test_the_first_chart_loads_no_findings():
    loaded = list_loaded("zerodrift.workbench.sketch")
    assert not {name for name in loaded if name.startswith("zerodrift.diagnosis.")}
    assert not loaded & set(LATER)


def test_names_are_text(tmp_path):
    folder = tmp_path / "<b>cell"
    folder.mkdir()
    early = EarlyPage(folder)
    early.begin()
    try:
        text = ask(early.port, f"/?token={early.token}")[1]
        assert "&lt;b&gt;cell" in text and "<b>cell" not in text
    finally:
        early.close()


def test_a_directory_that_is_held_promises_no_page(project):
    handle = hold_directory(project.directory)
    try:
        with pytest.raises(InputError, match="another workbench"):
            hold_directory(project.directory)
    finally:
        release_directory(handle)
    release_directory(hold_directory(project.directory))


def start(project):
    words = ["workbench", "--no-browser", "-C", str(project.directory)]
    process = subprocess.Popen(
        [sys.executable, "-m", "zerodrift", *words], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    url = process.stdout.readline().rpartition(": ")[2].strip()
    return process, url


def test_nobody_who_asks_meanwhile_is_refused(project):
    process, url = start(project)
    port, token = int(url.split(":")[2].split("/")[0]), url.partition("token=")[2]
    try:
        first, until = "", time.monotonic() + 120.0
        while time.monotonic() < until:
            answer, text = ask(port, f"/?token={token}")
            assert answer.status == 200
            first = first or text
            if "_dash" in text:
                break
        assert 'id="early"' in first and "_dash" in text
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_the_first_page_becomes_the_page(page, project):
    process, url = start(project)
    try:
        page.goto(url)
        expect(page.locator("#early, #start, #bench").first).to_be_attached()
        page.wait_for_selector(f".sketch svg .line, {DRAWN}")
        page.wait_for_selector(DRAWN)
        assert page.locator(".sketch:visible").count() == 0
        assert page.wrong == []
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_an_interrupt_that_a_library_swallowed_ends_the_page_all_the_same(project):
    interrupted = threading.Event()
    bench = Workbench(project.directory)
    interrupted.set()
    serving = threading.Thread(target=bench.serve, args=(interrupted,), daemon=True)
    serving.start()
    serving.join(30)
    assert not serving.is_alive()
    bench.close()
