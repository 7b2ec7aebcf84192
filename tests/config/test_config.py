"""zerodrift.toml: what is read from it, and what is refused with file, line and remedy."""

from pathlib import Path

import pytest

from zerodrift.base.config import load_config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.toml_table import find_line, index_lines

WHOLE = """\
[sensor]
name = "ft 40"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 2000

[outputs."M x"]
measured = "Mx_Nm"
reference = 1.5
unit = "Nm"
full_scale = 14.0

[inputs]
supply = "supply_V"
body_temperature = "t_body_degC"

[logs]
train = [
    "logs/chamber_*.csv",  # cold
    "logs/long.csv@0%:60%",
]
test = ["logs/walk_*.csv"]
dwell = ["logs/dwell.csv"]
where = { unit = "card1", channel = 3 }

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "thermal_lag"
tau_s = 60
signal = "body_temperature"

[network]
kind = "gru"
hidden = 24
memory = 10
seed = 7
starts = 3
epochs = 40
form = "reset_before"
learning_rate = 1e-3
lags_s = [4, 64.0]

[quantization]
weights = "int8"

[firmware]
out = "out/c"
"""
HERE = Path("/project/zerodrift.toml")


def change(old: str, new: str) -> str:
    """Return WHOLE with one piece replaced, insisting that it was there."""
    assert WHOLE.count(old) == 1, old
    return WHOLE.replace(old, new)


def refusal(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_config(text, HERE)
    return str(caught.value)


def line_of(text: str, part: str) -> int:
    return next(n for n, line in enumerate(text.splitlines(), 1) if part in line)


def test_config_reads_every_documented_key():
    config = parse_config(WHOLE, HERE)
    assert config.sensor_name == "ft 40"
    assert (config.time_column, config.temperature_column) == ("time_s", "temperature_degC")
    assert config.sample_period_s == 1.0
    assert [output.name for output in config.outputs] == ["Fz", "M x"]
    assert [output.reference for output in config.outputs] == ["ref_Fz_N", 1.5]
    assert [output.full_scale for output in config.outputs] == [2000.0, 14.0]
    assert dict(config.inputs) == {"supply": "supply_V", "body_temperature": "t_body_degC"}
    assert config.train_logs == ("logs/chamber_*.csv", "logs/long.csv@0%:60%")
    assert config.test_logs == ("logs/walk_*.csv",)
    assert config.dwell_logs == ("logs/dwell.csv",)
    assert dict(config.where) == {"unit": "card1", "channel": "3"}
    lag = config.effects[1]
    assert lag.kind == "thermal_lag"
    assert dict(lag.held) == {"tau_s": 60.0}
    assert dict(lag.options) == {"signal": "body_temperature"}
    assert lag.line == line_of(WHOLE, 'kind = "thermal_lag"') - 1
    network = config.network
    assert (network.kind, network.hidden, network.memory, network.seed) == ("gru", 24, 10, 7)
    assert network.lags_s == (4.0, 64.0)
    assert dict(network.options) == {
        "starts": 3,
        "epochs": 40,
        "form": "reset_before",
        "learning_rate": 1e-3,
    }
    assert config.weights == "int8"
    assert config.firmware_out == Path("/project/out/c")
    assert config.build_directory == Path("/project/build")


def test_firmware_has_a_prefix_and_a_guard():
    given = '[firmware]\nprefix = "{sensor} left"\nguard = true\n'
    text = WHOLE[: WHOLE.index("[firmware]")] + given
    config = parse_config(text, HERE)
    assert (config.firmware_prefix, config.firmware_guard) == ("{sensor} left", True)
    assert config.firmware_out == Path("/project/firmware")
    for wrong, told in (('prefix = "{unit}"', "{sensor}"), ("guard = 1", "true or false")):
        key = wrong.split(" =")[0]
        line = next(row for row in given.splitlines() if row.startswith(key))
        with pytest.raises(InputError, match=told):
            parse_config(text.replace(line, wrong), HERE)


def test_config_leaves_optional_tables_at_their_defaults():
    start, end = WHOLE.index("[inputs]"), WHOLE.index("[logs]")
    text = WHOLE[:start] + WHOLE[end : WHOLE.index("test =")]
    text = text.replace('reference = "ref_Fz_N"\n', "")
    config = parse_config(text, HERE)
    assert config.outputs[0].reference == 0.0
    assert (config.inputs, config.test_logs, config.dwell_logs, config.where) == ({}, (), (), {})
    assert config.effects == ()
    assert config.network.kind == "none"
    assert config.weights == "int16"
    assert config.firmware_out == Path("/project/firmware")
    assert (config.firmware_prefix, config.firmware_guard) == ("", False)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "sample_period_s = 1",
            "sample_perod_s = 1",
            ["[sensor] sample_perod_s", "'sample_period_s'"],
        ),
        ("sample_period_s = 1", "sample_period_s = 0", ["sample_period_s is 0", "> 0"]),
        ("sample_period_s = 1", "sample_period_s = -2.5", ["-2.5", "> 0"]),
        ("sample_period_s = 1", "sample_period_s = nan", ["nan", "finite"]),
        ("sample_period_s = 1", "sample_period_s = true", ["True", "a number > 0"]),
        ("sample_period_s = 1", "sample_period_s = 1" + "0" * 400, ["finite"]),
        ('time = "time_s"', "time = 3", ["[sensor] time is 3", "text in quotes"]),
        ('name = "ft 40"', 'name = ""', ["[sensor] name", "not empty"]),
        ("full_scale = 2000", "full_scale = 0", ["[outputs.Fz] full_scale is 0", "> 0"]),
        ("full_scale = 2000", "fullscale = 2000", ["fullscale", "'full_scale'"]),
        ("reference = 1.5", "reference = [1]", ["[outputs.M x] reference", "a number"]),
        ("hidden = 24", "hidden = 2.5", ["[network] hidden is 2.5", "whole number 1 to 256"]),
        ("hidden = 24", "hidden = 0", ["hidden is 0", "1 to 256"]),
        ('kind = "gru"', 'kind = "gur"', ["[network] kind is 'gur'", "'gru'"]),
        ("memory = 10", "memory = 1", ["memory is 1", "2 to 4096"]),
        ("memory = 10", 'memory = "steam"', ["'steam'", "'stream' or a window of 2 to 4096"]),
        ("seed = 7", "seed = -1", ["seed is -1", ">= 0"]),
        ("epochs = 40", "epochs = 0", ["epochs is 0", "1 to 1000000"]),
        ("epochs = 40", "epoch = 40", ["[network] epoch", "'epochs'"]),
        ('form = "reset_before"', 'form = "before"', ["'before'", "reset_before"]),
        ("learning_rate = 1e-3", "learning_rate = -1", ["learning_rate is -1", "> 0"]),
        ("lags_s = [4, 64.0]", "lags_s = [4, 0]", ["lags_s", "numbers > 0"]),
        ("lags_s = [4, 64.0]", "lags_s = 4", ["lags_s is 4", "list"]),
        ('weights = "int8"', 'weights = "int4"', ["'int4'", "int16, int8"]),
        ('test = ["logs/walk_*.csv"]', "test = []", ["[logs] test is []", "not empty"]),
        ('test = ["logs/walk_*.csv"]', 'test = "logs/walk_*.csv"', ["a list of texts"]),
        ('test = ["logs/walk_*.csv"]', 'tared = "yes"', ["[logs] tared is 'yes'", "true, false"]),
        ('test = ["logs/walk_*.csv"]', 'tests = ["a.csv"]', ["[logs] tests", "'test'"]),
        ("tau_s = 60", "tau_s = [60]", ["[effect] tau_s is [60]", "a number (held at it)"]),
        ("tau_s = 60", "tau_s = inf", ["tau_s is inf", "finite"]),
        ('supply = "supply_V"', "supply = 5", ["[inputs] supply is 5", "text in quotes"]),
        ("[firmware]", "[firmwre]", ["[firmwre]", "'firmware'"]),
        ('measured = "Mx_Nm"', 'measured = "Fz_N"', ["'Fz_N'", "[outputs.Fz] measured"]),
        ('reference = "ref_Fz_N"', 'reference = "Fz_N"', ["the drift would be 0"]),
        ('temperature = "temperature_degC"', 'temperature = "time_s"', ["[sensor] time"]),
    ],
)
def test_config_refuses_a_wrong_value_with_its_line_and_what_was_expected(old, new, expected):
    text = change(old, new)
    message = refusal(text)
    line = WHOLE[: WHOLE.index(old)].count("\n") + 1
    assert message.startswith(f"{HERE}:{line}: "), message
    for part in expected:
        assert part in message


@pytest.mark.parametrize(
    ("key", "table"),
    [
        ('time = "time_s"\n', "[sensor]"),
        ('unit = "N"\n', "[outputs.Fz]"),
        ('kind = "gru"\n', "[network]"),
    ],
)
def test_config_names_a_missing_key_at_its_table(key, table):
    text = change(key, "")
    message = refusal(text)
    assert message.startswith(f"{HERE}:{line_of(text, table)}: {table} {key.split()[0]} is missing")


@pytest.mark.parametrize(
    ("text", "said"), [("true", True), ("false", False), ('"auto"', None), (None, None)]
)
def test_config_reads_whether_logs_are_tared(text, said):
    old = 'test = ["logs/walk_*.csv"]'
    more = f"{old}\ntared = {text}" if text else old
    assert parse_config(change(old, more), HERE).tared is said


def test_config_refuses_an_effect_without_a_kind_at_its_own_line():
    text = change('kind = "thermal_lag"\n', "")
    assert f":{line_of(text, 'tau_s') - 1}: [effect] kind is missing" in refusal(text)


def test_config_refuses_a_missing_table():
    assert "table [logs] is missing" in refusal(WHOLE[: WHOLE.index("[logs]")])


def test_config_refuses_more_than_sixteen_outputs():
    tables = "".join(
        f'[outputs.y{i}]\nmeasured = "y{i}"\nunit = "N"\nfull_scale = 1\n' for i in range(17)
    )
    start, end = WHOLE.index("[outputs.Fz]"), WHOLE.index("[inputs]")
    message = refusal(WHOLE[:start] + tables + WHOLE[end:])
    assert "17 outputs" in message
    assert "1 to 16" in message


def test_config_refuses_broken_toml_with_the_line():
    text = change('time = "time_s"', "time = time_s")
    message = refusal(text)
    assert message.startswith(f"{HERE}:{line_of(text, 'time = time_s')}: not valid TOML")


def test_config_refuses_a_plugin_that_is_no_file(tmp_path):
    path = tmp_path / "zerodrift.toml"
    path.write_text(WHOLE + '[plugins]\nfiles = ["mine.py"]\n')
    with pytest.raises(InputError, match=r"'mine\.py' is not a file; expected it at"):
        load_config(path)
    (tmp_path / "mine.py").write_text("")
    assert load_config(path).plugin_files == (tmp_path / "mine.py",)


def test_load_config_takes_the_file_or_its_directory(tmp_path):
    (tmp_path / "zerodrift.toml").write_text(WHOLE)
    assert load_config(tmp_path) == load_config(tmp_path / "zerodrift.toml")


def test_load_config_says_how_to_get_a_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"zerodrift\.toml: there is no such file.*init LOG"):
        load_config(tmp_path)


def test_load_config_names_the_line_that_is_not_utf8(tmp_path):
    (tmp_path / "zerodrift.toml").write_bytes(b'[sensor]\nname = "\xb0"\n')
    with pytest.raises(InputError, match=r"zerodrift\.toml:2: byte 0xb0 is not UTF-8"):
        load_config(tmp_path)


def test_index_lines_finds_keys_after_texts_and_lists_that_span_lines():
    text = (
        'a = """\n[not_a_table]\nx = 1\n"""\n'  # lines 1-4
        "b = [\n  [1, 2],  # ]]\n  3,\n]\n"  # lines 5-8
        "[[t]]\n'k.1'.n = '#'\n[[t]]\n\"k.1\" = {z = 1}\n"  # lines 9-12
    )
    lines = index_lines(text)
    assert lines["b",] == 5
    assert ("not_a_table",) not in lines
    assert lines["t", 0, "k.1", "n"] == 10
    assert lines["t", 1, "k.1"] == 12
    assert find_line(lines, ("t", 1, "k.1", "z")) == 12
    assert find_line(lines, ("t", 1, "absent")) == 11
