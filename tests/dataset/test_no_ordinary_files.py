"""What is no ordinary file, in the place of a log or of zerodrift.toml, is told at once."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.dataset.conftest import Project

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.tables import open_source

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
HANGS_AFTER_S = 30


@pytest.fixture(autouse=True)
def ended_if_it_hangs() -> Iterator[None]:
    """End a test that waits for ever, or counts names name by name; each takes under a second."""

    def stop(*_: object) -> None:
        pytest.fail(f"still not done after {HANGS_AFTER_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(HANGS_AFTER_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def test_pipe_as_a_log_is_refused_and_not_waited_for(project: Project) -> None:
    (project.directory / "log.csv").unlink()
    os.mkfifo(project.directory / "log.csv")
    with pytest.raises(InputError, match=r"log.csv: is a named pipe; expected a log"):
        project.load()
    with pytest.raises(InputError, match=r"log.csv: is a named pipe; expected a log"):
        guess_project([project.directory / "log.csv"])


@pytest.mark.parametrize("kind", ["directory", "device"])
def test_directory_or_device_as_a_log_is_refused(tmp_path: Path, kind: str) -> None:
    log = tmp_path / "log.csv"
    if kind == "directory":
        log.mkdir()
    else:
        log.symlink_to("/dev/zero")
    found = "holds no log" if kind == "directory" else "is a device; expected a log"
    with pytest.raises(InputError, match=f"log.csv: {found}"):
        guess_project([log])


@pytest.mark.parametrize("kind", ["named pipe", "directory", "device"])
def test_configuration_that_is_no_file_is_refused_and_not_waited_for(
    tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "zerodrift.toml"
    if kind == "named pipe":
        os.mkfifo(path)
    elif kind == "directory":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match=f"zerodrift.toml: is a {kind}; expected a file"):
        load_config(tmp_path)


def test_directory_among_the_logs_is_named(project: Project) -> None:
    (project.directory / "log.csv").unlink()
    (project.directory / "log.csv").mkdir()
    assert "log.csv" in project.refusal()


def test_header_of_many_columns_is_read_at_once(tmp_path: Path) -> None:
    log = tmp_path / "wide.csv"
    names = ["time_s", "temperature_degC", *(f"x{k}" for k in range(100_000))]
    log.write_text(",".join(names) + "\n" + ",".join("1" * len(names)) + "\n")
    assert open_source(log, "wide.csv", {}).names == tuple(names)


def test_name_given_twice_among_many_columns_is_told(tmp_path: Path) -> None:
    log = tmp_path / "wide.csv"
    log.write_text(",".join(["time_s", *(f"x{k}" for k in range(1000)), "x7", "x7"]) + "\n")
    with pytest.raises(InputError, match="names column 'x7' 3 times"):
        open_source(log, "wide.csv", {})
