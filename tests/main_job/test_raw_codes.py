"""From logs to firmware that is given the converter's counts: ohm, degC or counts in the logs."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tests.main_job.conftest import invoke

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.chip_codes import choose_codes
from zerodrift.dataset.load import load_dataset
from zerodrift.export.channels import make_channel
from zerodrift.export.encoding import encode_channel
from zerodrift.export.integer_model import FLAG_NO_READING, FLAG_TEMPERATURE_RANGE, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference

TOML = """\
[sensor]
name = "cell"
time = "time_s"
temperature = {temperature}
sample_period_s = 1.0

[outputs.P]
measured = "P_bar"
unit = "bar"
full_scale = 50

[inputs]
supply = {{ column = "supply", scale = 0.000805, raw = "uint16"{supply} }}

[logs]
train = ["logs/train_*.csv"]
test = ["logs/test.csv"]

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "supply_sensitivity"
"""
NTC = (
    '{{ column = "ntc", convert = "ntc", r25_ohm = 10000, beta_K = 3950, raw = "uint16", '
    'range = [-20, 90], divider = {{ series_ohm = 10000, side = "low", counts = 65536 }}{rest} }}'
)
LOGS = {
    "counts": "",
    "ohm": ', unit = "ohm", log_is = "quantity"',
    "degC": ', unit = "degC", log_is = "quantity"',
    "K": ', unit = "K", log_is = "quantity"',
}
"""What the log holds -> what the thermometer's table says of it."""
STEPS, VOLT_PER_COUNT = 400, 0.000805


def make_ohm(degC: np.ndarray) -> np.ndarray:
    """Return a 10 kohm thermistor of beta 3950 K, by its own equation."""
    return np.asarray(1e4 * np.exp(3950.0 * (1.0 / (degC + 273.15) - 1.0 / 298.15)))


def make_counts(degC: np.ndarray) -> np.ndarray:
    ohm = make_ohm(degC)
    return np.asarray(np.round(65536.0 * ohm / (ohm + 1e4)))


def write_project(folder: Path, holds: str, supply: str = "", high: float = 60.0) -> Path:
    """Write a project whose logs hold the thermometer as counts, ohm, degC or K."""
    (folder / "logs").mkdir(parents=True)
    rng = np.random.default_rng(2)
    for k, name in enumerate(("train_1", "train_2", "test")):
        t = np.arange(STEPS)
        degC = 5.0 + (high - 5.0) * (0.5 - 0.5 * np.cos(2.0 * np.pi * (1.0 + 0.3 * k) * t / STEPS))
        volt = 3.3 + 0.2 * np.sin(t / (17.0 + k))
        counts, volt_counts = make_counts(degC), np.round(volt / VOLT_PER_COUNT)
        drift = 0.02 * degC + 0.5 * (volt_counts * VOLT_PER_COUNT - 3.3)
        measured = drift + rng.normal(0.0, 0.002, STEPS)
        ntc = {"counts": counts, "ohm": make_ohm(degC), "degC": degC, "K": degC + 273.15}[holds]
        second = volt_counts * (VOLT_PER_COUNT if supply else 1.0)
        table = {"time_s": t, "ntc": ntc, "supply": second, "P_bar": measured}
        pl.DataFrame(table).write_csv(folder / "logs" / f"{name}.csv")
    text = TOML.format(temperature=NTC.format(rest=LOGS[holds]), supply=supply)
    (folder / "zerodrift.toml").write_text(text)
    return folder


def read_model(folder: Path) -> IntegerModel:
    return load_model(folder / "build" / "model.json")


@pytest.mark.parametrize("holds", LOGS)
def test_whatever_the_log_holds_the_chip_is_given_the_same_counts(
    holds: str, tmp_path: Path
) -> None:
    folder = write_project(tmp_path / "cell", holds, ', log_is = "quantity"')
    config = load_config(folder)
    dataset = load_dataset(config)
    channels = tuple(
        make_channel(index, choose_codes(config, source, dataset.train, 0.0))
        for index, source in enumerate(("temperature_degC", "supply"))
    )
    assert [channel.raw_type for channel in channels] == ["uint16", "uint16"]
    for run in dataset.train:
        found, beyond = encode_channel(channels[0], run.temperature_degC)
        assert not beyond.any()
        counts = make_counts(5.0 + 55.0 * (0.5 - 0.5 * np.cos(_turn(run.name) * run.time_s)))
        np.testing.assert_array_equal(found, counts)
        volts, _ = encode_channel(channels[1], run.inputs["supply"])
        assert 3800 < volts.min() < volts.max() < 4400


def _turn(name: str) -> float:
    k = ("train_1", "train_2", "test").index(name)
    return float(2.0 * np.pi * (1.0 + 0.3 * k) / STEPS)


def test_firmware_of_a_thermistor_is_given_its_counts(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "cell", "ohm", ', log_is = "quantity"')
    result = invoke("firmware", "-C", str(folder), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] is True
    conversion = told["conversions"]["temperature"]
    assert (conversion["raw"], conversion["readings"]) == ("uint16", [64, 65471])
    assert conversion["error"] <= 0.0078125 and conversion["table_bytes"] <= 1024
    assert list(told["conversions"]) == ["temperature"]
    assert "the float model exactly converted" in told["error_bound"]["P"]["holds"]
    rmse = told["rmse"]
    assert abs(rmse["integer"]["P"] - rmse["float"]["P"]) < 2e-5 < 0.01 * rmse["float"]["P"]
    assert rmse["integer"]["P"] < 0.01 * rmse["uncompensated"]["P"]
    model = read_model(folder)
    assert [c.raw_type for c in model.channels] == ["uint16", "uint16"]
    header = (folder / "firmware" / "cell.h").read_text()
    assert "    uint16_t temperature;\n" in header and "    uint16_t supply; /*" in header
    assert "No reading: codes below 64 and codes above 65471." in " ".join(header.split()).replace(
        " * ", " "
    )
    checked = invoke("verify", "-C", str(folder), "--certificate")
    assert checked.exit_code == 0, checked.output
    codes = np.stack(
        [make_counts(np.array([20.0, 40.0])), np.full(2, round(3.3 / VOLT_PER_COUNT))], axis=1
    )
    packed = invoke("package", "arduino", "-C", str(folder))
    assert packed.exit_code == 0, packed.output
    drift = Reference(model).run(codes.astype(np.int64)[None]).drift[0, :, 0]
    rise = (drift[1] - drift[0]) / model.outputs[0].lsb_per_unit
    assert rise == pytest.approx(0.4, abs=0.005)  # 0.02 bar/K over 20 K


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a project whose logs hold counts, with its firmware."""
    folder = write_project(tmp_path_factory.mktemp("raw") / "cell", "counts")
    assert invoke("firmware", "-C", str(folder)).exit_code == 0
    return folder


def test_flags_trip_on_both_sides_and_at_both_rails(built: Path) -> None:
    model, volt = read_model(built), round(3.3 / VOLT_PER_COUNT)

    def flag(count: float) -> int:
        return int(Reference(model).run(np.array([[[int(count), volt]]])).flags[0, 0])

    for degC, expected in ((1.0, 2), (4.0, 0), (61.0, 0), (64.0, 2), (89.0, 2), (-19.0, 2)):
        found = flag(make_counts(np.array(degC)))
        assert found & FLAG_TEMPERATURE_RANGE == expected, degC
        assert not found & FLAG_NO_READING
    for count in (0, 1, 63, 65472, 65535):
        assert flag(count) & FLAG_NO_READING
    for count in (64, 65471):
        assert flag(count) & FLAG_TEMPERATURE_RANGE and not flag(count) & FLAG_NO_READING


def test_apply_encodes_the_log_as_the_hardware_would(built: Path) -> None:
    folder = built
    log = pl.read_csv(folder / "logs" / "test.csv")
    opened = log.with_columns(
        pl.when(pl.int_range(STEPS).is_between(100, 109))
        .then(65535.0)
        .otherwise("ntc")
        .alias("ntc")
    )
    opened.write_csv(folder / "open.csv")
    out = folder / "out.csv"
    result = invoke("apply", "-C", str(folder), str(folder / "open.csv"), "--out", str(out))
    assert result.exit_code == 0, result.output
    found = pl.read_csv(out)
    assert found["ntc"].to_list() == opened["ntc"].to_list()  # the log's own column, as it was
    lacks = (found["flags"].to_numpy() & FLAG_NO_READING) > 0
    assert lacks.nonzero()[0].tolist() == list(range(100, 110))
    model = read_model(folder)
    codes = opened.select("ntc", "supply").to_numpy().astype(np.int64)
    drift = Reference(model).run(codes[None]).drift[0, :, 0] / model.outputs[0].lsb_per_unit
    np.testing.assert_allclose(found["P_drift"].to_numpy(), drift, atol=1e-9)


def test_a_range_that_no_code_stands_for_is_refused_with_its_line(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "cell", "degC")
    path = folder / "zerodrift.toml"
    path.write_text(path.read_text().replace("range = [-20, 90]", "range = [-120, 90]"))
    result = invoke("train", "-C", str(folder))
    assert result.exit_code == 2
    told = str(result.exception)
    assert told.startswith(f"{path}:4: the raw codes of 'temperature' (64 .. 65471 of uint16, ntc)")
    assert "hold -77.2" in told and "expected -120 degC to 90 degC" in told


def test_a_conversion_that_turns_is_refused_with_its_line(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "cell", "degC")
    path = folder / "zerodrift.toml"
    turns = 'convert = "polynomial", coefficients = [0, 4.6e-3, -1.37e-5, 1.07e-8], raw = "int16"'
    table = f'{{ column = "ntc", unit = "degC", log_is = "quantity", {turns}, range = [-10, 300] }}'
    text = path.read_text().splitlines()
    text[3] = f"temperature = {table}"
    path.write_text("\n".join(text) + "\n")
    with pytest.raises(InputError) as caught:
        config = load_config(folder)
        choose_codes(config, "temperature_degC", load_dataset(config).train, 0.0)
    told = str(caught.value)
    assert told.startswith(f"{path}:4: temperature is converted from raw codes, but")


def test_counts_beyond_the_divider_are_refused_with_their_line(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "cell", "counts")
    log = folder / "logs" / "train_1.csv"
    lines = log.read_text().splitlines()
    fields = lines[50].split(",")
    lines[50] = ",".join([fields[0], "70000", *fields[2:]])
    log.write_text("\n".join(lines) + "\n")
    result = invoke("train", "-C", str(folder))
    assert result.exit_code == 2
    told = str(result.exception)
    assert "train_1.csv:51: column 'ntc' holds '70000', which its conversion" in told
