"""Nothing waits without sleep and end: a folder that cannot be, or is gone, is told at once."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.golden.vectors import load
from tests.surroundings.conftest import Command, Run, assert_one_message, write_project

from zerodrift.base.errors import InputError
from zerodrift.base.journal import hold_project, read_together, settle_project
from zerodrift.base.lock import REMOVAL_S, find_state, lock_project, make_scratch, take_turns
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import generate

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX only")


@needs_posix
@pytest.mark.parametrize("arguments", [("add", "creep"), ("train",), ("firmware",)])
def test_a_build_that_leads_nowhere_is_one_message(
    arguments: tuple[str, ...], tmp_path: Path, zerodrift: Command
) -> None:
    project = write_project(tmp_path / "p")
    (project / "build").symlink_to("/not/mounted")
    began = time.process_time()
    done = zerodrift(*arguments, "-C", project)
    assert_one_message(done, 2, "build is a link to /not/mounted", "Mount or make it")
    assert time.process_time() - began < 1.0
    assert (project / "build").is_symlink()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_folder_that_no_one_can_make_is_told(zerodrift: Command) -> None:
    began = time.process_time()
    done = zerodrift("twin", "--out", "/proc/zerodrift")
    assert_one_message(done, 2, "/proc/zerodrift", "cannot be written")
    assert time.process_time() - began < 10.0  # the logs were simulated before


def test_a_lock_whose_folder_vanishes_again_and_again_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def vanish(path: Path) -> None:
        raise FileNotFoundError(2, "No such file or directory", str(path))

    monkeypatch.setattr("zerodrift.base.lock.try_lock", vanish)
    began, busy = time.monotonic(), time.process_time()
    with pytest.raises(InputError, match="cannot be written"), lock_project(tmp_path):
        pass
    assert time.monotonic() - began < 10 * REMOVAL_S
    assert time.process_time() - busy < REMOVAL_S


def test_a_record_whose_lock_vanishes_again_and_again_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = find_state(tmp_path)
    state.mkdir(parents=True)
    (state / "0.forward").write_bytes(b"{}")

    def vanish(path: Path) -> None:
        raise FileNotFoundError(2, "No such file or directory", str(path))

    monkeypatch.setattr("zerodrift.base.journal.try_lock", vanish)
    monkeypatch.setattr("zerodrift.base.journal.PATIENCE_S", 0.1)
    with pytest.raises(InputError, match=r"has not ended for 0\.1 s"):
        settle_project(tmp_path)


def test_files_that_never_rest_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zerodrift.base.journal.PATIENCE_S", 0.1)
    count = [0]

    def read() -> int:
        count[0] += 1
        (tmp_path / f"{count[0]}").write_text("new")
        return count[0]

    with pytest.raises(InputError, match="during every attempt"):
        read_together(tmp_path, (tmp_path,), read)
    assert 1 < count[0] < 20


def test_turns_sleep_and_end() -> None:
    began = time.monotonic()
    count = sum(1 for _ in take_turns(0.1, 0.02))
    assert 2 <= count <= 6
    assert time.monotonic() - began >= 0.1
    assert sum(1 for _ in take_turns(0.0)) == 1


@needs_posix
@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_rights_is_told(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="Make the directory writable"), hold_project(tmp_path):
            pass
    finally:
        tmp_path.chmod(0o700)


@needs_posix
@pytest.mark.parametrize("command", ["compare", "verify"])
def test_a_removed_working_directory_is_one_message(command: str, tmp_path: Path, run: Run) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()

    def enter() -> None:
        os.chdir(gone)
        gone.rmdir()

    done = run(command, preexec_fn=enter)
    assert_one_message(done, 2, "current directory was removed", "`cd`")


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 1 MiB; only root can mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or sys.platform != "linux":
        pytest.skip("needs Linux and mount")
    done = subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=1m", "none", str(place)],
        capture_output=True,
        check=False,
    )
    if done.returncode != 0:
        pytest.skip("a small disk can only be mounted by root")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("further_pages", [-4, 2])
def test_a_compiler_on_a_full_disk_is_no_fault_of_the_code(
    further_pages: int, tiny_disk: Path
) -> None:
    """Without room for the sources, and with room for them alone."""
    model = load("ordinary").model
    code = generate(model)
    texts = [*render_sources(code).values(), code.harness]
    page = os.statvfs(tiny_disk).f_frsize
    room = sum(-(-len(text.encode()) // page) for text in texts) + further_pages
    (tiny_disk / "filler").write_bytes(bytes(os.statvfs(tiny_disk).f_bavail * page - room * page))
    with pytest.raises(InputError) as caught, make_scratch(tiny_disk) as scratch:
        HostModel(model, code, scratch / "build", find_compiler())
    told = str(caught.value)
    assert "no space left" in told.lower() and str(tiny_disk) in told
    assert not (tiny_disk / "build").exists()


def test_a_compiler_that_says_the_disk_is_full_is_believed(tmp_path: Path) -> None:
    from zerodrift.c_runtime.compilers import Compiler

    words = "LLVM ERROR: IO failure on output stream: No space left on device"
    program = f"import sys; sys.stderr.write({words!r}); sys.exit(1)"
    compiler = Compiler("stand-in", (sys.executable, "-c", program))
    with pytest.raises(InputError, match="Make room on that disk"):
        compiler.run(["-o", str(tmp_path / "x.so")])
