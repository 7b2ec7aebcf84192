"""The runtime builds by CMake with every compiler there is, and its ctest programs pass."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from zerodrift.c_runtime.compilers import Compiler, find_compilers

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
TOOLS = Path(sys.prefix) / "bin"


def run(command: str, *arguments: str | Path, **environment: str) -> str:
    """Run one of CMake's programs and return what it said."""
    path = f"{TOOLS}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [shutil.which(command, path=path) or command, *map(str, arguments)],
        env=os.environ | {"PATH": path} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("sanitize", ["OFF", "ON"])
@pytest.mark.parametrize("compiler", find_compilers(), ids=lambda compiler: compiler.name)
def test_ctest_passes(compiler: Compiler, sanitize: str, tmp_path: Path) -> None:
    run(
        "cmake", "-S", ROOT, "-B", tmp_path, "-G", "Ninja", f"-DZD_SANITIZE={sanitize}",
        CC=shlex.join(compiler.command),
    )  # fmt: skip
    run("cmake", "--build", tmp_path, "-j", "1")
    said = run("ctest", "--test-dir", tmp_path)
    assert "100% tests passed" in said
    programs = list((ROOT / "c_runtime" / "tests").glob("test_*.c"))
    assert f"tests passed out of {len(programs) + 1}" in said  # sums also two at a time


@pytest.mark.parametrize("compiler", find_compilers()[:1], ids=lambda compiler: compiler.name)
def test_runtime_serves_another_project(compiler: Compiler, tmp_path: Path) -> None:
    """A firmware project adds the folder and gets the library alone, without tests."""
    golden = ROOT / "tests" / "golden"
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(firmware LANGUAGES C)\n"
        f'add_subdirectory("{ROOT}" zerodrift)\n'
        f'add_library(model STATIC "{golden}/front_end.c")\n'
        "target_link_libraries(model PUBLIC zerodrift_runtime)\n"
    )
    build = tmp_path / "build"
    command = shlex.join(compiler.command)
    run("cmake", "-S", tmp_path, "-B", build, "-G", "Ninja", CC=command)
    run("cmake", "--build", build, "-j", "1")
    assert (build / "libmodel.a").exists()
    assert not list(build.rglob("test_*"))
