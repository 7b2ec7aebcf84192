"""A command that is asked to end takes away what it has put into the project."""

import signal
import subprocess
import sys
import time

import pytest
from tests.loop.conftest import write_project

pytestmark = pytest.mark.long

SLEEPS = """
import time
from pathlib import Path
Path(__file__).with_name("begun").touch()
time.sleep(600)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGINT])
def test_ended_command_leaves_the_project_as_it_was(tmp_path, by):
    project = write_project(tmp_path, runs=3)
    (tmp_path / "mine.py").write_text(SLEEPS)
    project.toml.write_text(project.toml.read_text() + '\n[plugins]\nfiles = ["mine.py"]\n')
    before = project.read_all()
    command = [sys.executable, "-m", "zerodrift", "add", "mine", "-C", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        begun, deadline = tmp_path / "begun", time.monotonic() + 120.0
        while not begun.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.05)
        assert (tmp_path / "build" / ".zerodrift" / "holder.json").exists()
        process.send_signal(by)
        said = process.communicate(timeout=60.0)[0]
    begun.unlink()
    assert process.returncode == 130, said
    assert b"Traceback" not in said
    assert project.read_all() == before


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_workbench_ends_in_silence_where_its_reader_has_gone(tmp_path):
    write_project(tmp_path, runs=3)
    command = [sys.executable, "-m", "zerodrift", "workbench", "--no-browser", "-C", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline()
        process.stdout.close()
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        process.wait(timeout=60.0)
    assert b"sys.exit" not in said and b"Traceback" not in said, said
    assert process.returncode in (1, 130)
