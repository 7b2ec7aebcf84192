"""The n-th call fails, or is the process's last; the others do what they always do."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.__main__ import build_shim

WRITER = """
import ctypes, sys
folder, way, number = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
ctypes.CDLL(None).zd_fault_arm(folder.encode(), 0, way, ctypes.c_long(number), 1)
import os
for name in ("one", "two"):
    with open(f"{folder}/.{name}", "w") as file:
        file.write("new")
        file.flush()
        os.fsync(file.fileno())
    os.replace(f"{folder}/.{name}", f"{folder}/{name}")
"""
CALLS = ["open", "write", "fsync", "rename"]


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_shim(tmp_path_factory.mktemp("shim"))


def run(shim: Path, folder: Path, way: int, number: int) -> subprocess.CompletedProcess[str]:
    folder.mkdir()
    return subprocess.run(
        [sys.executable, "-c", WRITER, str(folder), str(way), str(number)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "LD_PRELOAD": str(shim)},
    )


def test_calls_on_the_folder_are_counted_and_no_others(shim: Path, tmp_path: Path) -> None:
    done = run(shim, tmp_path / "at", 0, 0)
    calls = [line.split()[0] for line in done.stdout.splitlines()]
    assert (done.returncode, calls) == (0, CALLS * 2)


@pytest.mark.spread(4, "number", range(1, 9))
def test_each_call_can_fail_and_be_the_last(shim: Path, tmp_path: Path, number: int) -> None:
    failed = run(shim, tmp_path / "fails", 1, number)
    assert failed.returncode == 1 and "OSError" in failed.stderr
    killed = run(shim, tmp_path / "dies", 2, number)
    assert killed.returncode == -9
    for folder in ("fails", "dies"):
        left = {path.name for path in (tmp_path / folder).iterdir()}
        assert ("one" in left, "two" in left) == (number > 4, False)
