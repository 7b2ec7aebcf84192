"""A real Ray cluster whose workers cannot see the driver's files."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import pytest
from tests.fleet.test_parcels import read_all

pytestmark = pytest.mark.slow
PORT = 6399
DRIVE = """
mount -t tmpfs none "$1" && cp -r "$2/." "$1" || exit 99
shift 2
"$@" > "$OUT/stdout" 2> "$OUT/stderr"
echo $? > "$OUT/rc"
cp -r "$HERE/." "$OUT/project"
"""
"""Puts the project where this process, its children, and nobody else can see it."""


def may_mount() -> bool:
    """Tell whether a process may have mounts of its own."""
    tool = shutil.which("unshare")
    command = [str(tool), "-m", "mount", "-t", "tmpfs", "none", "/mnt"]
    return tool is not None and not subprocess.run(command, check=False).returncode


@pytest.fixture
def cluster():
    """Yield address and process of a cluster of one worker, begun apart from any driver."""
    pytest.importorskip("ray", reason="Ray is not installed: requirements-fleet.lock")
    if not may_mount():
        pytest.skip("a process may have no mounts of its own here: `unshare -m` is refused")
    place = tempfile.mkdtemp(prefix="zdray-")  # short: sockets lie below it
    options = ("--num-cpus=1", f"--port={PORT}", f"--temp-dir={place}")
    code = "from ray.scripts.scripts import main; main()"
    options += ("--include-dashboard=false", "--disable-usage-stats", "--block")
    head = subprocess.Popen(
        [sys.executable, "-c", code, "start", "--head", *options],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        cwd="/",
    )
    time.sleep(20)
    assert head.poll() is None, "Ray did not start"
    yield f"127.0.0.1:{PORT}", head.pid
    head.send_signal(signal.SIGTERM)
    try:
        head.wait(60)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def drive(fleet: Path, out: Path, *command: str) -> subprocess.Popen[bytes]:
    """Begin a command on a copy of the fleet that it alone can see; `HIDDEN` is its folder."""
    hidden = out / "hidden"
    hidden.mkdir(parents=True)
    (out / "project").mkdir()
    command = tuple(str(hidden) if part == "HIDDEN" else part for part in command)
    return subprocess.Popen(
        ["unshare", "-m", "sh", "-c", DRIVE, "sh", str(hidden), str(fleet), *command],
        env={**os.environ, "OUT": str(out), "HERE": str(hidden)},
    )


def test_cluster_without_shared_path_gives_the_same_bytes(cluster, done_fleet, fleet, tmp_path):
    out = tmp_path / "out"
    address, head = cluster
    options = ("fleet", "-C", "HIDDEN", "--ray-address", address, "--batch", "1")
    driver = drive(fleet, out, sys.executable, "-m", "zerodrift", *options)
    killed = []
    while driver.poll() is None:
        killed = killed or kill_worker(head)
        time.sleep(0.2)
    assert (out / "rc").read_text() == "0\n", (out / "stderr").read_text()
    assert killed, "no worker was seen at work"
    assert not any((out / "hidden").iterdir()), "the workers could see the driver's files"
    assert read_all(out / "project") == read_all(done_fleet)


def kill_worker(head: int) -> list[int]:
    """Kill the worker of this test's cluster that is at work, as want of memory does."""
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and head in list_parents(process):
            with suppress(OSError):
                if (process / "cmdline").read_bytes().startswith(b"ray::work_away"):
                    os.kill(int(process.name), signal.SIGKILL)
                    return [int(process.name)]
    return []


def list_parents(process: Path) -> list[int]:
    """Return the numbers of the processes that a process descends from."""
    found: list[int] = []
    try:
        while process.name != "1":
            text = (process / "stat").read_text()
            process = process.with_name(text.rpartition(")")[2].split()[1])
            found.append(int(process.name))
    except (OSError, IndexError):
        pass
    return found
