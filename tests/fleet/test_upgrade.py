"""`init --upgrade`: the codes that logs chose are written down, the same for every unit."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tests.conftest import Result
from tests.frozen import projects as frozen
from tests.projects import FORCE, render_toml
from tests.state.test_stored import STORED

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.toml_inputs import set_columns
from zerodrift.dataset.chip_codes import choose_input_codes
from zerodrift.dataset.load import load_dataset
from zerodrift.fleet.sensors import configure_sensor

Command = Callable[..., Result]
INPUTS = """
[inputs]
supply = "supply_V"  # measured on the board
humidity = { column = "humidity_pct", range = [0, 100] }
pressure = { column = "p", scale = 0.01, unit = "bar", raw = "uint16" }
clock = "time_s"
"""
REST = '[logs]\ntrain = ["{sensor}/log.csv"]\n'


def write_unit(folder: Path, largest: float) -> None:
    folder.mkdir(parents=True)
    t = np.arange(60.0)
    frame = {"time_s": t, "temperature_degC": 20 + t / 4, "supply_V": largest * t / 59}
    frame |= {"humidity_pct": 40 + t / 10, "p": 100 + t, "Fz_N": t, "ref_Fz_N": 0 * t}
    pl.DataFrame(frame).write_csv(folder / "log.csv")


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    for name, largest in (("SN1", 3.1), ("SN2", 5.2), ("SN3", 11.7)):
        write_unit(tmp_path / name, largest)
    text = render_toml(INPUTS + REST, outputs=(FORCE,))
    (tmp_path / "zerodrift.toml").write_text(text)
    return tmp_path


def list_codes(folder: Path, name: str) -> list[tuple[int, float]]:
    """Return the bits and the lsb of an input, unit by unit."""
    config = load_config(folder)
    found = []
    for unit in ("SN1", "SN2", "SN3"):
        own = configure_sensor(config, unit)
        codes = choose_input_codes(own, name, load_dataset(own).train)
        found.append((codes.bits, codes.lsb))
    return found


def test_units_of_a_design_get_the_same_lsb(fleet: Path, zerodrift: Command) -> None:
    before = (fleet / "zerodrift.toml").read_text()
    assert len(set(list_codes(fleet, "supply"))) == 3
    largest = max(lsb for _, lsb in list_codes(fleet, "supply"))
    done = zerodrift("init", "--upgrade", "-C", fleet)
    assert done.code == 0, done.err
    assert set(list_codes(fleet, "supply")) == {(16, largest)}
    assert len(set(list_codes(fleet, "humidity"))) == 1
    after = (fleet / "zerodrift.toml").read_text()
    changed = [
        (a, b) for a, b in zip(before.splitlines(), after.splitlines(), strict=True) if a != b
    ]
    assert [b.split(" = ")[0] for _, b in changed] == ["supply", "humidity"]
    assert changed[0][1].endswith("}  # measured on the board")
    assert (
        f'supply: raw = "int16", lsb = {largest:.10g}: what the logs of 3 units chose' in done.out
    )
    assert "pressure: left as it is: the hardware's own codes" in done.out
    assert "clock: left as it is: whole seconds" in done.out
    assert tomllib.loads(after)["inputs"]["humidity"] == {
        "column": "humidity_pct",
        "range": [0, 100],
        "raw": "int16",
        "lsb": 2.0**-7,
    }


def test_a_second_upgrade_changes_nothing(fleet: Path, zerodrift: Command) -> None:
    assert zerodrift("init", "--upgrade", "-C", fleet).code == 0
    before = (fleet / "zerodrift.toml").read_bytes()
    done = zerodrift("init", "--upgrade", "-C", fleet, "--json")
    told = json.loads(done.out)
    assert (told["schema"], told["changed"]) == ("upgrade/1", {})
    assert told["kept"]["supply"] == "it states raw and lsb"
    assert (fleet / "zerodrift.toml").read_bytes() == before


def test_a_stored_project_of_an_earlier_day_has_nothing_to_upgrade(
    tmp_path: Path, zerodrift: Command
) -> None:
    import shutil

    shutil.copytree(STORED, tmp_path / "project")
    toml = tmp_path / "project" / "zerodrift.toml"
    before = toml.read_bytes()
    done = zerodrift("init", "--upgrade", "-C", toml.parent)
    assert done.code == 0 and "nothing to upgrade, and nothing written" in done.out
    assert toml.read_bytes() == before


def test_an_earlier_project_keeps_its_bits_when_it_is_upgraded(
    tmp_path: Path, zerodrift: Command
) -> None:
    """Its model, whose lsb followed from the logs, is the same model after the upgrade."""
    folder = frozen.write_project("imported", tmp_path / "imported")

    def list_own() -> dict[str, tuple[int, float, int | None]]:
        config = load_config(folder)
        runs = load_dataset(config).train
        codes = {name: choose_input_codes(config, name, runs) for name in config.inputs}
        return {name: (c.bits, c.lsb, c.no_reading) for name, c in codes.items()}

    before = list_own()
    done = zerodrift("init", "--upgrade", "-C", folder)
    assert done.code == 0, done.err
    assert list_own() == before and set(before) == {"supply", "humidity"}
    frozen_lines = json.loads(frozen.EXPECTED.read_text())
    assert frozen_lines  # what it computes is held by tests/frozen


def test_what_cannot_be_edited_is_refused_and_nothing_is_written(
    fleet: Path, zerodrift: Command
) -> None:
    toml = fleet / "zerodrift.toml"
    text = toml.read_text()
    start, stop = text.index("[inputs]"), text.index("[logs]")
    inline = 'inputs = { supply = "supply_V" }\n'
    toml.write_text(inline + text[:start] + text[stop:])
    before = toml.read_bytes()
    done = zerodrift("init", "--upgrade", "-C", fleet)
    assert done.code == 2 and toml.read_bytes() == before
    assert "zerodrift.toml:1: its layout is not understood well enough to edit it" in done.err
    assert 'Write supply with raw = "int16", lsb = ' in done.err


def test_other_options_beside_it_are_refused(fleet: Path, zerodrift: Command) -> None:
    done = zerodrift("init", "--upgrade", "SN1/log.csv", "-C", fleet)
    assert done.code == 2 and "expected no LOG, --force" in done.err
    done = zerodrift("init", "-C", fleet)
    assert done.code == 2 and "no log is named; expected files or folders" in done.err


def test_a_unit_without_its_logs_stops_it(fleet: Path, zerodrift: Command) -> None:
    (fleet / "SN2" / "log.csv").write_text("time_s,temperature_degC\n0,1\n1,2\n")
    before = (fleet / "zerodrift.toml").read_bytes()
    done = zerodrift("init", "--upgrade", "-C", fleet)
    assert done.code == 2 and "SN2/log.csv" in done.err
    assert (fleet / "zerodrift.toml").read_bytes() == before


def test_layouts_of_a_line() -> None:
    path = Path("zerodrift.toml")
    text = '[inputs]\r\na = \'x\'\r\n"b c" = {column="y"}# why\r\n'
    done = set_columns(text, {"a": {"lsb": 0.5}, "b c": {"raw": "int16", "lsb": 2.0}}, path)
    assert done == (
        '[inputs]\r\na = { column = "x", lsb = 0.5 }\r\n'
        '"b c" = { column = "y", raw = "int16", lsb = 2.0 }# why\r\n'
    )
    with pytest.raises(InputError, match=r"zerodrift\.toml:2: its layout"):
        set_columns("[inputs]\na.column = 'x'\n", {"a": {"lsb": 0.5}}, path)
