"""sample_period_s = "variable" in zerodrift.toml, in a firmware folder, in a block."""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.units import describe_unit
from tests.projects import render_toml
from tests.variable_step.models import make_model
from tests.verify.conftest import Agreed, write_firmware
from zerodrift.base.config import Config, load_config, parse_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import BlockNotes
from zerodrift.blocks.design import make_design
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import generate_design, generate_unit
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.quantize import quantize
from zerodrift.tasks.apply import Chip
from zerodrift.verify.certificate import certify_design
from zerodrift.verify.host_check import check_host
from zerodrift.verify.replay import replay
from zerodrift.verify.vectors import draw_sequences
from zerodrift_proof.certificate.check import compare

LOGS = '[logs]\ntrain = ["a.csv"]\n'
PERIOD = "sample_period_s = 1.0\n"


def read(sensor: str, rest: str = "") -> Config:
    text = render_toml(LOGS + rest)
    assert PERIOD in text
    return parse_config(text.replace(PERIOD, sensor), Path("zerodrift.toml"))


def test_variable_step_is_read() -> None:
    config = read('sample_period_s = "variable"\nlog_period_s = 0.5\n')
    assert config.variable_step
    assert config.sample_period_s == 0.5


def test_a_number_is_a_fixed_step() -> None:
    assert not read(PERIOD).variable_step


@pytest.mark.parametrize(
    ("sensor", "rest", "message"),
    [
        ('sample_period_s = "variable"\n', "", "log_period_s is missing"),
        ('sample_period_s = "variable"\nlog_period_s = 0\n', "", "between two rows of the logs"),
        ('sample_period_s = "variable"\nlog_period_s = 5000\n', "", "between two rows"),
        ('sample_period_s = "any"\n', "", 'a number > 0, or "variable"'),
        ("sample_period_s = 1.0\nlog_period_s = 1.0\n", "", "Take it out"),
        *(
            (
                'sample_period_s = "variable"\nlog_period_s = 1.0\n',
                f'[network]\nkind = "{kind}"\n',
                'Use kind = "lag_bank" or "none"',
            )
            for kind in ("gru", "lstm", "tcn", "mlp_seq", "auto")
        ),
    ],
)
def test_what_cannot_be_is_refused(sensor: str, rest: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        read(sensor, rest)
    assert "zerodrift.toml:" in str(refused.value)


def test_model_file_keeps_the_step(tmp_path: Path) -> None:
    model = make_model()
    model.save(tmp_path / "model.json")
    found = load_model(tmp_path / "model.json")
    assert found.variable_step
    assert found.hash == model.hash


@pytest.mark.parametrize("change", ["fixed", "warm"])
def test_model_file_that_contradicts_itself_is_refused(change: str, tmp_path: Path) -> None:
    model = make_model()
    wrong = replace(model, variable_step=False)
    if change == "warm":
        wrong = replace(model, guards=replace(model.guards, warm_up_steps=3))
    wrong.save(tmp_path / "model.json")
    with pytest.raises(InputError, match="variable"):
        load_model(tmp_path / "model.json")


@pytest.mark.long
def test_verify_replays_a_folder(tmp_path: Path) -> None:
    directory = write_firmware(tmp_path / "project", make_model())
    outcome = replay(load_config(directory), consent=Agreed())
    assert not outcome.problems
    assert {"host", "onnx"} <= {*outcome.backends}


def make_units(count: int) -> list[IntegerModel]:
    units = []
    for seed in range(count):
        floating, calibration = describe_unit(seed)
        units.append(quantize(replace(floating, variable_step=True), calibration))
    return units


def test_block_holds_rates_and_is_certified(tmp_path: Path) -> None:
    units = make_units(3)
    design = make_design(units)
    assert any(field.place.attribute == "rate_q31" for field in design.fields)
    unit = design.fit(units[1])
    host = HostModel(
        unit, generate_unit(design, unit, BlockNotes("SN1", date(2026, 1, 1), 1)), tmp_path
    )
    assert host.selftest() == 0
    for codes in draw_sequences(unit, 2000).values():
        assert check_host(host, codes).mismatch is None
    codes = draw_sequences(unit, 500)["walk"]
    host.run(codes[:20])
    assert host.restore_after(host.save(), 10**9) == 0
    code = generate_design(design)
    outcome = compare(json.loads(certify_design(design, code)), render_sources(code))
    assert outcome.understood
    assert not outcome.failures


def test_units_with_fixed_and_variable_steps_have_no_design() -> None:
    fixed = quantize(*describe_unit(1))
    with pytest.raises(CheckError, match="the same kind of step"):
        make_design([*make_units(1), fixed])


def test_apply_tells_each_row_its_period() -> None:
    model = make_units(1)[0]
    values = np.linspace(10.0, 40.0, 50)[:, None]
    _, codes = encode_values(model, values)
    assert codes.shape == (50, 2)
    chip = Chip(model)
    whole, _ = chip.run(codes, 0)
    first, _ = chip.run(codes[:20], 0)
    rest, _ = chip.run(codes[20:], None)
    assert (np.concatenate([first, rest]) == whole).all()
