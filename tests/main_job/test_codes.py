"""Codes that fit the sensor: hot ones, what the table says, and logs that leave what codes say."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.main_job.conftest import invoke

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator, encode_inputs
from zerodrift.export.integer_model import (
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_TEMPERATURE_RANGE,
    IntegerModel,
)
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.train.training import train

TOML = """\
[sensor]
name = "hot"
time = "time_s"
temperature = {temperature}
sample_period_s = 1.0

[outputs.P]
measured = "P_bar"
unit = "bar"
full_scale = 50

[inputs]
supply = {supply}

[logs]
train = ["logs/train_*.csv"]
test = ["logs/test.csv"]

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "supply_sensitivity"
"""
NAME, STEPS = '"temperature_degC"', 400
PLAIN_SUPPLY = '"supply_V"'


def write_project(
    folder: Path,
    low: float,
    high: float,
    temperature: str = NAME,
    supply: str = PLAIN_SUPPLY,
    test_high: float | None = None,
) -> Path:
    """Write a project whose thermometer goes from low to high; return its folder."""
    (folder / "logs").mkdir(parents=True)
    rng = np.random.default_rng(2)
    for k, name in enumerate(("train_1", "train_2", "test")):
        top = test_high if test_high is not None and name == "test" else high
        t = np.arange(STEPS)
        turn = 0.5 - 0.5 * np.cos(2.0 * np.pi * (1.0 + 0.3 * k) * t / STEPS)
        degC = low + (top - low) * turn
        volt = 5.0 + 0.2 * np.sin(t / (17.0 + k))
        drift = 0.02 * (degC - low) + 0.5 * (volt - 5.0) + rng.normal(0.0, 0.002, STEPS)
        rows = [
            f"{a},{b:.4f},{c:.5f},{d:.5f}" for a, b, c, d in zip(t, degC, volt, drift, strict=True)
        ]
        text = "\n".join(["time_s,temperature_degC,supply_V,P_bar", *rows])
        (folder / "logs" / f"{name}.csv").write_text(text + "\n")
    text = TOML.format(temperature=temperature, supply=supply)
    (folder / "zerodrift.toml").write_text(text)
    return folder


def compose(folder: Path) -> IntegerModel:
    config = load_config(folder)
    dataset = load_dataset(config)
    described = describe_compensator(train(config, dataset).compensator, config, dataset.train)
    return compose_integer_model(described, config, dataset)


@pytest.mark.parametrize(
    ("low", "high", "temperature"),
    [(220.0, 380.0, NAME), (20.0, 900.0, '{ column = "temperature_degC", range = [0, 1100] }')],
)
def test_hot_sensor_gets_checked_firmware_as_good_as_float(
    low: float, high: float, temperature: str, tmp_path: Path
) -> None:
    folder = write_project(tmp_path / "hot", low, high, temperature)
    result = invoke("firmware", "-C", str(folder), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] is True
    rmse = told["rmse"]
    # rounding: far below the noise of 0.002 bar
    assert abs(rmse["integer"]["P"] - rmse["float"]["P"]) < 2e-5 < 0.01 * rmse["float"]["P"]
    assert rmse["integer"]["P"] < 0.01 * rmse["uncompensated"]["P"]
    header = (folder / "firmware" / "hot.h").read_text()
    assert (
        "int32_t temperature; /* temperature: 0 + 0.0078125 degC per count; -2147483648" in header
    )
    assert "int32_t previous_temperature;" in header
    checked = invoke("verify", "-C", str(folder), "--certificate")
    assert checked.exit_code == 0, checked.output
    model = load_model(folder / "build" / "model.json")
    settled = [round(0.5 * (low + high) * 128), model.guards.ranges[0][1]]
    for degC, flag in ((low - 3.0, 2), (low - 1.0, 0), (high + 1.0, 0), (high + 3.0, 2)):
        row = np.array([[[round(degC * 128), settled[1]]]])
        flags = int(Reference(model).run(row).flags[0, 0])
        assert flags & FLAG_TEMPERATURE_RANGE == flag, degC


def test_what_fits_a_tmp117_is_given_its_codes(tmp_path: Path) -> None:
    model = compose(write_project(tmp_path / "mild", -20.0, 250.0))
    thermometer, supply = model.channels
    assert (thermometer.bits, thermometer.lsb, thermometer.no_reading) == (16, 2.0**-7, -(2**15))
    assert (supply.bits, supply.lsb, supply.no_reading) == (16, 2.0**-11, -(2**15))


def test_flags_of_a_project_trip_on_both_sides_of_every_channel(tmp_path: Path) -> None:
    model = compose(write_project(tmp_path / "mild", 0.0, 60.0))
    (channel, low, high), guards = model.guards.ranges[0], model.guards
    assert channel == 1 and low * model.channels[1].lsb == pytest.approx(4.7, abs=0.001)
    middle = [1000, (low + high) // 2]
    cases = [
        (0, guards.temperature_low, guards.temperature_high, FLAG_TEMPERATURE_RANGE),
        (1, low, high, FLAG_INPUT_RANGE),
    ]
    for index, first, last, flag in cases:
        for code, told in ((first - 1, flag), (first, 0), (last, 0), (last + 1, flag)):
            row = middle.copy()
            row[index] = code
            assert Reference(model).run(np.array([[row]])).flags[0, 0] == told
        row = middle.copy()
        row[index] = model.channels[index].no_reading or 0
        trace = Reference(model).run(np.array([[middle, row]]))
        assert trace.flags[0].tolist() == [0, FLAG_NO_READING]
        assert trace.drift[0, 0] == trace.drift[0, 1]


@pytest.mark.parametrize(
    ("temperature", "bits", "lsb"),
    [
        ('{ column = "temperature_degC", raw = "int16" }', 16, 2.0**-6),
        ('{ column = "temperature_degC", raw = "int16", lsb = 0.25 }', 16, 0.25),
        ('{ column = "temperature_degC", lsb = 0.001 }', 32, 0.001),
        ('{ column = "temperature_degC", raw = "int32" }', 32, 2.0**-7),
    ],
)
def test_table_says_the_codes(temperature: str, bits: int, lsb: float, tmp_path: Path) -> None:
    model = compose(write_project(tmp_path / "hot", 220.0, 380.0, temperature))
    thermometer = model.channels[0]
    assert (thermometer.bits, thermometer.lsb) == (bits, lsb)
    assert model.guards.temperature_high < thermometer.most


def test_range_of_an_input_is_what_its_codes_hold(tmp_path: Path) -> None:
    supply = '{ column = "supply_V", range = [0, 40], no_reading = 32767 }'
    model = compose(write_project(tmp_path / "mild", 0.0, 60.0, supply=supply))
    assert (model.channels[1].lsb, model.channels[1].no_reading) == (2.0**-8, 32767)


@pytest.mark.parametrize("command", ["train", "firmware"])
def test_log_beyond_the_codes_is_refused_with_its_line(command: str, tmp_path: Path) -> None:
    folder = write_project(tmp_path / "hot", 100.0, 250.0, test_high=300.0)
    lines = (folder / "logs" / "test.csv").read_text().splitlines()
    line = next(n for n, text in enumerate(lines, 1) if n > 1 and float(text.split(",")[1]) > 256)
    result = invoke(command, "-C", str(folder))
    assert result.exit_code == 2
    told = str(result.exception)
    value = float(lines[line - 1].split(",")[1])
    assert told.startswith(
        f"logs/test.csv:{line}: run 'test': temperature_degC is {value:.10g} degC;"
    )
    assert "hold -255.9921875 degC to 255.9921875 degC" in told
    assert f"range = [LOWEST, HIGHEST] }} at {folder / 'zerodrift.toml'}:4" in told
    assert not (folder / "firmware").exists()
    text = (folder / "zerodrift.toml").read_text()
    table = '{ column = "temperature_degC", range = [0, 400] }'
    (folder / "zerodrift.toml").write_text(text.replace(NAME, table))
    assert compose(folder).channels[0].bits == 32


def test_training_log_beyond_stated_codes_is_refused(tmp_path: Path) -> None:
    table = '{ column = "temperature_degC", raw = "int16", lsb = 0.0078125 }'
    folder = write_project(tmp_path / "hot", 220.0, 380.0, table)
    with pytest.raises(
        InputError, match=r'^logs/train_1.csv:\d+: .*raw = "int32", lsb = 0.0078125'
    ):
        compose(folder)


def test_flags_need_codes_beyond_the_logs(tmp_path: Path) -> None:
    table = '{ column = "temperature_degC", raw = "int16", lsb = 0.0078125 }'
    folder = write_project(tmp_path / "warm", 100.0, 255.0, table)
    with pytest.raises(InputError, match="with 2 degC on either side for the flags"):
        compose(folder)


def test_input_beyond_its_codes_is_refused_with_its_line(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "mild", 0.0, 60.0)
    path = folder / "logs" / "test.csv"
    lines = path.read_text().splitlines()
    for row in (200, 201):
        fields = lines[row].split(",")
        lines[row] = ",".join([*fields[:2], "24.0", fields[3]])
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        compose(folder)
    told = str(caught.value)
    assert told.startswith("logs/test.csv:201: run 'test': supply_V is 24;")
    assert 'supply = { column = "supply_V", range = [LOWEST, HIGHEST] }' in told


def test_codes_are_never_clipped_in_silence(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "mild", 0.0, 60.0)
    model = compose(folder)
    run = load_dataset(load_config(folder)).test[0]
    run.temperature_degC[7] = 300.0
    with pytest.raises(InputError, match=r"test.csv: run 'test', at 7 s: 'temperature' is 300"):
        encode_inputs(model, run)


def test_thermometer_beyond_what_is_plausible_needs_a_range(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "hot", 20.0, 900.0)
    with pytest.raises(
        InputError, match=r'\{ column = "temperature_degC", range = \[low, high\] \}'
    ):
        load_dataset(load_config(folder))
