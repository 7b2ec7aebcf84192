"""A wheel holds what the commands need, from a log to checked C: no source tree, no compiler."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from tests.house.test_order import ROOT
from tests.surroundings.conftest import write_project

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder into which the wheels of this tree and of the checkers are installed."""
    place = tmp_path_factory.mktemp("wheel") / "site"
    install(ROOT, place)
    install(ROOT / "proof", place)
    return place


def install(source: Path, place: Path) -> None:
    """Build the wheel of a distribution and install it, without what it needs, into a folder."""
    folder = Path(tempfile.mkdtemp(dir=place.parent))
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    build = ("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(source))
    subprocess.run([*pip, *build], check=True)
    (wheel,) = folder.glob("*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", str(place), str(wheel)], check=True)


def run(site: Path, tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run an installed wheel's command where no compiler but the ziglang wheel is to be found."""
    environment = {k: v for k, v in os.environ.items() if k not in ("CC", "PYTHONPATH")}
    return subprocess.run(
        [sys.executable, "-m", "zerodrift", *arguments],
        env=environment | {"PATH": str(tmp_path), "PYTHONPATH": str(site)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_wheel_goes_from_logs_to_checked_c(site: Path, tmp_path: Path) -> None:
    project = write_project(tmp_path / "project")
    done = run(site, tmp_path, "firmware", "-C", str(project))
    assert done.returncode == 0, done.stderr
    assert "bit-exact" in done.stdout
    verified = run(site, tmp_path, "verify", "-C", str(project))
    assert verified.returncode == 0, verified.stderr
    report = run(site, tmp_path, "report", "-C", str(project), "--no-diagnose")
    assert report.returncode == 0, report.stderr


def test_the_laboratory_is_a_wheel_of_its_own(site: Path, tmp_path: Path) -> None:
    assert not (site / "zerodrift_lab").exists()
    install(ROOT / "lab", site)
    assert (site / "zerodrift_lab").is_dir()
    done = run(site, tmp_path, "twin", "-C", str(tmp_path / "twin"), "--runs", "1")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "twin/zerodrift.toml").is_file()


def test_a_wheel_is_what_runs(site: Path, tmp_path: Path) -> None:
    code = "import zerodrift.cli.main as cli; print(cli.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": str(site)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(str(site))


def test_a_checkout_runs_without_links(tmp_path: Path) -> None:
    """As `make setup` installs it: the stages are found through their links."""
    code = (
        "from zerodrift.codegen.identity import find_runtime_identity;"
        "from zerodrift.c_runtime.compilers import RUNTIME_FILES;"
        "assert all(path.is_file() for path in RUNTIME_FILES); print(find_runtime_identity())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("0x")
