"""Values that `missing` in zerodrift.toml says are none."""

import pytest

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset

TOML = """[sensor]
name = "x"
time = "t"
temperature = {temperature}
sample_period_s = 1.0
[outputs.y]
measured = "y"
unit = "g"
full_scale = 10
[logs]
train = ["log.csv"]
{more}
"""


def open_project(folder, more, temperature='"T"', value=lambda i: f"{0.01 * i:.2f}"):
    rows = "".join(f"{i},{20 + 0.1 * i:.1f},{value(i)}\n" for i in range(120))
    (folder / "log.csv").write_text("t,T,y\n" + rows)
    (folder / "zerodrift.toml").write_text(TOML.format(more=more, temperature=temperature))
    return load_config(folder)


def spoilt(i):
    return {50: "-200", 70: "NAN", 71: " NAN"}.get(i, f"{0.01 * i:.2f}")


def test_numbers_and_texts_are_taken_out_and_counted(tmp_path):
    dataset = load_dataset(open_project(tmp_path, 'missing = [-200, "NAN"]', value=spoilt))
    assert "3 of 120 rows left out" in " ".join(dataset.notes)
    assert "(3 in 'y')" in " ".join(dataset.notes)
    assert min(run.measured.min() for run in dataset.train) == 0.0


def test_text_that_is_not_stated_is_refused_with_its_line(tmp_path):
    config = open_project(tmp_path, "missing = [-200]", value=spoilt)
    with pytest.raises(InputError, match=r"log.csv:7[0-9]: column 'y' (holds|is) .*NAN"):
        load_dataset(config)


def test_column_states_its_own(tmp_path):
    config = open_project(tmp_path, "", temperature='{ column = "T", missing = [25.0] }')
    assert config.missing.list_numbers("T") == (25.0,)
    assert config.missing.list_numbers("y") == ()
    assert "1 of 120 rows left out" in " ".join(load_dataset(config).notes)


def test_log_without_any_value_is_refused(tmp_path):
    config = open_project(tmp_path, "missing = [-200]", value=lambda i: "-200")
    with pytest.raises(InputError, match="all 120 rows"):
        load_dataset(config)


@pytest.mark.parametrize("value", ["[]", "-200", "[true]"])
def test_anything_but_a_list_of_values_is_refused(tmp_path, value):
    with pytest.raises(InputError, match="numbers and texts"):
        open_project(tmp_path, f"missing = {value}")
