"""From logs to firmware that is given a thermocouple's codes and those of its cold junction."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tests.main_job.conftest import invoke

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.conversions import emf
from zerodrift.dataset.load import load_dataset
from zerodrift.export.integer_model import FLAG_INPUT_RANGE, FLAG_NO_READING
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference

TOML = """\
[sensor]
name = "oven"
time = "time_s"
temperature = {{ {couple}, lsb = 0.03125, range = [20, 400]{rest} }}
sample_period_s = 1.0

[outputs.P]
measured = "P_bar"
unit = "bar"
full_scale = 50

[inputs]
board = {{ column = "board_degC", raw = "int16", lsb = 0.0078125, range = [0, 60] }}

[logs]
train = ["logs/train_*.csv"]
test = ["logs/test.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "none"
"""
COUPLE = (
    'column = "tc", convert = "thermocouple", type = "K", cold_junction = "board", '
    'scale = 2.5e-6, raw = "int16"'
)
LOGS = {"codes": "", "degC": ', unit = "degC", log_is = "quantity"', "uV": ', log_is = "quantity"'}
STEPS, VOLT_PER_CODE = 400, 2.5e-6


def write_project(folder: Path, holds: str) -> Path:
    """Write a project whose logs hold the thermocouple as codes, degC or uV."""
    (folder / "logs").mkdir(parents=True)
    rng = np.random.default_rng(2)
    for k, name in enumerate(("train_1", "train_2", "test")):
        t = np.arange(STEPS)
        degC = 200.0 - 150.0 * np.cos(2.0 * np.pi * (1.0 + 0.3 * k) * t / STEPS)
        board = np.round((30.0 + 8.0 * np.sin(t / 60.0 + k)) * 128.0) / 128.0
        volts = emf("K", degC) - emf("K", board)
        measured = 0.02 * degC + rng.normal(0.0, 0.002, STEPS)
        column = {"codes": np.round(volts / VOLT_PER_CODE), "degC": degC, "uV": 1e6 * volts}[holds]
        table = {"time_s": t, "tc": column, "board_degC": board, "P_bar": measured}
        pl.DataFrame(table).write_csv(folder / "logs" / f"{name}.csv")
    text = TOML.format(rest=LOGS[holds], couple=COUPLE)
    if holds == "uV":
        text = text.replace("scale = 2.5e-6", 'unit = "uV", scale = 2.5')
    (folder / "zerodrift.toml").write_text(text)
    return folder


@pytest.mark.parametrize("holds", LOGS)
def test_whatever_the_log_holds_it_becomes_the_oven_temperature(holds: str, tmp_path: Path) -> None:
    dataset = load_dataset(load_config(write_project(tmp_path / "oven", holds)))
    run = dataset.train[0]
    wanted = 200.0 - 150.0 * np.cos(2.0 * np.pi * run.time_s / STEPS)
    assert np.abs(run.temperature_degC - wanted).max() < (0.04 if holds == "codes" else 2e-3)


@pytest.mark.long
def test_firmware_is_given_the_codes_of_both(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "oven", "codes")
    result = invoke("firmware", "-C", str(folder), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] is True
    conversion = told["conversions"]["temperature"]
    assert (conversion["raw"], conversion["cold_junction"]) == ("int16", "board")
    assert conversion["error"] <= 1.3 * 0.03125 and conversion["table_bytes"] <= 1024
    assert told["rmse"]["integer"]["P"] < 0.01 * told["rmse"]["uncompensated"]["P"]
    header = " ".join(
        (folder / "firmware" / "oven.h").read_text().replace("\n     * ", " ").split()
    )
    assert "V of a thermocouple of type K (IEC 60584-1), its cold junction measured by" in header
    assert "code -32768 and sums beyond the thermocouple's function" in header
    model = load_model(folder / "build" / "model.json")
    assert [c.source for c in model.channels] == ["temperature_degC", "board"]
    raw = round((emf("K", np.array([250.0])) - emf("K", np.array([25.0])))[0] / VOLT_PER_CODE)
    codes = np.array([[[raw, 25 * 128]] * 3 + [[raw, -32768]] + [[raw, 127 * 128]]])
    assert model.convert(codes)[0, 0, 0] * 0.03125 == pytest.approx(250.0, abs=0.06)
    flags = Reference(model).run(codes).flags[0]
    assert flags[:3].tolist() == [0, 0, 0] and flags[3] & FLAG_NO_READING
    assert flags[4] & FLAG_INPUT_RANGE
    check_apply(folder, tmp_path / "out.csv")


def check_apply(folder: Path, out: Path) -> None:
    """Give the chip a log as it was logged."""
    log = folder / "logs" / "test.csv"
    result = invoke("apply", str(log), "-C", str(folder), "--out", str(out))
    assert result.exit_code == 0, result.output
    frame = pl.read_csv(out)
    assert frame["P_compensated"].to_numpy().std() < 0.01 * frame["P_bar"].to_numpy().std()
    assert (frame["flags"] == 0).to_numpy().mean() > 0.95


def test_voltages_that_the_codes_do_not_hold_are_refused(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "oven", "codes")
    toml = folder / "zerodrift.toml"
    toml.write_text(toml.read_text().replace("range = [20, 400]", "range = [20, 2000]"))
    result = invoke("firmware", "-C", str(folder))
    assert result.exit_code == 2
    assert "whatever 'board' is, thermocouple) hold" in str(result.exception)
    assert "expected 20 degC to 2000 degC" in str(result.exception)
    with pytest.raises(InputError, match=r"the cold junction 'board'.*type K is known from -270"):
        text = toml.read_text().replace("range = [0, 60]", "range = [-300, 60]")
        toml.write_text(text.replace("lsb = 0.0078125", "lsb = 0.015625"))
        from zerodrift.dataset.chip_codes import refuse_unsayable

        config = load_config(folder)
        refuse_unsayable(config, load_dataset(config))
