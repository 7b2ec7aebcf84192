"""Logged values become the quantity by what a column's table says: worked values and inverses."""

import numpy as np
import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.column_config import ConversionConfig, DividerConfig
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.load import load_dataset

KELVIN = 273.15


@pytest.mark.parametrize(
    ("by", "value", "expected"),
    [
        (ConversionConfig(unit="degF"), 212.0, 100.0),
        (ConversionConfig(unit="K"), 273.15, 0.0),
        (ConversionConfig(scale=0.01, offset=-40.0), 6500.0, 25.0),
        # IEC 60751, table 1: resistances at -200, -100, 0, 100 and 850 degC.
        (ConversionConfig(kind="pt100"), 18.52, -200.0),
        (ConversionConfig(kind="pt100"), 60.26, -100.0),
        (ConversionConfig(kind="pt100"), 100.0, 0.0),
        (ConversionConfig(kind="pt100"), 138.51, 100.0),
        (ConversionConfig(kind="pt1000"), 3904.81, 850.0),
        (ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950), 1e4, 25.0),
        (ConversionConfig(kind="table", points=((0, 0), (10, 20), (20, 60))), 15.0, 40.0),
        (ConversionConfig(kind="polynomial", coefficients=(1.0, 2.0, 3.0)), 2.0, 17.0),
    ],
)
def test_conversion_of_a_known_value(by, value, expected):
    assert convert(np.array([value]), by)[0] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("is_low", [True, False])
@pytest.mark.parametrize("series_ohm", [1e4, 4.7e3])
def test_thermistor_in_a_divider_inverts_its_own_equation(is_low, series_ohm):
    degc = np.linspace(-40, 150, 500)
    ohm = 1e4 * np.exp(3950 * (1 / (degc + KELVIN) - 1 / 298.15))
    share = ohm / (ohm + series_ohm) if is_low else series_ohm / (ohm + series_ohm)
    divider = DividerConfig(series_ohm, is_low, 65536.0)
    by = ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950.0, divider=divider)
    np.testing.assert_allclose(convert(65536 * share, by), degc, rtol=0, atol=1e-9)


def test_steinhart_hart_by_its_three_points():
    # Coefficients through 32650.8 ohm at 0 degC, 10000 at 25 and 3601.0 at 50 (solved by hand).
    degc, ohm = np.array([0.0, 25.0, 50.0]), np.array([32650.8, 10000.0, 3601.0])
    log = np.log(ohm)
    rows = np.stack([np.ones(3), log, log**3], axis=1)
    abc = tuple(np.linalg.solve(rows, 1 / (degc + KELVIN)))
    found = convert(ohm, ConversionConfig(kind="ntc", steinhart=abc))
    np.testing.assert_allclose(found, degc, atol=1e-9)


@pytest.mark.parametrize(
    ("by", "value"),
    [
        (ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950), -5.0),
        (ConversionConfig(kind="table", points=((0, 0), (10, 20))), 10.5),
        (
            ConversionConfig(
                kind="ntc", r25_ohm=1e4, beta_K=3950, divider=DividerConfig(1e4, True, 1024)
            ),
            1024.0,
        ),
    ],
)
def test_value_outside_the_conversion_has_none(by, value):
    assert np.isnan(convert(np.array([value]), by)[0])


def write_project(folder, temperature, measured='"Fz_N"', spoil=None):
    degc = 20 + np.arange(60) / 4
    codes = np.round(65536 / (1 + np.exp(-3950 * (1 / (degc + KELVIN) - 1 / 298.15))))
    codes[30] = codes[30] if spoil is None else spoil
    rows = [f"{k},{code:.0f},{1000 * k},0" for k, code in enumerate(codes)]
    (folder / "log.csv").write_text("\n".join(["time_s,adc,Fz_N,ref_Fz_N", *rows]) + "\n")
    text = render_toml('[logs]\ntrain = ["log.csv"]\n', outputs=(FORCE,))
    text = text.replace('temperature = "temperature_degC"', f"temperature = {temperature}")
    text = text.replace('measured = "Fz_N"', f"measured = {measured}")
    (folder / "zerodrift.toml").write_text(text)
    return degc


NTC = (
    '{ column = "adc", unit = "ohm", convert = "ntc", r25_ohm = 10000, beta_K = 3950, '
    'divider = { series_ohm = 10000, side = "low", counts = 65536 } }'
)


def test_columns_of_a_project_are_converted_and_told(tmp_path):
    degc = write_project(tmp_path, NTC, '{ column = "Fz_N", unit = "mN" }')
    dataset = load_dataset(load_config(tmp_path))
    (run,) = dataset.train
    np.testing.assert_allclose(run.temperature_degC, degc, atol=0.002)
    np.testing.assert_allclose(run.measured[:, 0], np.arange(60.0), rtol=1e-12)
    told = "'adc' is converted in the logs; the firmware is given the converted quantity"
    assert told in dataset.notes


def test_value_that_the_conversion_does_not_know_is_refused_with_its_line(tmp_path):
    write_project(tmp_path, NTC, spoil=65536)
    with pytest.raises(InputError) as caught:
        load_dataset(load_config(tmp_path))
    assert "log.csv:32: column 'adc' holds '65536', which its conversion in" in str(caught.value)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (
            '{ column = "adc", convert = "ntc", r25_ohm = 1 }',
            'convert = "ntc" needs r25_ohm and beta_K',
        ),
        ('{ column = "adc", convert = "pt100", unit = "V" }', 'convert = "pt100" is from ohm'),
        ('{ column = "adc", beta_K = 3950 }', 'beta_K belongs to convert = "ntc"'),
        ('{ column = "adc", convert = "table", points = [[0, 0], [2, 1], [1, 2]] }', "x rising or"),
        ('{ column = "adc", convert = "tc" }', "expected one of ntc, pt100, pt1000, thermocouple"),
        ('{ column = "adc", divider = { series_ohm = 1, counts = 2 } }', "gives ohm; expected"),
    ],
)
def test_conversion_that_contradicts_itself_is_refused(tmp_path, table, told):
    write_project(tmp_path, table)
    with pytest.raises(InputError) as caught:
        load_config(tmp_path)
    assert told in str(caught.value)


def test_units_of_different_quantities_are_refused(tmp_path):
    write_project(tmp_path, NTC, '{ column = "Fz_N", unit = "mV" }')
    with pytest.raises(InputError, match=r"unit is 'mV', and the output's unit 'N'"):
        load_config(tmp_path)
