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
from zerodrift.base.toml_edit import set_columns
from zerodrift.dataset.chip_codes import choose_input_codes, choose_temperature_codes
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
    folder.mkdir(parents=True, exist_ok=True)
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
    first, blank, *rest = after.splitlines()
    assert first.startswith("format = 2  # ") and not blank
    changed = [(a, b) for a, b in zip(before.splitlines(), rest, strict=True) if a != b]
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


def test_a_stored_project_of_an_earlier_day_gets_its_format_alone(
    tmp_path: Path, zerodrift: Command
) -> None:
    import shutil

    shutil.copytree(STORED, tmp_path / "project")
    toml = tmp_path / "project" / "zerodrift.toml"
    before = toml.read_text()
    done = zerodrift("init", "--upgrade", "-C", toml.parent)
    assert done.code == 0 and "format = 2: from now on logs have no say" in done.out, done.err
    after = toml.read_text()
    assert after.endswith(f"\n\n{before}") and after.startswith("format = 2")
    done = zerodrift("init", "--upgrade", "-C", toml.parent)
    assert done.code == 0 and "nothing to upgrade, and nothing written" in done.out
    assert toml.read_text() == after


@pytest.mark.long
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
    texts = frozen.render_texts("imported", folder)
    done = zerodrift("init", "--upgrade", "-C", folder)
    assert done.code == 0, done.err
    assert load_config(folder).format == 2
    assert list_own() == before and set(before) == {"supply", "humidity"}
    assert frozen.render_texts("imported", folder) == texts
    expected = json.loads(frozen.EXPECTED.read_text())["imported"]
    assert {part: frozen.digest(text) for part, text in texts.items()} == expected


def state(fleet: Path, line: str, number: int = 2) -> Path:
    """Write the fleet's zerodrift.toml in a format, its supply as the line says."""
    toml = fleet / "zerodrift.toml"
    text = toml.read_text()
    own = next(one for one in text.splitlines() if one.startswith("supply"))
    toml.write_text(f"format = {number}\n\n{text.replace(own, line)}")
    return toml


@pytest.mark.parametrize(
    ("line", "lsb"),
    [
        ('supply = { column = "supply_V", range = [0, 15] }', 2.0**-10),
        ('supply = { column = "supply_V", range = [-16, 12] }', 2.0**-10),
        ('supply = { column = "supply_V", range = [0, 20] }', 2.0**-9),
        ('supply = { column = "supply_V", lsb = 0.001 }', 0.001),
        ('board_temperature = "supply_V"', 2.0**-7),
    ],
)
def test_from_format_2_on_logs_have_no_say(fleet: Path, line: str, lsb: float) -> None:
    """The rule is fixed, and so is the width: what does not fit is refused, not widened."""
    state(fleet, line)
    assert set(list_codes(fleet, line.split(maxsplit=1)[0])) == {(16, lsb)}
    assert set(list_codes(fleet, "clock")) == {(32, 1.0)}
    write_unit(fleet / "SN2", 40000 * lsb)
    with pytest.raises(InputError, match=rf"log\.csv:\d+: .*int16, {lsb:.10g}"):
        list_codes(fleet, line.split(maxsplit=1)[0])


def test_what_nothing_says_is_refused_before_any_work(fleet: Path, zerodrift: Command) -> None:
    toml = state(fleet, 'supply = "supply_V"')
    line = toml.read_text().splitlines().index('supply = "supply_V"') + 1
    done = zerodrift("fleet", "-C", fleet)
    assert done.code == 2
    assert (
        f"zerodrift.toml:{line}: 'supply' states neither lsb nor range; expected one of them"
        in done.err
    )
    assert not (fleet / "build").exists() and not (fleet / "firmware").exists()
    done = zerodrift("init", "--upgrade", "-C", fleet)
    assert done.code == 0, done.err
    assert set(list_codes(fleet, "supply")) == {(16, 2.0**-10)}
    assert toml.read_text().count("format = 2") == 1


@pytest.mark.parametrize("told", ["3", "0", "true", '"2"', "2.0"])
def test_a_format_that_is_not_known_is_refused(fleet: Path, told: str) -> None:
    toml = fleet / "zerodrift.toml"
    toml.write_text(f"format = {told}\n{toml.read_text()}")
    with pytest.raises(InputError, match=r"zerodrift\.toml:1: format is .*; expected 1 or 2"):
        load_config(fleet)


NTC = 'convert = "ntc", r25_ohm = 10000, beta_K = 3950'
DIVIDER = 'divider = { series_ohm = 10000, side = "low", counts = 65536 }, raw = "uint16"'


def write_codes(folder: Path, low: float, high: float) -> None:
    """Write a unit's log whose second thermometer is a converter's codes."""
    folder.mkdir(parents=True, exist_ok=True)
    t = np.arange(60.0)
    frame = {"time_s": t, "temperature_degC": 20 + t / 4, "Fz_N": t, "ref_Fz_N": 0 * t}
    frame["ntc"] = np.round(np.linspace(low, high, 60))
    pl.DataFrame(frame).write_csv(folder / "log.csv")


def test_what_a_converted_code_is_worth_is_no_matter_of_logs_either(
    tmp_path: Path, zerodrift: Command
) -> None:
    for name, ends in (("SN1", (30000, 33000)), ("SN2", (9000, 50000)), ("SN3", (20000, 40000))):
        write_codes(tmp_path / name, *ends)
    inputs = f'\n[inputs]\nbody = {{ column = "ntc", {NTC}, {DIVIDER} }}\n'
    toml = tmp_path / "zerodrift.toml"
    text = render_toml(inputs + REST, outputs=(FORCE,))
    toml.write_text(f"format = 2\n{text}")
    assert set(list_codes(tmp_path, "body")) == {(16, 2.0**-7)}
    toml.write_text(text)
    former = list_codes(tmp_path, "body")
    assert len(set(former)) > 1
    done = zerodrift("init", "--upgrade", "-C", tmp_path)
    assert done.code == 0, done.err
    assert set(list_codes(tmp_path, "body")) == {(16, max(lsb for _, lsb in former))}


def test_a_thermometer_of_which_only_int16_is_stated_keeps_its_lsb(
    tmp_path: Path, zerodrift: Command
) -> None:
    """Such a one takes an lsb by which int16 holds the logs; the upgrade writes it down."""
    for name, top in (("SN1", 40.0), ("SN2", 480.0)):
        (tmp_path / name).mkdir()
        t = np.arange(60.0)
        frame = {"time_s": t, "T": 20 + (top - 20) * t / 59, "Fz_N": t, "ref_Fz_N": 0 * t}
        pl.DataFrame(frame).write_csv(tmp_path / name / "log.csv")
    stated = 'temperature = { column = "T", raw = "int16" }'
    text = render_toml(REST, outputs=(FORCE,))
    toml = tmp_path / "zerodrift.toml"
    toml.write_text(text.replace('temperature = "temperature_degC"', stated))

    def list_own() -> set[float]:
        config = load_config(tmp_path)
        units = [configure_sensor(config, name) for name in ("SN1", "SN2")]
        return {choose_temperature_codes(own, load_dataset(own).train).lsb for own in units}

    assert list_own() == {2.0**-7, 2.0**-6}
    done = zerodrift("init", "--upgrade", "-C", tmp_path)
    assert done.code == 0 and '[sensor] temperature: raw = "int16", lsb = 0.015625' in done.out
    assert list_own() == {2.0**-6}


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
