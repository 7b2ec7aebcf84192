"""A plain install goes from logs to checked C; whoever lacks an extra is told its name."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.surroundings.conftest import REST, write_project

import zerodrift
from zerodrift.cli import main

pytestmark = pytest.mark.long

BLOCKER = """
import sys
ABSENT = {"torch", "plotly", "dash", "ray", "serial", "can", "cantools", "paho"}
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ABSENT:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
"""
BANK = REST.replace('kind = "none"', 'kind = "lag_bank"')


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder on the path of imports that hides what a plain install lacks."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "sitecustomize.py").write_text(BLOCKER)
    return folder


def run(place: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    package = str(Path(zerodrift.__file__).parents[1])
    path = os.pathsep.join([str(place), os.environ.get("PYTHONPATH", package)])
    return subprocess.run(
        [sys.executable, "-m", "zerodrift", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": path},
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_the_lag_banks_road_needs_no_extra(place: Path, tmp_path: Path) -> None:
    project = write_project(tmp_path / "project", BANK)
    log = project / "logs/run3.csv"
    for words in (
        ("firmware", "-C", project),
        ("verify", "-C", project),
        ("compare", "-C", project),
        ("diagnose", "-C", project),
        ("apply", log, "-C", project, "--out", tmp_path / "out.parquet"),
        ("diff", project, project / "firmware"),
        ("package", "cmake", "-C", project),
        ("history", "-C", project),
    ):
        done = run(place, *words)
        assert done.returncode == 0, (words, done.stderr)


def test_a_report_needs_no_extra(place: Path, tmp_path: Path) -> None:
    project = write_project(tmp_path / "project", REST)
    done = run(place, "report", "-C", project, "-o", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
    assert "<svg" in (tmp_path / "report.html").read_text()


def test_who_lacks_an_extra_is_told_its_name(place: Path, tmp_path: Path) -> None:
    project = write_project(tmp_path / "project", REST.replace('"none"', '"gru"'))
    for words, extra in (
        (("train", "-C", project), "pip install 'torch"),
        (("workbench", "-C", project), "'dash>=3'"),
        (("record", "serial:/dev/none", "--out", "log.parquet"), "pip install 'pyserial"),
        (("record", "mqtt:localhost/a", "--out", "log.parquet"), "pip install 'pyserial"),
        (("record", "can:virtual:a", "--out", "log.parquet"), "pip install 'pyserial"),
    ):
        done = run(place, *words)
        assert done.returncode == 2, (words, done.stderr)
        assert extra in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_who_lacks_the_laboratory_is_told_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(main, "list_commands", lambda: {"init": ("", "")})
    done = CliRunner().invoke(main.cli, ["twin"])
    assert done.exit_code == 2
    assert "pip install ./lab" in done.output
