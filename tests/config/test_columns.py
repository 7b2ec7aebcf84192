"""A column as a name or a table: what is read, and what is refused with file and line."""

from pathlib import Path

import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.column_config import LATER_KEYS, CodesConfig
from zerodrift.base.config import parse_config
from zerodrift.base.errors import InputError

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
        ('{ column = "T", raw = "uint16" }', "expected one of int16, int32"),
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


@pytest.mark.parametrize("key", LATER_KEYS)
def test_keys_of_later_versions_are_refused_by_name(key: str) -> None:
    message = refuse('"T"', f'supply = {{ column = "V", {key} = 1 }}')
    assert f"[inputs.supply] {key} is a key of column tables that this version does not" in message
