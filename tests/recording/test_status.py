"""What a recorder tells of itself while it runs, when it ends, and when it is killed."""

import json
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from click.testing import CliRunner
from tests.recording.test_recorder import TOML, write_device

from zerodrift.base.errors import InputError
from zerodrift.base.toml_edit import add_log
from zerodrift.cli.main import cli
from zerodrift.recording.coverage import Coverage, Wanted
from zerodrift.recording.recorder import name_journal
from zerodrift.recording.status import (
    CUT_OFF,
    ENDED,
    LATE_S,
    LIVE,
    LOST_S,
    STUCK,
    RecordingStatus,
    list_statuses,
    name_status,
    read_status,
)

NOBODY = 2**22 + 1
"""A process number that Linux does not give."""


def make_status(**known: object) -> RecordingStatus:
    status = RecordingStatus(
        file="/a.parquet",
        source="-",
        why="",
        pid=os.getpid(),
        host=platform.node(),
        at_s=1000.0,
        silent="",
        ended=False,
        covered=Coverage("T", Wanted()).describe(),
    )
    return replace(status, **known)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("known", "late_s", "state"),
    [
        ({}, 0.0, LIVE),
        ({"pid": NOBODY}, LATE_S - 0.1, LIVE),  # it may live where numbers differ
        ({}, LATE_S, STUCK),
        ({"pid": NOBODY}, LATE_S, CUT_OFF),
        ({"host": "another"}, LATE_S, CUT_OFF),
        ({}, LOST_S, CUT_OFF),
        ({"ended": True}, 1e6, ENDED),
    ],
)
def test_a_recorder_is_judged_by_its_last_word(
    known: dict[str, object], late_s: float, state: str
) -> None:
    assert make_status(**known).judge(1000.0 + late_s) == state


def make_project(folder: Path) -> Path:
    (folder / "logs").mkdir(parents=True)
    (folder / "zerodrift.toml").write_text(TOML)
    return folder


def start(folder: Path, log: Path, rows: int, pause_s: float) -> "subprocess.Popen[bytes]":
    source = write_device(folder, rows, pause_s)
    words = ["record", source, "-C", str(folder), "--out", str(log), "--json"]
    return subprocess.Popen([sys.executable, "-m", "zerodrift", *words], stdout=subprocess.DEVNULL)


def wait_for_rows(folder: Path, rows: int) -> RecordingStatus:
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        for status in list_statuses(folder / "build").values():
            if status.covered.rows >= rows:
                return status
        time.sleep(0.05)
    raise AssertionError("no recorder told of so many rows")


@pytest.mark.long
def test_a_recorder_tells_of_itself_and_that_it_has_ended(tmp_path: Path) -> None:
    folder = make_project(tmp_path / "cell")
    log = folder / "logs" / "a.parquet"
    recorder = start(folder, log, 100_000, 0.01)
    try:
        status = wait_for_rows(folder, 20)
        assert status.judge(time.time()) == LIVE and status.pid == recorder.pid
        assert status.file == str(log.resolve())
        with pytest.raises(InputError, match="is still being recorded"):
            CliRunner().invoke(cli, ["record", "--recover", str(log)], catch_exceptions=False)
        assert name_journal(log).exists()
    finally:
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(60) == 0
    (ended,) = list_statuses(folder / "build").values()
    assert ended.judge(time.time()) == ENDED
    assert ended.covered.rows == pl.read_parquet(log).height
    # The next recording takes the place of one that has ended.
    done = CliRunner().invoke(
        cli,
        ["record", write_device(folder, 5), "-C", str(folder), "--out", str(folder / "b.parquet")],
    )
    assert done.exit_code == 0, done.output
    (other,) = list_statuses(folder / "build").values()
    assert other.file.endswith("b.parquet")


@pytest.mark.long
def test_a_killed_recorder_is_told_from_one_that_ended(tmp_path: Path) -> None:
    folder = make_project(tmp_path / "cell")
    log = folder / "logs" / "a.parquet"
    recorder = start(folder, log, 100_000, 0.01)
    try:
        wait_for_rows(folder, 20)
    finally:
        recorder.kill()
        recorder.wait()
    path = name_status(folder / "build", log)
    status = read_status(path)
    assert status is not None and status.judge(status.at_s + LATE_S) == CUT_OFF
    done = CliRunner().invoke(cli, ["record", "--recover", str(log), "-C", str(folder)])
    assert done.exit_code == 0, done.output
    status = read_status(path)
    assert status is not None and status.judge(time.time()) == ENDED


def test_without_a_row_nothing_is_left(tmp_path: Path) -> None:
    folder = make_project(tmp_path / "cell")
    source, out = f"command:{sys.executable} -c 1", str(folder / "a.parquet")
    done = CliRunner().invoke(cli, ["record", source, "-C", str(folder), "--out", out])
    assert "no row came" in str(done.exception)
    assert list_statuses(folder / "build") == {}


def test_a_damaged_status_is_none(tmp_path: Path) -> None:
    path = name_status(tmp_path, Path("a.parquet"))
    assert read_status(path) is None
    path.parent.mkdir()
    for text in ("", "{}", "[1]", '{"file": 1}', "\udcff"):
        path.write_bytes(text.encode(errors="surrogateescape"))
        assert read_status(path) is None and list_statuses(tmp_path) == {}


def test_a_log_is_named_once(tmp_path: Path) -> None:
    folder = make_project(tmp_path / "cell")
    toml = folder / "zerodrift.toml"
    log = folder / "new.parquet"
    done = CliRunner().invoke(cli, ["record", "--use", str(log), "-C", str(folder)])
    assert "there is no such log" in str(done.exception)
    pl.DataFrame({"time_s": [0.0]}).write_parquet(log)
    done = CliRunner().invoke(cli, ["record", "--use", str(log), "-C", str(folder)])
    assert done.exit_code == 0, done.output
    expected = TOML.replace('["logs/*.parquet"]', '["logs/*.parquet", "new.parquet"]')
    assert toml.read_text() == expected
    done = CliRunner().invoke(cli, ["record", "--use", str(log), "-C", str(folder)])
    assert "[logs] matches it already" in str(done.exception)
    assert toml.read_text() == expected


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("train = []\n", 'train = ["n"]\n'),
        ('train = ["a", ]\n', 'train = ["a", "n"]\n'),
        ('train = [\'a[\', "b\\"]"] # ]\n', 'train = [\'a[\', "b\\"]", "n"] # ]\n'),
        ('train = [\n  "a#"  # b\n]\n', 'train = [\n  "a#",  # b\n  "n",\n]\n'),
        ('train = [\r\n  "a",\r\n]\r\n', 'train = [\r\n  "a",\r\n  "n",\r\n]\r\n'),
        ('train = ["a",\n  "b"]\n', 'train = ["a",\n  "b", "n"]\n'),
    ],
)
def test_a_log_is_added_and_nothing_else_changes(before: str, after: str) -> None:
    assert add_log(f"[logs]\n{before}[x]\n", "n") == f"[logs]\n{after}[x]\n"


def test_a_list_that_cannot_be_edited_is_refused() -> None:
    for text in ('logs = { train = ["a"] }\n', '[logs]\ntest = ["a"]\n', '[logs]\ntrain = "a"\n'):
        with pytest.raises(InputError, match="by hand"):
            add_log(text, "n")


def test_the_status_is_json_of_its_record(tmp_path: Path) -> None:
    folder = make_project(tmp_path / "cell")
    done = CliRunner().invoke(
        cli,
        ["record", write_device(folder, 5), "-C", str(folder), "--out", str(folder / "b.parquet")],
    )
    assert done.exit_code == 0, done.output
    (path,) = (folder / "build" / "recordings").iterdir()
    assert json.loads(path.read_text())["covered"]["rows"] == 5
