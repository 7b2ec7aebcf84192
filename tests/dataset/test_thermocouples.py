"""Thermocouples in logs: the published tables, cold junctions, and what is refused in words."""

import numpy as np
import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.column_config import ConversionConfig
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.chip_codes import TEMPERATURE, ChipCodes, refuse_outside
from zerodrift.dataset.conversions import COUPLES, convert, emf, find_sure_span, invert
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.log_steps import read_log_steps

MICROVOLT_ROUNDED = 0.5e-6
TABLES = {
    "B": {100: 0.033, 500: 1.242, 1000: 4.834, 1500: 10.099, 1820: 13.820},
    "E": {-200: -8.825, -100: -5.237, 100: 6.319, 500: 37.005, 1000: 76.373},
    "J": {-210: -8.095, -100: -4.633, 100: 5.269, 760: 42.919, 1000: 57.953, 1200: 69.553},
    "K": {-200: -5.891, -100: -3.554, 25: 1.000, 100: 4.096, 500: 20.644, 1372: 54.886},
    "N": {-200: -3.990, -100: -2.407, 100: 2.774, 500: 16.748, 1000: 36.256, 1300: 47.513},
    "R": {-50: -0.226, 100: 0.647, 500: 4.471, 1000: 10.506, 1500: 17.451, 1768: 21.101},
    "S": {-50: -0.236, 100: 0.646, 500: 4.233, 1000: 9.587, 1500: 15.582, 1768: 18.693},
    "T": {-200: -5.603, -100: -3.379, 100: 4.279, 200: 9.288, 400: 20.872},
}
"""Type -> degC -> mV, of the tables of NIST Monograph 175 (ITS-90), which are rounded to 1 uV."""


@pytest.mark.parametrize("couple", COUPLES)
def test_function_gives_the_published_table(couple):
    degc = np.array([float(t) for t in TABLES[couple]])
    wanted = np.array(list(TABLES[couple].values())) * 1e-3
    assert np.abs(emf(couple, degc) - wanted).max() <= MICROVOLT_ROUNDED * (1 + 1e-6)


@pytest.mark.parametrize("couple", COUPLES)
def test_inverse_undoes_the_function_over_all_that_it_tells(couple):
    low, high = find_sure_span(couple)
    degc = np.linspace(low, high, 20_001)
    assert np.abs(invert(couple, emf(couple, degc)) - degc).max() < 1e-6
    beyond = emf(couple, np.array([low, high])) + np.array([-1e-6, 1e-6])
    assert np.isnan(invert(couple, beyond)).all()


@pytest.mark.parametrize("couple", COUPLES)
def test_pieces_of_a_function_meet(couple):
    for before, after in zip(COUPLES[couple], COUPLES[couple][1:], strict=False):
        at = np.array([np.nextafter(before.high_degC, -1e9), before.high_degC])
        left, right = emf(couple, at)
        assert before.high_degC == after.low_degC and abs(right - left) < 1e-9


def test_cold_junction_is_added_as_a_voltage_and_not_as_a_temperature():
    # K: 500 degC against a junction at 25 degC is 20.644 - 1.000 mV; 475 degC alone is 19.579 mV.
    by = ConversionConfig(kind="thermocouple", couple="K", unit="mV", junction="board")
    (found,) = convert(np.array([20.644 - 1.000]), by, np.array([25.0]))
    assert found == pytest.approx(500.0, abs=0.03)
    fixed = ConversionConfig(kind="thermocouple", couple="K", unit="uV", junction_degC=25.0)
    assert convert(np.array([19_644.0]), fixed)[0] == pytest.approx(500.0, abs=0.03)
    ice = ConversionConfig(kind="thermocouple", couple="K", junction_degC=0.0)
    assert convert(np.array([0.020644]), ice)[0] == pytest.approx(500.0, abs=0.03)


def write_project(folder, temperature, extra_inputs="", spoil=None):
    degc, board = 200.0 + np.arange(60), 22.0 + np.arange(60) / 20
    volts = emf("J", degc) - emf("J", board)
    if spoil is not None:
        volts[30] = spoil
    rows = [
        f"{k},{1e6 * v:.3f},{b:.4f},{b:.4f},{1000 * k},0"
        for k, (v, b) in enumerate(zip(volts, board, strict=True))
    ]
    names = "time_s,tc_uV,board_degC,other,Fz_N,ref_Fz_N"
    (folder / "log.csv").write_text("\n".join([names, *rows]) + "\n")
    text = render_toml('[logs]\ntrain = ["log.csv"]\n', outputs=(FORCE,))
    text = text.replace('temperature = "temperature_degC"', f"temperature = {temperature}")
    text += f'\n[inputs]\nboard = "board_degC"\n{extra_inputs}\n'
    (folder / "zerodrift.toml").write_text(text)
    return folder


COUPLE = '{ column = "tc_uV", unit = "uV", convert = "thermocouple", type = "J"%s }'


def test_a_log_of_voltages_and_a_board_becomes_temperatures(tmp_path):
    folder = write_project(tmp_path, COUPLE % ', cold_junction = "board"')
    (run,) = load_dataset(load_config(folder)).train
    assert np.abs(run.temperature_degC - (200.0 + np.arange(60))).max() < 1e-3


def test_a_row_beyond_the_function_is_refused_with_its_line(tmp_path):
    folder = write_project(tmp_path, COUPLE % ', cold_junction = "board"', spoil=0.2)
    told = r"log\.csv:32: column 'tc_uV' holds '200000\.000'.*does not cover"
    with pytest.raises(InputError, match=told):
        load_dataset(load_config(folder))


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("", r"zerodrift\.toml:\d+: .*gives a difference of temperatures; expected cold_junction"),
        (', cold_junction = "bord"', r"'bord', which is no other input; did you mean 'board'\?"),
        (', cold_junction = "hot"', r"is 'hot', which is a thermocouple with a cold junction of"),
        (
            ", cold_junction = true",
            r"cold_junction is True; expected the name of one of \[inputs\]",
        ),
        (', cold_junction = "board", type = "Q"', "Cannot overwrite|not valid TOML"),
        (', cold_junction = "board", r25_ohm = 5', r'belongs to convert = "ntc"'),
        (
            ', cold_junction = "board", divider = { series_ohm = 1, side = "low", counts = 9 }',
            "gives ohm",
        ),
    ],
)
def test_a_table_that_says_too_little_is_refused(tmp_path, more, told):
    hot = '{ column = "other", convert = "thermocouple", type = "K", cold_junction = "board" }'
    folder = write_project(tmp_path, COUPLE % more, f"hot = {hot}")
    with pytest.raises(InputError, match=told):
        load_config(folder)


def test_an_unknown_type_and_a_wrong_unit_are_refused(tmp_path):
    folder = write_project(tmp_path, COUPLE.replace('"J"', '"L"') % ", cold_junction = 0")
    with pytest.raises(InputError, match=r"type is 'L'; expected one of B, E, J, K, N, R, S, T"):
        load_config(folder)
    folder = write_project(tmp_path, COUPLE.replace('"uV"', '"ohm"') % ", cold_junction = 0")
    with pytest.raises(InputError, match=r"is 'ohm', but convert = \"thermocouple\" is from V"):
        load_config(folder)
    folder = write_project(tmp_path, COUPLE.replace(', type = "J"', "") % ", cold_junction = 0")
    with pytest.raises(InputError, match=r'needs type = "K" beside it; expected one of B, E'):
        load_config(folder)


def write_run(folder, junction_s, volts_of=None):
    """Write a run of two files: a meter's voltages, 1 s apart, and the junction's logger."""
    toml = write_project(folder, COUPLE % ', cold_junction = "board"') / "zerodrift.toml"
    toml.write_text(toml.read_text().replace('["log.csv"]', '["run"]'))
    (folder / "run").mkdir()
    time_s = np.arange(60.0)
    volts = emf("J", 200.0 + time_s) - emf("J", 22.0 + time_s / 20)
    if volts_of is not None:
        volts[30] = volts_of
    meter = [f"{t},{1e6 * v:.3f},{1000 * t},0" for t, v in zip(time_s, volts, strict=True)]
    names = "time_s,tc_uV,Fz_N,ref_Fz_N"
    (folder / "run" / "meter.csv").write_text("\n".join([names, *meter]) + "\n")
    climate = [f"{t},{22.0 + t / 20:.4f}" for t in junction_s]
    (folder / "run" / "climate.csv").write_text("\n".join(["time_s,board_degC", *climate]) + "\n")
    return load_config(folder)


@pytest.mark.parametrize("step_s", [0.4, 1.0, 1.3])
def test_a_cold_junction_may_come_from_another_file_of_the_run(tmp_path, step_s):
    """Its logger may be faster or slower, and begin later: rows without it are left out."""
    config = write_run(tmp_path, np.arange(2.7, 58.0, step_s))
    dataset = load_dataset(config)
    (run,) = dataset.train
    ends = (run.time_s[0], run.time_s[-1])
    assert ends[0] >= 2.7 and ends[1] <= 58.0 and run.time_s.size >= 50
    # a step is the mean of the period that it ends, in which a row holds until the next one
    late_s = 0.5 + step_s / 2 + 0.05
    assert np.abs(run.temperature_degC - (200.0 + run.time_s)).max() < late_s
    slope = np.diff(run.temperature_degC)
    assert np.abs(slope - 1.0).max() < 0.05
    assert np.abs(run.inputs["board"] - (22.0 + run.time_s / 20)).max() < 0.05
    assert any("joined on time" in note for note in dataset.notes)


def test_a_junction_in_another_file_gives_what_one_in_the_same_file_gives(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = write_project(tmp_path / "a", COUPLE % ', cold_junction = "board"')
    (whole,) = load_dataset(load_config(one)).train
    (joined,) = load_dataset(write_run(tmp_path / "b", np.arange(60.0))).train
    assert joined.temperature_degC.tobytes() == whole.temperature_degC.tobytes()


def test_a_hole_in_the_junctions_log_is_a_gap_of_the_run(tmp_path):
    at = np.concatenate([np.arange(0.0, 25.0), np.arange(35.0, 60.0)])
    runs = load_dataset(write_run(tmp_path, at)).train
    assert [run.time_s.size for run in runs] == [25, 25]


def test_a_row_beyond_the_function_is_refused_in_the_file_that_holds_it(tmp_path):
    config = write_run(tmp_path, np.arange(0.0, 60.0, 1.2), volts_of=0.2)
    told = (
        r"run/meter\.csv:32: column 'tc_uV' holds '200000\.000', which with its cold junction "
        r"'board_degC' at 23\.5 degC makes no temperature by type J; expected a temperature .*or "
        r"pass --skip-invalid to drop it"
    )
    with pytest.raises(InputError, match=told):
        load_dataset(config)
    dataset = load_dataset(config, skip_invalid=True)
    assert sum(run.time_s.size for run in dataset.train) == 59  # the row is bridged
    assert any("dropped 1 of 59 rows whose voltage and cold" in note for note in dataset.notes)


def test_a_folder_with_its_junction_in_another_file_is_applied_to(tmp_path):
    config = write_run(tmp_path, np.arange(0.0, 60.0, 1.2), volts_of=0.2)
    columns = {config.temperature_column: "[sensor] temperature"}
    steps = read_log_steps(config, tmp_path / "run", columns)
    found = steps.table.columns[config.temperature_column]
    assert np.flatnonzero(np.isnan(found)).tolist() == [30]  # a hole, as every model's reading
    assert np.abs(np.delete(found - (200.0 + np.arange(59.0)), 30)).max() < 1e-3
    frame = steps.source.frame
    assert frame is not None  # whoever is given the rows is given them as they were logged
    volts = emf("J", np.array([200.0, 201.0])) - emf("J", np.array([22.0, 22.05]))
    assert frame["tc_uV"][:2].to_list() == (1e6 * volts).round(3).tolist()


def test_what_no_code_says_of_a_joined_thermocouple_is_told_by_its_time(tmp_path):
    """Voltage and junction lie in two files, so that the message gives the run and the time."""
    config = write_run(tmp_path, np.arange(0.0, 60.0, 1.2))
    codes = ChipCodes("t", TEMPERATURE, "tc_uV", "degC", 16, 0.0078125, None, "Correct it.")
    with pytest.raises(InputError, match=r"^run: at 56 s: run .*255\.9999\d* degC; .*Correct it\."):
        refuse_outside(config, [codes], load_dataset(config).train)
