"""`monitor` runs what is on the chip: the unit's block in the design's common format."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result
from tests.field.conftest import BEGIN_S, write_log
from tests.fleet.conftest import SENSORS, TOML, write_sensor

from zerodrift.base.errors import InputError
from zerodrift.blocks.block import apply, decode, decode_header, encode_numbers, seal
from zerodrift.blocks.design import BlockDesign, load_design
from zerodrift.cli.main import cli
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.field.registry import FILE_NAME, open_registry
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks import apply as chip
from zerodrift.tasks.monitored_log import Deployed, apply_to, open_log

BLOCK = '\n[firmware]\ncoefficients = "block"\ncalibrated = 2026-03-01\n'


def scale(log: Path, column: str, factor: float) -> None:
    """Multiply a column of a log."""
    frame = pl.read_csv(log).with_columns(pl.col(column) * factor)
    frame.write_csv(log)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a simulated fleet with a program and blocks; not to be changed.

    The last unit drifts a hundred times as much in Fz, which makes the common format coarser.
    """
    project = tmp_path_factory.mktemp("blocks") / "project"
    for seed, sensor in enumerate(SENSORS):
        write_sensor(project, sensor, seed)
    for log in (project / "fleet" / SENSORS[-1]).glob("*.csv"):
        scale(log, "Fz_N", 100.0)
    (project / "zerodrift.toml").write_text(TOML + BLOCK, encoding="utf-8")
    done = CliRunner().invoke(cli, ["fleet", "-C", str(project), "--jobs", "1", "--force"])
    assert done.exit_code == 0, done.output
    return project


@pytest.fixture
def fleet(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "project"))


def open_design(fleet: Path) -> BlockDesign:
    return load_design(fleet / "firmware" / "program" / "design.json")


def read_block(fleet: Path, sensor: str) -> bytes:
    return (fleet / "firmware" / "blocks" / f"{sensor}.bin").read_bytes()


def find_model(fleet: Path, sensor: str) -> IntegerModel:
    """Return what the program computes with a unit's block."""
    design = open_design(fleet)
    return apply(design, decode(design, read_block(fleet, sensor), sensor))


def watch(fleet: Path, sensor: str, *more: object) -> Result:
    log = next((fleet / "fleet" / sensor).glob("test_*.csv"))
    words = ["monitor", str(log), "-C", str(fleet), "--sensor", sensor, "--json", "--reset"]
    return CliRunner().invoke(cli, [*words, *map(str, more)])


def measure(fleet: Path, sensor: str, model: IntegerModel) -> dict[str, float]:
    """Return the RMS of what a model leaves of a unit's log."""
    log = next((fleet / "fleet" / sensor).glob("test_*.csv"))
    config = load_unit(fleet, sensor)
    opened = open_log(Deployed(sensor, sensor, config, model, None, {}), log, skip_invalid=False)
    left = apply_to(chip.Chip(model), config, opened)
    return {
        name: float(np.sqrt(np.mean(residual[left.flags == 0] ** 2)))
        for name, residual in left.residuals.items()
    }


def tell_rms(result: Result) -> dict[str, float]:
    assert result.exit_code == 0, result.output
    return {n: o["rms_residual"] for n, o in json.loads(result.stdout)["outputs"].items()}


@pytest.mark.long
def test_a_unit_runs_in_the_common_format_and_the_reference_agrees(fleet, monkeypatch) -> None:
    is_seen = []
    for sensor in SENSORS[:2]:
        told = watch(fleet, sensor)
        fitted = find_model(fleet, sensor)
        own = load_model(fleet / "build" / "fleet" / sensor / "model.json")
        assert json.loads(told.stdout)["model_hash"] == fitted.hash != own.hash
        assert f"run with the block of {sensor} that was written last" in told.stdout
        rms = tell_rms(told)
        assert rms == pytest.approx(measure(fleet, sensor, fitted), rel=1e-12)
        is_seen.append(rms != pytest.approx(measure(fleet, sensor, own), rel=1e-9))
    assert any(is_seen)  # what the coarser format costs

    def refuse(*_: object, **__: object) -> None:
        raise OSError("no compiler")

    monkeypatch.setattr(chip, "HostModel", refuse)
    by_reference = watch(fleet, SENSORS[1])
    assert "computed by the reference" in by_reference.stdout
    assert tell_rms(by_reference) == rms  # bit for bit


def test_a_block_that_is_handed_over_counts_though_it_is_another_units(fleet) -> None:
    one, other = SENSORS[:2]
    own = tell_rms(watch(fleet, one))
    block = fleet / "firmware" / "blocks" / f"{other}.hex"
    told = watch(fleet, one, "--block", block)
    assert f"the block of {other}, another unit's than {one}," in told.stdout
    assert json.loads(told.stdout)["model_hash"] == find_model(fleet, other).hash
    wrong = tell_rms(told)
    assert wrong["Mx"] > 20.0 * own["Mx"]


def test_the_block_that_the_registry_names_counts_before_that_written_last(fleet) -> None:
    one, other = SENSORS[:2]
    design = open_design(fleet)
    numbers = decode(design, read_block(fleet, other), other).numbers
    header = decode_header(read_block(fleet, one), one)
    notes = replace(header.notes, sequence=header.sequence - 1)  # that of before
    content = encode_numbers(design, numbers, notes, header.answers)
    with open_registry(fleet / FILE_NAME, make=True) as registry:
        registry.add_unit(one, "ft40")
        sha256 = registry.add_block(one, content)
        assert "was written last" in watch(fleet, one).stdout  # entered, not loaded
        registry.load_block(one, sha256)
    told = watch(fleet, one)
    assert f"run with the block {sha256[:12]} that registry.sqlite says is on {one}" in told.stdout
    assert json.loads(told.stdout)["model_hash"] == find_model(fleet, other).hash
    recalibrated = fleet / "firmware" / "blocks" / f"{one}.bin"
    with open_registry(fleet / FILE_NAME) as registry:
        registry.load_block(one, registry.add_block(one, recalibrated.read_bytes()))
    assert json.loads(watch(fleet, one).stdout)["model_hash"] == find_model(fleet, one).hash


def test_a_block_that_no_chip_of_the_design_has_is_refused_with_the_way_out(fleet) -> None:
    one = SENSORS[0]
    content = read_block(fleet, one)
    older = seal(content[:12] + bytes([content[12] ^ 1]) + content[13:-4])
    with open_registry(fleet / FILE_NAME, make=True) as registry:
        registry.add_unit(one, "ft40")
        registry.load_block(one, registry.add_block(one, older))
    refused = watch(fleet, one)
    assert isinstance(refused.exception, InputError)
    text = str(refused.exception)
    assert text.startswith("registry.sqlite, block ") and "a block of design" in text
    assert f"registry block {one} FILE --loaded" in text and "--block FILE" in text
    assert watch(fleet, one, "--block", fleet / f"firmware/blocks/{one}.bin").exit_code == 0
    cut = fleet / "firmware" / "blocks" / f"{SENSORS[1]}.bin"
    cut.write_bytes(content[:-8])
    assert "it was cut" in str(watch(fleet, SENSORS[1]).exception)
    cut.unlink()
    assert "there is no block of SN02" in str(watch(fleet, SENSORS[1]).exception)


@pytest.mark.long
def test_a_single_unit_with_a_block_goes_on_from_its_state(unit, tmp_path) -> None:
    project = Path(shutil.copytree(unit, tmp_path / "project"))
    toml = project / "zerodrift.toml"
    toml.write_text(toml.read_text() + BLOCK + 'serial = "SN0042"\n')
    made = CliRunner().invoke(cli, ["firmware", "-C", str(project)])
    assert made.exit_code == 0, made.output
    steps = []
    for part in range(2):
        begin_s = BEGIN_S + part * 86_400.0
        log = write_log(tmp_path / f"{part}.csv", 60 + part, 1, begin_s=begin_s)
        told = CliRunner().invoke(cli, ["monitor", str(log), "-C", str(project), "--json"])
        assert told.exit_code == 0, told.output
        assert "run with the block of SN0042 that was written last" in told.stdout
        assert "learnt anew" not in told.stdout
        steps.append(json.loads(told.stdout)["steps_in_all"])
    assert steps == [1440, 2880]


def run_over_logs(fleet: Path, out: Path, *more: object) -> pl.DataFrame:
    """Return what `apply` writes of the first unit's test log."""
    log = next((fleet / "fleet" / SENSORS[0]).glob("test_*.csv"))
    words = ["apply", log, "-C", fleet, "--sensor", SENSORS[0], "--out", out, *more]
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return pl.read_csv(out)


def test_apply_answers_as_program_and_block_do(fleet, tmp_path) -> None:
    def predict(model: IntegerModel) -> np.ndarray:
        """Return the drift [n, K] at the log's steps, in units."""
        log = next((fleet / "fleet" / SENSORS[0]).glob("test_*.csv"))
        config = load_unit(fleet, SENSORS[0])
        deployed = Deployed(SENSORS[0], SENSORS[0], config, model, None, {})
        steps = open_log(deployed, log, skip_invalid=False).steps
        drift = chip.answer(chip.Chip(model), config, steps, with_range=False).drift
        return drift / np.array([float(o.lsb_per_unit) for o in model.outputs])

    names = [f"{output.name}_drift" for output in load_unit(fleet, SENSORS[0]).outputs]
    told = run_over_logs(fleet, tmp_path / "applied.csv").select(names).to_numpy()
    own = load_model(fleet / "build" / "fleet" / SENSORS[0] / "model.json")
    assert told == pytest.approx(predict(find_model(fleet, SENSORS[0])), abs=1e-12)
    assert np.abs(told - predict(own)).max() > 1e-9  # the coarser format shows

    other = fleet / "firmware" / "blocks" / f"{SENSORS[1]}.bin"
    named = run_over_logs(fleet, tmp_path / "named.csv", "--block", other)
    assert named.select(names).to_numpy() == pytest.approx(
        predict(find_model(fleet, SENSORS[1])), abs=1e-12
    )


def test_the_float_model_takes_no_block(fleet) -> None:
    block = fleet / "firmware" / "blocks" / f"{SENSORS[0]}.bin"
    log = next((fleet / "fleet" / SENSORS[0]).glob("test_*.csv"))
    words = ["apply", log, "-C", fleet, "--sensor", SENSORS[0], "--model", "float"]
    done = CliRunner().invoke(cli, [*map(str, words), "--block", str(block)])
    assert "the float model takes no block" in str(done.exception)


@pytest.mark.parametrize("kind", ["integer", "c"])
def test_compare_says_which_block_was_run(fleet, kind) -> None:
    words = ["compare", "-C", str(fleet), "--sensor", SENSORS[0], "--model", kind]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    text = " ".join(done.output.split())
    assert f"run with the block of {SENSORS[0]} that was written last" in text
