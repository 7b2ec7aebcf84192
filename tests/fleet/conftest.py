"""A small simulated fleet, and commands run on copies of it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.projects import render_toml

from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.logs import render_logs

SENSORS = ("SN01", "SN02", "SN03")

TOML = render_toml("""\
[logs]
train = ["chamber_*.csv"]
test = ["test_*.csv"]

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "dark_current"

[fleet]
folder = "fleet/{sensor}"
""")
NETWORK = '\n[network]\nkind = "gru"\nhidden = 8\nepochs = 40\n'
TOLD = (EffectChoice("zero_tempco"), EffectChoice("dark_current"))


def write_sensor(project: Path, sensor: str, seed: int) -> None:
    """Write the simulated logs of one sensor."""
    recipe = Recipe(
        seed=seed,
        train=("chamber",) * 2,
        test=("chamber",),
        dwell=False,
        channels=(),
        told=TOLD,
        tare="none",
        duration_s=900.0,
    )
    folder = project / "fleet" / sensor
    folder.mkdir(parents=True)
    for name, content in render_logs(simulate(recipe)).items():
        (folder / Path(name).name).write_bytes(content)


@pytest.fixture(scope="session")
def fresh_fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a fleet's project that nothing was done to."""
    project = tmp_path_factory.mktemp("fresh") / "project"
    for seed, sensor in enumerate(SENSORS):
        write_sensor(project, sensor, seed)
    (project / "zerodrift.toml").write_text(TOML)
    return project


@pytest.fixture
def fleet(fresh_fleet: Path, tmp_path: Path) -> Path:
    """Return a copy of the fleet to spoil."""
    return Path(shutil.copytree(fresh_fleet, tmp_path / "project"))


@pytest.fixture(scope="session")
def done_fleet(fresh_fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the fleet after a run in this process; not to be changed."""
    from zerodrift.base.config import load_config
    from zerodrift.fleet.report import judge_fleet, write_report
    from zerodrift.fleet.run import Serial, run_fleet
    from zerodrift.fleet.sensors import Design

    project = Path(shutil.copytree(fresh_fleet, tmp_path_factory.mktemp("done") / "project"))
    design = Design(load_config(project))
    write_report(design, judge_fleet(design, run_fleet(design, Serial())))
    return project


@pytest.fixture
def copy_of_done(done_fleet: Path, tmp_path: Path) -> Path:
    """Return a copy of the finished fleet to change."""
    return Path(shutil.copytree(done_fleet, tmp_path / "project"))


@pytest.fixture
def edit(fleet: Path) -> Callable[[str, str], None]:
    """Return a function that replaces text in the fleet's zerodrift.toml."""

    def replace(old: str, new: str) -> None:
        path = fleet / "zerodrift.toml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return replace
