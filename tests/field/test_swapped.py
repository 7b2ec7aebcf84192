"""`monitor` on a unit of a fleet that was swapped for another: which one it is."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from tests.field.conftest import BEGIN_S, DAY, OUTPUT, REST, write_log
from tests.projects import render_toml

from zerodrift.cli.main import cli
from zerodrift.field.registry import open_registry
from zerodrift.field.summary import MonitorResult, UnitSought
from zerodrift.report.results import read_result

pytestmark = pytest.mark.long

SLOPES = {"SN01": 0.30, "SN02": 1.9, "SN03": -1.4, "SN04": 0.9}
SWINGS = {"SN04": 0.7}
"""Of temperature while it was calibrated, as a share of the others'."""
SWAPPED = 20 * DAY
FLEET = '\n[fleet]\nfolder = "units/{sensor}"\n'
BLOCK = '\n[firmware]\ncoefficients = "block"\n'


def render_fleet(more: str = "") -> str:
    rest = REST.replace("logs/", "")
    return render_toml(rest + FLEET + more, name="small", period_s=60.0, outputs=(OUTPUT,))


def make_fleet(folder: Path, more: str = "") -> Path:
    """Build a fleet whose units differ in slope."""
    for number, (serial, slope) in enumerate(SLOPES.items()):
        unit = folder / "units" / serial
        unit.mkdir(parents=True)
        for run in range(4):
            seed, swing = 100 * number + run, SWINGS.get(serial, 1.0)
            write_log(unit / f"run{run}.csv", seed, 2.0, slope=slope, swing=swing)
    (folder / "zerodrift.toml").write_text(render_fleet(more), encoding="utf-8")
    result = CliRunner().invoke(cli, ["fleet", "-C", str(folder), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a built fleet; not to be changed."""
    return make_fleet(tmp_path_factory.mktemp("swapped") / "fleet")


def write_swapped(
    path: Path, slope: float, *, first: int = 0, days: int = 30, bend: float = 0.0
) -> Path:
    """Write a log of SN01, in whose place another unit is from day 20 on.

    Its drift bends by `bend` N per kelvin farther than 8 K from 25 degC.
    """
    day = np.arange(30 * DAY) / DAY
    warm = 25 + 7 * np.sin(2 * np.pi * day) + 3 * np.sin(2 * np.pi * day / 5.3 + 11)
    drift = (slope - SLOPES["SN01"]) * (warm - 25) + bend * np.maximum(np.abs(warm - 25) - 8, 0)
    zero = (np.arange(30 * DAY) >= SWAPPED) * (1.0 + drift)
    whole = write_log(path, 11, 30, begin_s=BEGIN_S, slope=SLOPES["SN01"], zero=zero)
    lines = whole.read_text().splitlines()
    rows = lines[1 + first * DAY : 1 + (first + days) * DAY]
    whole.write_text("\n".join([lines[0], *rows]) + "\n")
    return whole


def watch(project: Path, state: Path, *arguments: object) -> Result:
    told = ["monitor", "-C", str(project), "--sensor", "SN01", "--state", str(state / "s.json")]
    return CliRunner().invoke(cli, [*told, *(str(one) for one in arguments)])


def read(result: Result) -> MonitorResult:
    told = read_result(result.stdout)
    assert isinstance(told, MonitorResult), result.output
    return told


def read_sought(result: Result) -> UnitSought:
    sought = read(result).other_unit
    assert sought is not None, result.output
    return sought


def test_monitor_says_which_unit_of_the_fleet_is_in_place(fleet, tmp_path) -> None:
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN03"])
    metrics = tmp_path / "m.prom"
    result = watch(fleet, tmp_path, log, "--json", "--metrics", metrics)
    assert result.exit_code == 1
    assert read(result).outputs["y"].verdict.cause == "other unit"
    sought = read_sought(result)
    assert (sought.state, sought.named, sought.possible) == ("named", "SN03", ("SN03",))
    assert sought.known == 3
    assert "; this looks like SN03." in str(result.exception)
    assert 'zerodrift_monitor_other_unit{sensor="SN01",serial="SN03"} 1' in metrics.read_text()
    shown = watch(fleet, tmp_path, log)  # read before: the name stays
    assert "SN01: this looks like SN03" in shown.output


def test_monitor_names_none_where_none_fits(fleet, tmp_path) -> None:
    log = write_swapped(tmp_path / "a.csv", -3.0)
    result = watch(fleet, tmp_path, log, "--json")
    sought = read_sought(result)
    assert (sought.state, sought.named, sought.possible) == ("none", "", ())
    assert "none of the 3 other units that are known fits" in str(result.exception)


def test_monitor_says_nothing_of_other_units_after_a_step(fleet, tmp_path) -> None:
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN01"])
    result = watch(fleet, tmp_path, log, "--json")
    assert read(result).outputs["y"].verdict.cause == "step"
    assert read(result).other_unit is None


def test_a_name_comes_from_logs_of_several_calls(fleet, tmp_path) -> None:
    states = []
    for first, days in ((0, 20), (20, 1), (21, 1), (22, 2)):
        log = write_swapped(tmp_path / f"{first}.csv", SLOPES["SN03"], first=first, days=days)
        told = read(watch(fleet, tmp_path, log, "--json"))
        states.append(told.other_unit.state if told.other_unit else "")
    assert states[0] == ""
    assert states[-1] == "named"
    kept = json.loads((tmp_path / "s.json").read_text())["sought"]
    assert kept["named"] == "SN03"
    assert set(kept["models"]) == {"SN02", "SN03", "SN04"}
    assert kept["outputs"]["y"]["looks"] == [11]


def test_a_unit_is_named_that_is_in_use_outside_its_calibrated_range(fleet, tmp_path) -> None:
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN04"], days=23, bend=2.0)
    assert read_sought(watch(fleet, tmp_path, log, "--json")).named == "SN04"
    kept = json.loads((tmp_path / "s.json").read_text())["sought"]["outputs"]["y"]
    assert max(kept["flagged"]["SN04"]) > 0.1
    assert max(kept["flagged"]["SN02"]) == 0.0


def test_a_unit_that_was_there_from_the_first_sample_is_named(fleet, tmp_path) -> None:
    day = np.arange(30 * DAY) / DAY
    warm = 25 + 7 * np.sin(2 * np.pi * day) + 3 * np.sin(2 * np.pi * day / 5.3 + 12)
    zero = (SLOPES["SN02"] - SLOPES["SN01"]) * (warm - 25)
    log = write_log(tmp_path / "a.csv", 12, 30, begin_s=BEGIN_S, zero=zero)
    result = watch(fleet, tmp_path, log, "--json")
    assert read(result).outputs["y"].verdict.cause == "other model"
    assert read_sought(result).named == "SN02"


def test_a_live_source_names_the_unit_too(fleet, tmp_path) -> None:
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN03"], days=25)
    result = watch(fleet, tmp_path, f"command:cat {log}", "--every-s", "86400", "--json")
    assert read_sought(result).named == "SN03"


def test_a_unit_without_a_model_is_told(fleet, tmp_path) -> None:
    project = Path(shutil.copytree(fleet, tmp_path / "project"))
    (project / "build/fleet/SN04/model.json").unlink()
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN03"])
    told = read(watch(project, tmp_path, log, "--json"))
    assert told.other_unit is not None
    assert told.other_unit.known == 2
    assert any(note.startswith("SN04 is not tried: ") for note in told.notes)


def test_blocks_of_the_registry_are_tried(fleet, tmp_path) -> None:
    """The fleet was moved away; what is left are the blocks that the registry holds."""
    project = make_fleet(tmp_path / "project", BLOCK)
    with open_registry(project / "registry.sqlite", make=True) as registry:
        for serial in SLOPES:
            registry.add_unit(serial, "small")
            block = (project / f"firmware/blocks/{serial}.bin").read_bytes()
            registry.add_block(serial, block)
    for serial in ("SN02", "SN03", "SN04"):
        shutil.rmtree(project / "units" / serial)
        shutil.rmtree(project / "build/fleet" / serial)
    log = write_swapped(tmp_path / "a.csv", SLOPES["SN03"])
    told = read_sought(watch(project, tmp_path, log, "--json"))
    assert (told.named, told.known) == ("SN03", 3)
    with open_registry(project / "registry.sqlite") as registry:
        texts = [event.text for event in registry.tell_history("SN01") if event.kind == "finding"]
    assert len(texts) == 1
    assert texts[0].endswith("; this looks like SN03")
