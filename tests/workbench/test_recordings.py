"""A recording beside the page: live, ended with one next step, cut off; wide and narrow."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.workbench.conftest import SCREENSHOTS
from tests.workbench.pages import expect
from tests.workbench.test_workplace import settle

from zerodrift.recording.status import list_statuses
from zerodrift.workbench.recordings import find_offers
from zerodrift.workbench.workplace import Workplace

pytestmark = pytest.mark.long

DEVICE = """\
import sys, time
print("time_s,temperature_degC,Fz_N,Mx_Nm,ref_Fz_N", flush=True)
for k in range({rows}):
    warm = 20.0 + 15.0 * min(k / 400.0, 1.0)
    print(f"{{k}},{{warm:.4f}},{{0.2 * (warm - 25.0) + 0.01 * (k % 7):.4f}},"
          f"{{-0.01 * (warm - 25.0) + 0.001 * (k % 5):.5f}},0", flush=True)
    time.sleep({pause_s})
"""
EXPERIMENT = "\n[experiment]\ntemperature_degC = [20, 35]\n"


def start(project, name, rows, pause_s):
    """Start a recorder in a project; return its process."""
    device = project.directory.parent / "device.py"
    device.write_text(DEVICE.format(rows=rows, pause_s=pause_s))
    words = ["record", f"command:{sys.executable} {device}", "-C", str(project.directory)]
    words += ["--out", str(project.directory / name), "--json"]
    return subprocess.Popen([sys.executable, "-m", "zerodrift", *words], stdout=subprocess.DEVNULL)


def wait_for_rows(project, rows):
    until = time.monotonic() + 120.0
    while time.monotonic() < until:
        for status in list_statuses(project.directory / "build").values():
            if status.covered.rows >= rows:
                return
        time.sleep(0.05)
    raise AssertionError("no recorder told of so many rows")


def end(recorder):
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(60) == 0


@pytest.fixture
def place(project):
    workplace = Workplace(project.directory)
    yield workplace
    workplace.close()


def test_a_growing_log_lets_the_page_rest_and_is_compared_when_asked(place, project):
    text = project.toml.read_text().replace(
        '"logs/run_*.csv"', '"logs/run_*.csv", "logs/*.parquet"'
    )
    project.toml.write_text(text)
    recorder = start(project, "logs/new.parquet", 100_000, 0.002)
    wait_for_rows(project, 600)
    first = place.findings
    assert first is None
    place._marks = place._mark_files()
    for _ in range(20):
        place.poll()
        assert place.job is None
        time.sleep(0.1)
    end(recorder)
    place.poll()
    assert place.job is None
    (one,) = place.recordings.look()
    assert next(offer.words for offer in find_offers(one)) == "Compare with the new log"
    place.look()
    settle(place)
    assert place.findings is not None
    assert "logs/new.parquet" in {source.file for source in place.findings.provenance.files}
    assert place.recordings.look() == ()
    place.poll()
    assert not place.busy  # the log is followed as any other from now on, and is as it was


def keep(page, name):
    """Keep a picture of the window for people to look at."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=str(SCREENSHOTS / f"{name}.png"))


def test_a_recording_in_the_browser(page, bench, project):
    project.toml.write_text(project.toml.read_text() + EXPERIMENT)
    recorder = start(project, "new.parquet", 100_000, 0.02)
    try:
        page.goto(bench.url)
        card = page.locator("#recordings .recording")
        expect(card).to_contain_text("Recording: new.parquet")
        expect(card).to_contain_text("Still to record, by [experiment]")
        expect(card.locator("tbody tr").nth(1)).to_contain_text("temperature_degC")
        before = int(re.search(r"([\d,]+) rows", card.inner_text())[1].replace(",", ""))
        expect(card.locator(".standing")).not_to_contain_text(f"{before:,} rows")
        assert card.locator("button").count() == 0
        for width, scheme in ((1360, "light"), (1360, "dark"), (390, "light"), (390, "dark")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            page.wait_for_function("document.documentElement.scrollWidth <= window.innerWidth")
            keep(page, f"recording_live_{width}_{scheme}")
        page.set_viewport_size({"width": 1360, "height": 900})
        expect(card).to_contain_text("All that [experiment] asks for is covered")
        keep(page, "recording_enough")
    finally:
        end(recorder)
    expect(card).to_contain_text("Recorded: new.parquet")
    expect(card.locator("button.primary")).to_have_count(1)
    expect(card.locator("button.primary")).to_have_text("Add it to the logs")
    keep(page, "recording_ended")
    card.locator("button.primary").click()
    expect(page.locator("#recordings")).to_be_hidden()
    assert '"new.parquet"' in project.toml.read_text()
    settle(bench.place)
    assert "new.parquet" in {s.file for s in bench.place.findings.provenance.files}
    assert page.wrong == []


def test_a_killed_recorder_is_recognised_and_its_file_finished(page, bench, project):
    recorder = start(project, "new.parquet", 100_000, 0.01)
    try:
        page.goto(bench.url)
        card = page.locator("#recordings .recording")
        expect(card).to_contain_text("Recording: new.parquet")
        wait_for_rows(project, 20)
    finally:
        recorder.kill()
        recorder.wait()
    expect(card).to_contain_text("Cut off: new.parquet")
    expect(card.locator("button.primary")).to_have_text("Finish its file")
    keep(page, "recording_cut_off")
    settle(bench.place)
    card.locator("button.primary").click()
    expect(card).to_contain_text("Recorded: new.parquet")
    assert (project.directory / "new.parquet").is_file()
    card.get_by_text("Leave it as it is").click()
    expect(page.locator("#recordings")).to_be_hidden()
    assert list(Path(project.directory / "build" / "recordings").iterdir()) == []
    assert page.wrong == []
