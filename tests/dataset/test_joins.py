"""Files of one run are joined on time; gaps stay gaps, clocks are compared where data allow."""

import re

import numpy as np
import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.join import measure_difference
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.log_steps import read_log_steps


def heat(time_s):
    return 25 + 5 * np.sin(time_s / 300)


def write(path, header, *columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = (",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([header, *rows]) + "\n")


def write_run(folder, name="run1", period_s=3.0, start_s=1000.0, gap=(), offset_s=0.0):
    """A meter and a climate logger, which record 20 min, the climate from 10 s later on."""
    slow_s = np.arange(start_s, start_s + 1200, period_s)
    fast_s = np.arange(start_s + 10, start_s + 1190, 1.0)
    if gap:
        fast_s = fast_s[(fast_s < start_s + gap[0]) | (fast_s > start_s + gap[1])]
    write(folder / name / "meter.csv", "time_s,Fz_N", slow_s, 2 * heat(slow_s))
    write(folder / name / "env.csv", "time_s,temperature_degC", fast_s - offset_s, heat(fast_s))


def load(folder, logs='train = ["run*"]', period_s=5.0, time='"time_s"'):
    text = render_toml(f"[logs]\n{logs}\n", outputs=(FORCE,), period_s=period_s)
    text = text.replace('reference = "ref_Fz_N"\n', "").replace('time = "time_s"', f"time = {time}")
    (folder / "zerodrift.toml").write_text(text)
    return load_dataset(load_config(folder))


def refusal(folder, **changes):
    with pytest.raises(InputError) as caught:
        load(folder, **changes)
    return str(caught.value)


def test_files_of_a_folder_are_one_run(tmp_path):
    write_run(tmp_path)
    write_run(tmp_path, "run2", start_s=5000.0)
    dataset = load(tmp_path)
    assert [run.name for run in dataset.train] == ["run1", "run2"]
    run = dataset.train[0]
    assert run.time_s[0] == pytest.approx(1015.0)
    np.testing.assert_allclose(run.measured[:, 0], 2 * run.temperature_degC, atol=0.01)
    notes = "\n".join(dataset.notes)
    assert "env.csv (a row every 1 s), meter.csv (a row every 3 s) joined on time" in notes
    assert notes.count("cannot be told from a lag of the same size") == 1


@pytest.mark.parametrize(
    "logs",
    ['train = [["run1/meter.csv", "run1/env.csv"]]', 'train = ["run1/meter.csv + run1/env.csv"]'],
)
def test_list_of_files_is_one_run(tmp_path, logs):
    write_run(tmp_path)
    np.testing.assert_array_equal(
        load(tmp_path, logs).train[0].measured, load(tmp_path).train[0].measured
    )


def test_nested_folders_are_runs(tmp_path):
    for number, name in enumerate(("SN1/run1", "SN1/run2", "SN2/run1", "SN2/run2")):
        write_run(tmp_path, f"units/{name}", start_s=700.0 * number)
    names = [run.name for run in load(tmp_path, 'train = ["units/SN*/run*"]').train]
    assert len(names) == 4 and all("SN" in name for name in names)


def test_part_in_time_of_a_joined_run(tmp_path):
    write_run(tmp_path)
    dataset = load(tmp_path, 'train = ["run1@0%:50%"]\ntest = ["run1@50%:"]')
    whole = load(tmp_path).train[0]
    assert len(dataset.train[0]) + len(dataset.test[0]) == pytest.approx(len(whole), abs=1)


def test_gap_of_one_file_is_a_gap_of_the_run(tmp_path):
    write_run(tmp_path, gap=(300, 600))
    dataset = load(tmp_path)
    first, second = dataset.train
    assert first.time_s[-1] <= 1300 and second.time_s[0] >= 1600
    assert any("interrupted once" in note for note in dataset.notes)


def test_gap_of_the_slower_file_is_a_gap_of_the_run(tmp_path):
    write_run(tmp_path)
    path = tmp_path / "run1" / "meter.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:100] + lines[200:]) + "\n")
    first, second = load(tmp_path).train
    assert first.time_s[-1] <= 1297 and second.time_s[0] >= 1597


def test_file_slower_than_the_step_is_refused(tmp_path):
    write_run(tmp_path)
    message = refusal(tmp_path, period_s=1.0)
    assert "meter.csv: a row every 3 s" in message and "Set sample_period_s = 3" in message


def test_files_that_do_not_overlap_are_refused(tmp_path):
    write_run(tmp_path, offset_s=5000.0)
    message = refusal(tmp_path)
    assert "run1: its files do not overlap in time: env.csv from -3990 s to" in message
    assert "[logs] offset_s" in message
    assert load(tmp_path, 'train = ["run1"]\noffset_s = { "env.csv" = 5000 }').train


def test_column_in_two_files_is_asked_for(tmp_path):
    write_run(tmp_path)
    time_s = np.arange(1000, 2200, 2.0)
    write(
        tmp_path / "run1" / "meter.csv",
        "time_s,Fz_N,temperature_degC",
        time_s,
        time_s,
        heat(time_s),
    )
    assert 'Write "env.csv:temperature_degC" where [sensor] temperature' in refusal(tmp_path)
    text = (tmp_path / "zerodrift.toml").read_text()
    (tmp_path / "zerodrift.toml").write_text(
        text.replace('"temperature_degC"', '"env*.csv:temperature_degC"')
    )
    assert load_dataset(load_config(tmp_path)).train


def test_missing_column_names_what_each_file_has(tmp_path):
    write_run(tmp_path)
    write(tmp_path / "run1" / "meter.csv", "time_s,F_N", [0.0, 1.0], [0.0, 1.0])
    message = refusal(tmp_path)
    assert "run1: there is no column 'Fz_N' in any of its 2 files; did you mean 'F_N'" in message
    assert "env.csv has time_s, temperature_degC; meter.csv has time_s, F_N" in message


def test_file_that_is_no_log_does_no_harm(tmp_path):
    write_run(tmp_path)
    (tmp_path / "run1" / "README.txt").write_text("A run of the second unit, lid closed.\n")
    (tmp_path / "run1" / "empty.csv").write_text("")
    assert load(tmp_path).train


def test_file_without_times_says_how_to_state_them(tmp_path):
    write_run(tmp_path)
    path = tmp_path / "run1" / "meter.csv"
    path.write_text("\n".join(line.split(",")[1] for line in path.read_text().splitlines()) + "\n")
    message = refusal(tmp_path)
    assert 'State it: [logs] time = { "meter.csv" = "COLUMN" }' in message


def test_files_may_call_their_times_differently(tmp_path):
    write_run(tmp_path)
    path = tmp_path / "run1" / "meter.csv"
    path.write_text(path.read_text().replace("time_s", "Zeit"))
    assert load(tmp_path, 'train = ["run1"]\ntime = { "meter.csv" = "Zeit" }').train


def test_local_clock_beside_unix_time_needs_a_zone(tmp_path):
    write_run(tmp_path, start_s=1.7e9)
    path = tmp_path / "run1" / "meter.csv"
    lines = path.read_text().splitlines()
    local = [
        f"{np.datetime64(round(float(t)) - 5 * 3600, 's')},{v}".replace("T", " ")
        for t, v in (line.split(",") for line in lines[1:])
    ]
    path.write_text("\n".join([lines[0], *local]) + "\n")
    message = refusal(tmp_path)
    assert 'zone = "-05:00" would make them overlap best' in message
    run = load(tmp_path, time='{ column = "time_s", zone = "-05:00" }').train[0]
    np.testing.assert_allclose(run.measured[:, 0], 2 * run.temperature_degC, atol=0.01)


def test_rows_that_a_model_is_applied_to_are_those_of_the_joined_files(tmp_path):
    write_run(tmp_path)
    load(tmp_path)
    columns = {"temperature_degC": "here", "Fz_N": "here"}
    steps = read_log_steps(load_config(tmp_path), tmp_path / "run1", columns)
    frame = steps.source.scan().collect()
    assert frame.height == steps.step_of_row.size
    assert set(steps.source.names) == {"time_s", "temperature_degC", "Fz_N"}
    np.testing.assert_allclose(frame["Fz_N"], 2 * frame["temperature_degC"].to_numpy(), atol=0.01)


def record(seed, offset_s=2.3, rate=50e-6):
    """Two loggers of one temperature over 10 h: slopes of 1 K/min, noise 0.02 K, 1 % jitter."""
    rng = np.random.default_rng(seed)
    logs = []
    for period_s in (1.0, 2.5):
        time_s = np.arange(0, 36000, period_s) + rng.normal(
            0, 0.01 * period_s, int(36000 / period_s)
        )
        triangle = 20 + 40 / np.pi * np.arcsin(np.sin(2 * np.pi * time_s / 2400))
        logs.append((time_s, triangle + rng.normal(0, 0.02, time_s.size)))
    (first_s, first), (second_s, second) = logs
    return first_s, first, (second_s - offset_s) / (1 + rate), second


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("offset_s", "rate"), [(2.3, 50e-6), (-240.0, 0.0)])
def test_clocks_are_compared_by_a_common_quantity(seed, offset_s, rate):
    logs = record(seed, offset_s, rate)
    found = measure_difference(*logs)
    error_s = found.offset_s + found.rate * -found.since_s - offset_s
    assert abs(error_s) < 0.25 and abs(found.rate - rate) < 5e-6
    # The uncertainty is one: neither far too small nor of no use.
    assert abs(error_s) < 4 * found.offset_std_s < 0.25
    assert abs(found.rate - rate) < 4 * found.rate_std < 10e-6


def test_logs_of_different_quantities_are_not_brought_together():
    rng = np.random.default_rng(0)
    time_s = np.arange(3600.0)
    first, second = np.cumsum(rng.normal(size=(2, time_s.size)), axis=1)
    assert not measure_difference(time_s, first, time_s, second).is_credible


def test_common_quantity_moves_the_clock_and_is_told(tmp_path):
    write_run(tmp_path)
    rng = np.random.default_rng(0)
    time_s = np.arange(1000, 2200, 2.0)
    shown_s = time_s - 7.0
    write(
        tmp_path / "run1" / "meter.csv",
        "time_s,Fz_N,room",
        shown_s,
        2 * heat(time_s),
        heat(time_s) + rng.normal(0, 0.01, time_s.size),
    )
    logs = 'train = ["run1"]\ncommon = ["meter.csv:room", "env.csv:temperature_degC"]'
    dataset = load(tmp_path, logs)
    notes = "\n".join(dataset.notes)
    found = re.search(r"clock is brought to that of env.csv by (.*) s \(\+-(.*) s\) and no", notes)
    assert abs(float(found[1]) - 7.0) < 2 * float(found[2]) < 0.3
    assert "cannot be told from an offset of the same size" in notes
    run = dataset.train[0]
    np.testing.assert_allclose(run.measured[:, 0], 2 * run.temperature_degC, atol=0.02)
