"""A column as a name or a table: what is read, and what is refused with file and line."""

from pathlib import Path

import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.column_config import CodesConfig, ConversionConfig, DividerConfig
from zerodrift.base.config import parse_config
from zerodrift.base.errors import InputError

NTC = 'convert = "ntc", r25_ohm = 10000, beta_K = 3950'
DIVIDER = 'divider = { series_ohm = 10000, side = "low", counts = 65536 }'
HERE = Path("/project/zerodrift.toml")
LOGS = '[logs]\ntrain = ["logs/*.csv"]\n'
NAME = 'temperature = "temperature_degC"'


def write(temperature: str, inputs: str = "") -> str:
    """Return a configuration with a value for the thermometer, and lines of [inputs]."""
    text = render_toml(f"{LOGS}\n[inputs]\n{inputs}\n", outputs=(FORCE,))
    assert text.count(NAME) == 1
    return text.replace(NAME, f"temperature = {temperature}")


def refuse(temperature: str, inputs: str = "") -> str:
    with pytest.raises(InputError) as caught:
        parse_config(write(temperature, inputs), HERE)
    return str(caught.value)


def test_name_stays_what_it_was() -> None:
    config = parse_config(write('"T"', 'supply = "supply_V"'), HERE)
    assert config.temperature_column == "T" and config.temperature_codes == CodesConfig()
    assert dict(config.inputs) == {"supply": "supply_V"}
    assert dict(config.input_codes) == {"supply": CodesConfig()}


def test_tables_say_what_the_chip_is_given() -> None:
    table = '{ column = "T", raw = "int32", lsb = 0.25, range = [-50, 1200], no_reading = -1 }'
    config = parse_config(
        write(table, 'supply = { column = "V", raw = "int16", no_reading = false }'), HERE
    )
    assert config.temperature_column == "T"
    assert config.temperature_codes == CodesConfig(32, 0.25, (-50.0, 1200.0), -1)
    assert dict(config.inputs) == {"supply": "V"}
    assert config.input_codes["supply"] == CodesConfig(16, always_read=True)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('{ lsb = 1.0 }', "[sensor.temperature] column is missing"),
        ('{ column = "T", rnage = [0, 1] }', "did you mean 'range'"),
        ('{ column = "T", raw = "uint8" }', "expected one of uint16, int16, int32"),
        ('{ column = "T", raw = "uint16", no_reading = -1 }', "whole number 0 to 65535"),
        ('{ column = "T", raw = "uint16", log_is = "ohm" }', "expected one of quantity, code"),
        ('{ column = "T", raw = "uint16", log_is = "code" }', "no such conversion; expected raw"),
        ('{ column = "T", scale = 2, log_is = "quantity" }', "no such conversion; expected raw"),
        ('{ column = "T", scale = 0, raw = "int16" }', "makes one value of all codes"),
        (f'{{ column = "T", {NTC}, raw = "uint16", unit = "degC" }}', 'and log_is = "quantity"'),
        (f'{{ column = "T", {NTC}, raw = "uint16", unit = "V" }}', 'expected unit = "ohm". Bring'),
        (f'{{ column = "T", {NTC}, raw = "int16", {DIVIDER} }}', 'raw = "int16" ends at 32767'),
        (f'{{ column = "T", {NTC}, divider = {{ series_ohm = 1e4 }} }}', "counts is missing"),
        (f'{{ column = "T", {NTC}, steinhart = [1, 2, 3] }}', "and not both"),
        (f'{{ column = "T", scale = 2, {DIVIDER} }}', 'gives ohm; expected convert = "ntc"'),
        (
            '{ column = "T", convert = "table", points = [[0, 1], [1, 2], [2, 1]], raw = "int16" }',
            "go from [1.0, 2.0] to [2.0, 1.0], where y turns or stands",
        ),
        ('{ column = "T", lsb = 0 }', "[sensor.temperature] lsb is 0; expected a number > 0"),
        ('{ column = "T", range = [3, 3] }', "expected [lowest, highest], two numbers"),
        ('{ column = "T", range = [3] }', "expected [lowest, highest], two numbers"),
        ('{ column = "T", range = [0, "x"] }', "expected [lowest, highest], two numbers"),
        ('{ column = "T", raw = "int16", no_reading = 40000 }', "whole number -32768 to 32767"),
        ('{ column = "time_s" }', "column 'time_s' is both [sensor] time and"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_table_is_told_with_its_line(table: str, told: str) -> None:
    message = refuse(table)
    assert told in message
    assert message.startswith(f"{HERE}:4: ")


def test_what_the_chip_converts_is_read_apart_from_the_log() -> None:
    held = f'{{ column = "T", {NTC}, raw = "uint16", {DIVIDER}, log_is = "quantity" }}'
    config = parse_config(write(held), HERE)
    given = config.temperature_codes
    assert (given.raw, given.bits) == ("uint16", None) and given.by is not None
    assert given.by.divider == DividerConfig(1e4, True, 65536.0, rail=64.0)
    assert config.conversions["T"] == ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950.0)
    config = parse_config(write(held.replace("raw", 'unit = "degC", raw')), HERE)
    assert not config.conversions and config.temperature_codes.by == given.by
    config = parse_config(write(held.replace("quantity", "code")), HERE)
    assert config.conversions["T"] == given.by


@pytest.mark.parametrize(
    ("table", "raw", "scale", "in_log"),
    [
        ('{ column = "V", scale = 0.001, raw = "uint16" }', "uint16", 0.001, 0.001),
        ('{ column = "V", scale = 0.001, raw = "int16" }', "int16", 0.001, 0.001),
        ('{ column = "V", scale = 0.5, raw = "int16", log_is = "quantity" }', "int16", 0.5, None),
        ('{ column = "V", scale = 0.001, raw = "int16", lsb = 0.01 }', "", None, 0.001),
        ('{ column = "V", raw = "uint16", lsb = 0.01 }', "uint16", None, None),
    ],
)
def test_scale_is_what_a_raw_code_is_worth_unless_lsb_says_so(
    table: str, raw: str, scale: float | None, in_log: float | None
) -> None:
    config = parse_config(write('"T"', f"supply = {table}"), HERE)
    codes = config.input_codes["supply"]
    assert codes.raw == raw
    assert (codes.by.scale if codes.by else None) == scale
    found = config.conversions.get("V")
    assert (found.scale if found else None) == in_log
