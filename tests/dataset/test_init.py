"""`zerodrift init`: what it guesses, that its file is valid, that it never overwrites."""

import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.init import command
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.units import are_alike, read_unit, strip_unit

HEADER = (
    *("time_s", "temperature_degC", "t_body_degC", "Fx_N", "Mz [Nm]", "ref_Fx_N", "ref_Mz [Nm]"),
    *("supply_V", "humidity_pct", "ax_mps2", "unix_s", "sample"),
)


def write_log(path, header=HEADER, count=40, period_s=0.5):
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(header)]
    for k in range(count):
        known = {"time_s": k * period_s, "unix_s": 1.7e9 + k * period_s, "sample": k, "run": "a"}
        lines.append(",".join(str(known.get(name, round(3.7 * k, 3))) for name in header))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def invoke(tmp_path):
    def run(*arguments):
        return CliRunner().invoke(command, ["-C", str(tmp_path), *map(str, arguments)])

    return run


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("logs/run_1.csv", "logs/run_2.csv"), "fx"),  # nothing but the output says what it is
        (("cell 7/run_1.csv", "cell 7/run_2.csv"), "cell_7"),
        (("logs/SN12_2026-03-01.csv", "logs/SN12_2026-03-02.csv"), "sn12"),
        (("logs/bridge-1.csv", "logs/bridge-2.csv"), "bridge"),
        (("logs/run_1.csv",), "fx"),
        (("logs/2026.csv",), "fx"),
    ],
)
def test_a_sensor_is_named_by_what_names_it(tmp_path, invoke, names, expected):
    logs = [write_log(tmp_path / name) for name in names]
    assert invoke(*logs).exit_code == 0
    assert load_config(tmp_path).sensor_name == expected


def test_init_guesses_each_column_by_name_and_unit(tmp_path, invoke):
    log = write_log(tmp_path / "logs" / "FT 40.csv")
    assert invoke(log).exit_code == 0
    config = load_config(tmp_path)
    assert config.sensor_name == "ft_40"
    assert (config.time_column, config.temperature_column) == ("time_s", "temperature_degC")
    assert config.sample_period_s == 0.5
    assert [(o.name, o.measured, o.reference, o.unit) for o in config.outputs] == [
        ("Fx", "Fx_N", "ref_Fx_N", "N"),
        ("Mz", "Mz [Nm]", "ref_Mz [Nm]", "Nm"),
    ]
    # The largest value is 144.3; full scales come in steps of 1, 2, 5.
    assert [output.full_scale for output in config.outputs] == [200.0, 200.0]
    assert dict(config.inputs) == {
        "clock": "unix_s",
        "t_body": "t_body_degC",
        "supply": "supply_V",
        "humidity": "humidity_pct",
        "acceleration_x": "ax_mps2",
    }
    assert config.train_logs == ("logs/FT 40.csv@0%:60%",)
    assert config.test_logs == ("logs/FT 40.csv@60%:100%",)


def test_init_writes_a_project_that_loads(tmp_path, invoke):
    write_log(tmp_path / "log.csv")
    invoke("log.csv")
    dataset = load_dataset(load_config(tmp_path))
    assert [len(run) for run in dataset.train + dataset.test] == [24, 16]


def test_init_says_what_to_check(tmp_path, invoke):
    write_log(tmp_path / "log.csv")
    text = invoke("log.csv").output
    assert "time_s, a row every 0.5 s" in text
    assert "check: 'temperature_degC' was taken as the chip's own thermometer" in text
    assert "check: not used: sample" in text
    assert "check: full_scale of Fx is a guess from the data" in text


def test_init_prints_one_json_object(tmp_path, invoke):
    write_log(tmp_path / "log.csv")
    told = json.loads(invoke("--json", "log.csv").stdout)
    assert told["file"] == str(tmp_path / "zerodrift.toml")
    assert told["outputs"]["Fx"] == {
        "measured": "Fx_N",
        "reference": "ref_Fx_N",
        "unit": "N",
        "full_scale": 200.0,
    }
    assert told["logs"]["test"] == ["log.csv@60%:100%"]


def test_init_never_overwrites_without_force(tmp_path, invoke):
    write_log(tmp_path / "log.csv")
    target = tmp_path / "zerodrift.toml"
    target.write_text("# mine\n")
    result = invoke("log.csv")
    assert isinstance(result.exception, InputError)
    assert "--force" in str(result.exception)
    assert target.read_text() == "# mine\n"
    assert invoke("--force", "log.csv").exit_code == 0
    assert "[sensor]" in target.read_text()


def test_init_leaves_nothing_behind_when_it_fails(tmp_path, invoke):
    write_log(tmp_path / "log.csv", header=("speed_mps2", "temperature_degC", "Fx_N"))
    result = invoke("log.csv")
    assert "no column of numbers looks like the time" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_init_sorts_logs_by_the_words_in_their_names(tmp_path, invoke):
    for name in ("chamber_2", "chamber_1", "walk_1", "dwell"):
        write_log(tmp_path / "logs" / f"{name}.csv")
    assert invoke(tmp_path / "logs").exit_code == 0
    config = load_config(tmp_path)
    assert config.train_logs == ("logs/chamber_1.csv", "logs/chamber_2.csv")
    assert config.test_logs == ("logs/walk_1.csv",)
    assert config.dwell_logs == ("logs/dwell.csv",)


def test_init_proposes_where_for_a_column_of_names(tmp_path, invoke):
    path = tmp_path / "log.csv"
    lines = ["run,unit,time_s,temperature_degC,Fx_N"]
    lines += [f"r{k % 2},{'AB'[k % 2]},{k // 2},{k / 4},{k}" for k in range(80)]
    path.write_text("\n".join(lines))
    result = invoke(path)
    assert result.exit_code == 0
    told = "check: 'unit' has 2 values (A, B), all taken as one sensor; [logs] where picks one"
    assert told in result.output
    text = (tmp_path / "zerodrift.toml").read_text()
    assert '# where = { unit = "A" }  # one of: A, B' in text
    # Two runs: one can be left out, so that the log is not cut.
    assert tomllib.loads(text)["logs"] == {"train": ["log.csv"]}


@pytest.mark.parametrize(
    ("header", "missing"),
    [
        (("time_s", "Fx_N"), "no column looks like the temperature"),
        (("time_s", "temperature_degC"), "no column looks like a quantity that drifts"),
    ],
)
def test_guess_project_says_which_column_it_misses(tmp_path, header, missing):
    log = write_log(tmp_path / "log.csv", header=header)
    with pytest.raises(InputError, match=missing):
        guess_project([log])


def test_guess_project_notes_units_other_than_degc_and_seconds(tmp_path):
    log = write_log(tmp_path / "log.csv", header=("elapsed_ms", "temperature_K", "Fx_N"))
    checks = "\n".join(guess_project([log]).checks)
    assert "'temperature_K' seems to be in K, and is converted to degC" in checks


@pytest.mark.parametrize(
    ("name", "bare", "unit"),
    [
        ("Fz_N", "Fz", "N"),
        ("Mx_Nm", "Mx", "Nm"),
        ("Fz [N]", "Fz", "N"),
        ("drift (ppm)", "drift", "ppm"),
        ("weight_kg", "weight", "kg"),
        ("temperature_degC", "temperature", "degC"),
        ("body", "body", ""),
        ("Fz_raw", "Fz_raw", ""),
    ],
)
def test_read_unit_takes_the_suffix_of_a_name(name, bare, unit):
    assert (read_unit(name), strip_unit(name)) == (unit, bare)


def test_are_alike_ignores_how_a_product_is_written():
    assert are_alike("Nm", "N m")
    assert are_alike("Nm", "N*m")
    assert not are_alike("N", "Nm")


def test_init_recognises_a_measured_log(real_log, invoke, tmp_path):
    assert invoke(real_log("loadcell_h40a_22kg.csv")).exit_code == 0
    config = load_config(tmp_path)
    assert config.sample_period_s == 256.0
    (weight,) = config.outputs
    assert (weight.measured, weight.reference) == ("weight_kg", "static_load_nominal_kg")
    assert load_dataset(config).test


def test_init_says_when_it_may_not_write(tmp_path, invoke, monkeypatch):
    def refuse(path, flags, mode=0o777, **more):
        if flags & os.O_CREAT and Path(path).is_relative_to(tmp_path):
            raise PermissionError(13, "Permission denied", str(path))
        return really(path, flags, mode, **more)

    really = os.open
    write_log(tmp_path / "log.csv")
    monkeypatch.setattr(os, "open", refuse)
    result = invoke("log.csv")
    assert isinstance(result.exception, InputError)
    assert "zerodrift.toml: cannot be written (Permission denied)" in str(result.exception)


@pytest.mark.parametrize("tared", [True, False])
def test_init_says_that_logs_look_tared_and_leaves_it_to_the_user(tmp_path, invoke, tared):
    logs = []
    for run, offset in enumerate((0.8, -0.5, 0.3, -0.9)):
        rows = [
            (k, 25.0 + 10.0 * np.sin(k / 30.0 + run), 0.1 * np.sin(k / 30.0 + run) + offset * tared)
            for k in range(300)
        ]
        lines = ["time_s,temperature_degC,Fz_N", *(f"{t},{c:.4f},{z:.5f}" for t, c, z in rows)]
        path = tmp_path / f"run_{run}.csv"
        path.write_text("\n".join(lines) + "\n")
        logs.append(path)
    told = invoke(*logs)
    assert told.exit_code == 0
    text = (tmp_path / "zerodrift.toml").read_text()
    assert ("# tared = true  # check: at the same temperature the runs differ" in text) is tared
    assert ("check: [logs] tared is not stated" in told.output) is tared
    assert load_config(tmp_path).tared is None
