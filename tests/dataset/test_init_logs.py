"""`init` on logs as they are: roles by name, unit and values; folders; what it is not sure of."""

import json
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.dataset.conftest import SHARED_DATA

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.init import command
from zerodrift.dataset.chip_codes import choose_input_codes
from zerodrift.dataset.load import load_dataset

AS_LOGGED = SHARED_DATA / "as_logged"
TIME = np.arange(0.0, 400.0)
T = 25 + 5 * np.sin(TIME / 60)


def write(path: Path, separator: str = ",", units: str = "", **columns) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [name.replace("__", " ") for name in columns]
    lines = [separator.join(names)] + ([units] if units else [])
    texts = [
        [each if isinstance(each, str) else f"{each:.6g}" for each in column]
        for column in columns.values()
    ]
    path.write_text("\n".join([*lines, *map(separator.join, zip(*texts, strict=True))]) + "\n")
    return path


@pytest.fixture
def init(tmp_path):
    """Run init in an empty project; return its JSON, its file and the lines with `# check:`."""

    def run(*arguments, answers=None):
        given = ["-C", str(tmp_path), "--force", *([] if answers else ["--json"])]
        result = CliRunner().invoke(command, [*given, *map(str, arguments)], input=answers)
        if result.exception and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0, result.output
        text = (tmp_path / "zerodrift.toml").read_text()
        checks = [line for line in text.splitlines() if "# check:" in line and line[0] != "#"]
        told = None if answers else json.loads(result.stdout)
        return told, tomllib.loads(text), checks

    return run


def roles(told):
    return {column["column"]: column["role"] for column in told["columns"]}


def test_setpoint_is_never_the_thermometer(tmp_path, init):
    log = write(
        tmp_path / "log.csv",
        time_s=TIME,
        set_c=np.where(TIME < 200, 20.0, 30.0),
        ambient_c=T,
        F_N=T,
    )
    told, toml, _ = init(log)
    assert toml["sensor"]["temperature"] == "ambient_c"
    assert roles(told)["set_c"] == "not used"
    assert "a setpoint, by its name" in str(told["columns"])


def test_temperature_that_looks_like_a_setpoint_is_the_last_choice(tmp_path, init):
    steps = 20 + 5 * np.floor(TIME / 100)
    log = write(tmp_path / "log.csv", time_s=TIME, temp_c=steps, oven_c=T, F_N=T)
    _, toml, checks = init(log)
    assert toml["sensor"]["temperature"] == "oven_c"
    assert any(line.endswith("# check: or temp_c") for line in checks)


def test_constant_is_neither_thermometer_nor_output(tmp_path, init):
    log = write(
        tmp_path / "log.csv", time_s=TIME, temp_a_c=np.full(400, 25.0), temp_b_c=T, F_N=T, G_N=0 * T
    )
    told, toml, _ = init(log)
    assert toml["sensor"]["temperature"] == "temp_b_c"
    assert list(toml["outputs"]) == ["F"]
    assert roles(told)["temp_a_c"] == roles(told)["G_N"] == "not used"


def test_same_temperature_in_another_unit_is_left_out(tmp_path, init):
    log = write(tmp_path / "log.csv", time_s=TIME, t_c=T, t_f=1.8 * T + 32, F_N=T)
    told, toml, _ = init(log)
    assert "t_f" not in str(toml)
    assert "is 't_c' in degF" in str(told["columns"])


def test_ohms_of_a_thermistor_are_no_output(tmp_path, init):
    log = write(tmp_path / "log.csv", time_s=TIME, temp_c=T, ntc_ohm=1e4 - 300 * T, F_N=T)
    told, toml, _ = init(log)
    assert list(toml["outputs"]) == ["F"]
    assert "a raw thermometer" in str(told["columns"])


@pytest.mark.parametrize("name", ["TC__[mV]", "thermocouple_mV", "tc_uV"])
def test_voltage_of_a_thermocouple_is_no_output(tmp_path, init, name):
    columns = {"time_s": TIME, name: T / 20, "board_degC": 22 + TIME / 200, "F_N": T}
    told, toml, _ = init(write(tmp_path / "log.csv", **columns))
    assert toml["sensor"]["temperature"] == "board_degC" and list(toml["outputs"]) == ["F"]
    assert roles(told)[name.replace("__", " ")] == "not used"
    assert any("a raw thermometer" in check for check in told["check"])


def test_units_come_from_a_row_of_units(tmp_path, init):
    log = write(
        tmp_path / "log.csv", ";", "s;°C;µV", time=TIME, probe=T, bridge=1e3 * np.sin(TIME / 70)
    )
    _, toml, _ = init(log)
    assert toml["sensor"]["temperature"] == "probe"
    assert toml["outputs"]["bridge"]["unit"] == "uV"


def test_unit_that_nothing_tells_is_marked(tmp_path, init):
    _, _, checks = init(write(tmp_path / "log.csv", time_s=TIME, temp_c=T, value=T))
    assert 'unit = "LSB"  # check: or V | mV | ohm | N | g | ppm' in checks


def test_value_that_hardly_moves_gets_a_true_value_that_is_marked(tmp_path, init):
    log = write(tmp_path / "log.csv", time_s=TIME, temp_c=T, R_ohm=1000 + 0.01 * T)
    _, toml, checks = init(log)
    assert toml["outputs"]["R"]["reference"] == 1000.0
    assert any("# check: or the true value" in line for line in checks)


def test_open_day_and_month_are_marked_with_the_other_reading(tmp_path, init):
    at = [f"04/03/2024 10:{int(t) // 60:02d}:{int(t) % 60:02d}" for t in TIME]
    log = write(tmp_path / "log.csv", when=at, temp_c=T, F_N=T)
    _, toml, checks = init(log)
    assert toml["sensor"]["time"]["format"] == "%d/%m/%Y %H:%M:%S.%f"
    assert '# check: or format = "%m/%d/%Y %H:%M:%S.%f" (month first)' in checks[0]
    assert load_dataset(load_config(tmp_path)).train


def test_days_that_follow_each_other_tell_day_from_month(tmp_path, init):
    at = [f"{1 + int(t) // 100:02d}/03/2024 {int(t) % 100 // 5:02d}:00:00" for t in TIME]
    _, toml, _ = init(write(tmp_path / "log.csv", when=at[::5], temp_c=T[::5], F_N=T[::5]))
    assert toml["sensor"]["time"]["format"].startswith("%d/%m")


def test_date_and_time_of_day_in_two_columns(tmp_path, init):
    clock = [f"10:{int(t) // 60:02d}:{int(t) % 60:02d}" for t in TIME]
    log = write(tmp_path / "log.csv", ";", Datum=["21.10.2024"] * 400, Uhrzeit=clock, T_C=T, F_N=T)
    _, toml, _ = init(log)
    assert toml["sensor"]["time"] == {"column": ["Datum", "Uhrzeit"]}
    assert load_dataset(load_config(tmp_path)).train


@pytest.mark.parametrize("period_s", [1e6, 3e-4])
def test_period_that_is_implausible_is_marked(tmp_path, init, period_s):
    _, _, checks = init(write(tmp_path / "log.csv", time_s=TIME * period_s, temp_c=T, F_N=T))
    assert any(line.startswith("sample_period_s") for line in checks)


def test_cadence_that_changes_gives_the_slower_period(tmp_path, init):
    time_s = np.cumsum(np.where(TIME < 200, 28.0, 43.0))
    told, _, _ = init(write(tmp_path / "log.csv", time_s=time_s, temp_c=T, F_N=T))
    assert told["sample_period_s"] == 43.0
    assert load_dataset(load_config(tmp_path)).train


def write_unit(folder: Path, shift: float = 0.0) -> None:
    slow = slice(None, None, 3)
    wave = T + shift * np.sin(TIME / 40)
    write(folder / "meter.csv", time_s=TIME[slow], V_mV=wave[slow])
    write(folder / "climate.csv", time_s=TIME, temp_c=wave, humidity=50 + T)


def test_folder_of_two_loggers_is_one_run(tmp_path, init):
    write_unit(tmp_path / "day1")
    told, toml, _ = init(tmp_path / "day1")
    assert toml["logs"]["train"] == ["day1@0%:60%"]
    assert told["sample_period_s"] == 3.0
    humidity = {"column": "humidity", "raw": "int16", "lsb": 2.0**-7}
    assert toml["format"] == 2 and toml["inputs"] == {"humidity": humidity}
    assert load_dataset(load_config(tmp_path)).test


def test_two_files_on_the_command_line_are_one_run(tmp_path, init):
    write_unit(tmp_path / "day1")
    _, toml, _ = init(tmp_path / "day1/meter.csv", tmp_path / "day1/climate.csv")
    assert toml["logs"]["train"] == ["day1/meter.csv + day1/climate.csv@0%:60%"]
    assert load_dataset(load_config(tmp_path)).test


def test_nested_folders_are_looked_through(tmp_path, init):
    for number, name in enumerate(("SN1/run1", "SN1/run2", "SN2/run1")):
        write_unit(tmp_path / "units" / name, shift=1.0 + number)
    _, toml, _ = init(tmp_path / "units")
    assert toml["logs"]["train"] == ["units/SN1/run1", "units/SN1/run2", "units/SN2/run1"]
    assert len(load_dataset(load_config(tmp_path)).train) == 3
    assert toml["sensor"]["name"] == "units"
    text = (tmp_path / "zerodrift.toml").read_text()
    assert '# [fleet] folder = "units/{sensor}"  # if each folder there is a unit' in text


def test_what_a_code_is_worth_holds_the_logs_of_all_units(tmp_path, init):
    """A unit alone would get a finer one; what the others log is in the project's one file."""
    for name, largest in (("SN1", 3.1), ("SN2", 11.7), ("SN3", 5.2)):
        more = {"supply_V": np.linspace(0.9 * largest, largest, TIME.size), "board_degC": T**2 / 9}
        wave = T + largest * np.sin(TIME / 40)
        write(tmp_path / f"{name}.csv", time_s=TIME, temp_c=wave, F_N=wave**2, **more)
    lsb = {}
    for logs in (("SN1.csv",), ("SN1.csv", "SN2.csv", "SN3.csv")):
        told, toml, _ = init("--force", *(tmp_path / log for log in logs))
        assert told["inputs"]["supply"] == "supply_V"
        lsb[logs] = toml["inputs"]["supply"]["lsb"]
        assert toml["inputs"]["temp"] == {"column": "temp_c", "raw": "int16", "lsb": 2.0**-7}
        config = load_config(tmp_path)
        runs = load_dataset(config).train
        codes = choose_input_codes(config, "supply", runs)
        assert (codes.bits, codes.lsb) == (16, lsb[logs])
    assert list(lsb.values()) == [2.0**-12, 2.0**-10]


def test_interactive_keeps_a_code_of_the_thermometer_that_was_not_chosen(tmp_path, init):
    log = write(tmp_path / "log.csv", time_s=TIME, oven_c=T, room_c=T**2 / 9, F_N=T)
    _, toml, _ = init("--interactive", log, answers="room_c\n1\n")
    other = {"column": "oven_c", "raw": "int16", "lsb": 2.0**-7}
    assert toml["inputs"] == {"thermometer": other}


def test_rows_without_times_need_a_period(tmp_path, init):
    log = write(tmp_path / "log.csv", temp_c=T, F_N=T)
    with pytest.raises(InputError, match=r"expected times. To go on: .* init --period-s SECONDS"):
        init(log)
    _, toml, _ = init("--period-s", "2", log)
    assert toml["logs"]["period_s"] == 2.0 and "time" not in toml["sensor"]
    assert load_dataset(load_config(tmp_path)).train


def test_interactive_asks_where_there_is_a_choice(tmp_path, init):
    log = write(tmp_path / "log.csv", time_s=TIME, oven_c=T, room_c=T**2, value=T)
    _, toml, checks = init("--interactive", log, answers="room_c\nmV\n2\n")
    assert toml["sensor"]["temperature"] == "room_c"
    assert toml["outputs"]["value"]["unit"] == "mV"
    assert toml["sensor"]["sample_period_s"] == 2.0
    assert not checks


@pytest.mark.parametrize("answer", ["oven_K", "room_F"])
def test_another_thermometer_is_brought_to_degc_too(tmp_path, init, answer):
    room = 20 + T**2 / 90
    columns = {"time_s": TIME, "oven_K": T + 273.15, "room_F": room * 1.8 + 32, "F_N": T**3}
    log = write(tmp_path / "log.csv", **columns)
    _, toml, _ = init("--interactive", log, answers=f"{answer}\n1\n")
    chosen, other = ("oven_K", "room_F") if answer == "oven_K" else ("room_F", "oven_K")
    units = {"oven_K": "K", "room_F": "degF"}
    assert toml["sensor"]["temperature"] == {"column": chosen, "unit": units[chosen]}
    (told,) = toml["inputs"].values()
    assert told == {"column": other, "unit": units[other], "raw": "int16", "lsb": 2.0**-7}
    run = load_dataset(load_config(tmp_path)).train[0]
    (values,) = run.inputs.values()
    count = values.size
    np.testing.assert_allclose(values, (T if other == "oven_K" else room)[:count], atol=1e-3)
    wanted = T if chosen == "oven_K" else room
    np.testing.assert_allclose(run.temperature_degC, wanted[:count], atol=1e-3)


def test_interactive_asks_how_dates_are_written(tmp_path, init):
    at = [f"04/03/2024 10:{int(t) // 60:02d}:{int(t) % 60:02d}" for t in TIME]
    log = write(tmp_path / "log.csv", when=at, temp_c=T, F_N=T)
    _, toml, checks = init("--interactive", log, answers="%m/%d/%Y %H:%M:%S.%f\n1\n")
    assert toml["sensor"]["time"]["format"] == "%m/%d/%Y %H:%M:%S.%f" and not checks
    (run,) = {run.group: run for run in load_dataset(load_config(tmp_path)).train}.values()
    assert run.start_s == datetime(2024, 4, 3, 10, tzinfo=UTC).timestamp()


def test_interactive_asks_for_the_unit_of_times_and_scales_the_period(tmp_path, init):
    log = tmp_path / "log.csv"
    lines = ["t,temp_c,F_N", *(f"{k * 500},{v},{v}" for k, v in enumerate(T))]
    log.write_text("\n".join(lines) + "\n")
    _, toml, _ = init("--interactive", log, answers="us\n\n")
    assert toml["sensor"]["time"] == {"column": "t", "unit": "us"}
    assert toml["sensor"]["sample_period_s"] == 0.0005


def as_logged(name: str) -> Path:
    path = AS_LOGGED / name
    if not path.exists():
        pytest.skip(f"../shared/data/as_logged/{name} is not at hand")
    return path


@pytest.mark.parametrize(
    ("folder", "temperature", "output", "unit", "runs"),
    [
        ("20171208-svrt-logging", "temp_c", "svrt", "LSB", 2),
        ("20171208-svrt-logging/1512853381-AD587-bare", "temp_c", "AD587_bare", "LSB", 1),
        ("20180117-hp34401a-tempco", "temp_c", "lm399", "LSB", 1),
        ("20170603-resistor-tempco-datalog-1", "temp_c", "value", "ohm", 7),
        ("20180309-r-tempcos/run1", "Oven (C)", "Resistance", "ohm", 1),
        pytest.param(
            *("20180309-r-tempcos", "Oven (C)", "Resistance", "ohm", 8), marks=pytest.mark.slow
        ),
    ],
)
def test_logs_as_their_author_wrote_them_work_unedited(
    tmp_path, init, folder, temperature, output, unit, runs
):
    _, toml, _ = init(as_logged(folder))
    assert toml["sensor"]["temperature"] == temperature
    assert {name: table["unit"] for name, table in toml["outputs"].items()} == {output: unit}
    dataset = load_dataset(load_config(tmp_path))
    groups = {run.group.partition("@")[0] for run in (*dataset.train, *dataset.test)}
    assert len(groups) == runs
    for run in dataset.train:
        assert -20 < run.temperature_degC.min() < run.temperature_degC.max() < 80


@pytest.mark.parametrize(
    ("folder", "lacks"),
    [
        ("20180115-vhp202z/run4-9k9850-3", "expected times."),
        ("20180505-dmm-chamber", "expected a thermometer."),
        ("20220816-34401a-in-a-box-pid", "expected a quantity that drifts."),
    ],
)
def test_logs_that_lack_something_are_told_what(init, folder, lacks):
    with pytest.raises(InputError) as caught:
        init(as_logged(folder))
    assert lacks in str(caught.value)


def test_a_dwell_that_comes_first_hides_no_input_and_no_range(tmp_path, init):
    still = np.zeros_like(TIME)
    wave = np.sin(TIME / 40)
    for name, moves in (("dwell", still), ("train_1", wave), ("train_2", 3 * wave)):
        write(
            tmp_path / "logs" / f"{name}.csv",
            time_s=TIME,
            temperature_degC=25 + 10 * moves + T / 1000,
            mass_kg=8 * moves + T / 1000,
            ref_mass_kg=8 * moves,
            supply_V=5 + 0.01 * moves,
            humidity_pct=45 + moves,
        )
    toml = init(tmp_path / "logs")[1]
    assert set(toml["inputs"]) == {"supply", "humidity"}
    assert toml["outputs"]["mass"]["full_scale"] == 50
    assert toml["sensor"]["name"] == "mass"
    assert toml["logs"]["dwell"] == ["logs/dwell.csv"]


def test_an_input_that_stands_still_in_each_log_but_not_in_all_is_one(tmp_path, init):
    for number in (1, 2, 3):
        humidity = 40 + number + 0 * TIME
        write(tmp_path / f"r{number}.csv", time_s=TIME, temp_c=T, V_mV=T, humidity=humidity)
    assert set(init(*sorted(tmp_path.glob("*.csv")))[1]["inputs"]) == {"humidity"}


def test_a_gyros_rate_is_measured_and_a_temperatures_is_computed(tmp_path, init):
    log = write(tmp_path / "a.csv", time_s=TIME, temp_c=T, rate_z_dps=T**2, temp_rate=T**3)
    assert list(init(log)[1]["outputs"]) == ["rate_z"]
