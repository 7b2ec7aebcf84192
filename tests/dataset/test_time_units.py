"""Times in another unit than seconds are converted where it is stated, and refused where not."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.units import read_time_unit, write_time

PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1 / 60, "h": 1 / 3600}
EPOCH_S = 1.767e9


def write_log(folder: Path, column: str, unit: str, start_s: float = 0.0) -> Path:
    rows = [
        f"{(start_s + k) * PER_SECOND[unit]:.15g},{20 + np.sin(k / 20)},{k % 7},0"
        for k in range(100)
    ]
    path = folder / "log.csv"
    path.write_text("\n".join([f"{column},temperature_degC,Fz_N,ref_Fz_N", *rows]) + "\n")
    return path


def load(folder: Path, time: str, period_s: float = 1.0) -> Dataset:
    text = render_toml('[logs]\ntrain = ["log.csv"]\n', outputs=(FORCE,), period_s=period_s)
    (folder / "zerodrift.toml").write_text(text.replace('time = "time_s"', f"time = {time}"))
    return load_dataset(load_config(folder))


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("t_ms", "ms"),
        ("time_us", "us"),
        ("timestamp_ns", "ns"),
        ("t_h", "h"),
        ("time_min", "min"),
        ("Time (ms)", "ms"),
        ("Time [min]", "min"),
        ("millis", "ms"),
    ],
)
def test_unit_in_the_columns_name_is_converted(tmp_path: Path, column: str, unit: str) -> None:
    log = write_log(tmp_path, column, unit)
    assert read_time_unit(column) == unit
    (run,) = load(tmp_path, f'"{column}"').train
    assert run.time_s == pytest.approx(np.arange(100.0), abs=1e-6)
    result = CliRunner().invoke(cli, ["init", "-C", str(tmp_path), "--force", str(log)])
    assert result.exit_code == 0, result.output
    assert load_config(tmp_path).sample_period_s == 1.0


@pytest.mark.parametrize("unit", PER_SECOND)
def test_unit_in_the_table_is_converted(tmp_path: Path, unit: str) -> None:
    write_log(tmp_path, "t", unit)
    (run,) = load(tmp_path, f'{{ column = "t", unit = "{unit}" }}').train
    assert run.time_s == pytest.approx(np.arange(100.0), abs=1e-6)


@pytest.mark.parametrize("unit", ["ms", "us", "ns", "min", "h"])
def test_unit_that_nobody_states_is_refused_with_what_to_write(tmp_path: Path, unit: str) -> None:
    write_log(tmp_path, "t", unit)
    with pytest.raises(InputError) as caught:
        load(tmp_path, '"t"')
    assert f'time = {{ column = "t", unit = "{unit}" }}' in str(caught.value)


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_unix_times_in_another_unit_are_refused(tmp_path: Path, unit: str) -> None:
    write_log(tmp_path, "timestamp", unit, EPOCH_S)
    with pytest.raises(InputError, match=f'unit = "{unit}"'):
        load(tmp_path, '"timestamp"', period_s=PER_SECOND[unit])


def test_period_in_the_columns_unit_is_refused(tmp_path: Path) -> None:
    write_log(tmp_path, "t_ms", "ms")
    with pytest.raises(InputError, match=r"Set sample_period_s = 1\."):
        load(tmp_path, '"t_ms"', period_s=1000.0)


@pytest.mark.parametrize(
    ("unit", "start_s"),
    [("ms", 0.0), ("h", 0.0), ("ms", EPOCH_S), ("us", EPOCH_S), ("ns", EPOCH_S)],
)
def test_init_marks_a_unit_that_it_guessed(tmp_path: Path, unit: str, start_s: float) -> None:
    log = write_log(tmp_path, "timestamp", unit, start_s)
    result = CliRunner().invoke(cli, ["init", "-C", str(tmp_path), str(log)])
    assert result.exit_code == 0, result.output
    (line,) = (
        line
        for line in (tmp_path / "zerodrift.toml").read_text().splitlines()
        if line.startswith("time =")
    )
    assert f'unit = "{unit}"' in line
    assert "# check: or" in line
    config = load_config(tmp_path)
    assert config.sample_period_s == pytest.approx(1.0, rel=0.01)
    assert load_dataset(config).train


@pytest.mark.parametrize(
    ("time_s", "text"),
    [
        (0.5, "0.5"),
        (99999.5, "99999.5"),
        (1767230000.0, "2026-01-01 01:13:20"),
        (1767230000.26, "2026-01-01 01:13:20"),
    ],
)
def test_times_are_written_to_the_second(time_s: float, text: str) -> None:
    assert write_time(time_s) == text


def test_note_on_a_gap_names_a_unix_time_to_the_second(tmp_path: Path) -> None:
    log = write_log(tmp_path, "t", "s", EPOCH_S)
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:40], *lines[60:]]) + "\n")
    assert any("after 2025-12-29 09:20:38" in note for note in load(tmp_path, '"t"').notes)


def test_logs_finer_than_the_step_are_averaged_as_before(tmp_path: Path) -> None:
    write_log(tmp_path, "t", "s")
    assert len(load(tmp_path, '"t"', period_s=2.0).train[0]) == 50
