"""Day 90 of a fleet: one unit is calibrated again; its chip and `monitor` take the newer block."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.field.conftest import BEGIN_S, write_log
from tests.field.test_swapped import FLEET, SLOPES, make_fleet, render_fleet

from zerodrift.blocks.block import decode_header
from zerodrift.blocks.design import load_design
from zerodrift.blocks.editions import FILE_NAME
from zerodrift.c_runtime.host import HostModel
from zerodrift.cli.main import cli
from zerodrift.codegen.generate import generate_design

ONE, ANOTHER = "SN02", "SN03"
FIRST = '\n[firmware]\ncoefficients = "block"\ncalibrated = 2026-01-01\n'
AGED = SLOPES[ONE] + 0.4


def call(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == code, (result.output, result.exception)
    return result.output if code == 0 else str(result.exception)


def read_blocks(project: Path) -> dict[str, bytes]:
    return {p.stem: p.read_bytes() for p in (project / "firmware" / "blocks").glob("*.bin")}


def calibrate(project: Path, serial: str, slope: float, seed: int) -> None:
    for run in range(4):
        write_log(project / "units" / serial / f"run{run}.csv", seed + run, 2.0, slope=slope)


def build(project: Path, day: str) -> dict[str, bytes]:
    """Let `fleet` calibrate with a date; return the units' blocks."""
    text = render_fleet(FIRST.replace("2026-01-01", day))
    (project / "zerodrift.toml").write_text(text, encoding="utf-8")
    call("fleet", "-C", project, "--jobs", 1)
    return read_blocks(project)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return a fleet with blocks, on the chips of which they are, by its registry."""
    assert FLEET in render_fleet(FIRST)
    folder = tmp_path / "fleet"
    folder.mkdir()
    call("registry", "init", "-C", folder)
    make_fleet(folder, FIRST)
    for serial in SLOPES:
        file = folder / "firmware" / "blocks" / f"{serial}.bin"
        call("registry", "block", serial, file, "--loaded", "-C", folder)
    return folder


def test_the_chip_and_monitor_take_the_block_of_day_90(project: Path, tmp_path: Path) -> None:
    before = read_blocks(project)
    assert set(before) == set(SLOPES)
    calibrate(project, ONE, AGED, 900)
    after = build(project, "2026-04-01")
    same = {serial for serial in SLOPES if after[serial] == before[serial]}
    assert same == set(SLOPES) - {ONE}  # the date in zerodrift.toml dates no other unit anew
    old, new = (decode_header(blocks[ONE], ONE).notes for blocks in (before, after))
    assert (old.calibrated.isoformat(), new.calibrated.isoformat()) == ("2026-01-01", "2026-04-01")
    assert new.sequence > old.sequence

    design = load_design(project / "firmware" / "program" / "design.json")
    host = HostModel(design.model, generate_design(design), tmp_path, observe=False)
    assert host.choose_block(before[ONE], after[ONE]) == 1
    assert host.choose_block(after[ONE], before[ONE]) == 0

    log = write_log(tmp_path / "field.csv", 990, 16, begin_s=BEGIN_S + 90 * 86_400, slope=AGED)
    watch = ("monitor", "-C", project, "--sensor", ONE, log, "--state", tmp_path / "s.json")
    call(*watch, code=1)  # the registry says that the old block is still on it
    file = project / "firmware" / "blocks" / f"{ONE}.bin"
    call("registry", "block", ONE, file, "--loaded", "-C", project)
    told = call(*watch)
    assert "is on SN02 since" in told and "nothing has changed" in told
    events = json.loads(call("registry", "history", ONE, "-C", project, "--json"))["events"]
    kinds = [event["kind"] for event in events]
    assert (kinds.count("calibrated"), kinds.count("block"), kinds.count("loaded")) == (2, 2, 2)


@pytest.mark.long
def test_a_unit_keeps_its_sequence_without_build_folder_or_registry(project: Path) -> None:
    calibrate(project, ONE, AGED, 900)
    second = build(project, "2026-04-01")
    for path in project.glob("registry.sqlite*"):
        path.unlink()
    shutil.rmtree(project / "build")
    shutil.rmtree(project / "firmware" / "blocks")
    assert build(project, "2026-05-01") == second
    units = json.loads((project / FILE_NAME).read_text())["units"]
    assert units[ONE]["calibrated"] == "2026-04-01"
    assert units[ANOTHER]["calibrated"] == "2026-01-01"


@pytest.mark.long
def test_a_stated_sequence_that_was_given_stops_the_unit(project: Path) -> None:
    calibrate(project, ONE, AGED, 900)
    notes = decode_header(read_blocks(project)[ONE], ONE).notes
    text = render_fleet(FIRST + f"sequence = {notes.sequence}\n")
    (project / "zerodrift.toml").write_text(text, encoding="utf-8")
    result = CliRunner().invoke(cli, ["fleet", "-C", str(project), "--jobs", "1"])
    assert result.exit_code == 1
    assert f"State {notes.sequence + 1} or more" in result.output
