"""Wrong data stop `train` and `firmware` before anything is fitted, unless the user takes it on."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from tests.schemas import validate

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.diagnosis.referee import find_refusals

TOML = """[sensor]
name = "x"
time = "t"
temperature = "T"
sample_period_s = 1.0
[outputs.y]
measured = "y"
unit = "g"
full_scale = 10
[logs]
train = ["train*.csv"]
test = ["test*.csv"]
{more}
[[effect]]
kind = "zero_tempco"
order = 2
"""


def write_project(folder, more="", spoil=lambda y: y):
    rng = np.random.default_rng(1)
    time_s = np.arange(300)
    for name in (*(f"train_{i}" for i in range(1, 6)), "test_1"):
        turn = rng.uniform(0.7, 1.5) * 2.0 * np.pi * time_s / time_s.size + rng.uniform(0.0, 6.0)
        warm = 25.0 + 15.0 * np.sin(turn)
        y = 0.1 * (warm - 25.0) + 0.002 * (warm - 25.0) ** 2 + rng.normal(0.0, 0.02, time_s.size)
        y = spoil(y) if name == "train_3" else y
        rows = zip(time_s, warm + rng.normal(0.0, 0.01, time_s.size), y, strict=True)
        text = "t,T,y\n" + "".join(f"{t},{warm:.4f},{value:.5f}\n" for t, warm, value in rows)
        (folder / f"{name}.csv").write_text(text)
    (folder / "zerodrift.toml").write_text(TOML.format(more=more))
    return folder


def call(folder, *arguments):
    return CliRunner().invoke(cli, [*arguments, "-C", str(folder)])


@pytest.mark.parametrize("command", ["train", "export", "firmware"])
def test_wrong_sign_stops_it_and_nothing_is_written(tmp_path, command):
    result = call(write_project(tmp_path, spoil=np.negative), command, "--json")
    assert result.exit_code == 1
    told = json.loads(result.stdout)
    validate(told)
    assert told["written"] is False
    (entry,) = told["refused"]
    assert (entry["kind"], entry["run"], entry["column"]) == ("sign", "train_3", "y")
    assert entry["rows"] == [0, 299]
    assert 'accept = ["train_3: sign"]' in str(result.exception)
    assert not (tmp_path / "build" / "compensator.json").exists()
    assert not (tmp_path / "firmware").exists()


def test_what_zerodrift_toml_accepts_does_not_stop(tmp_path):
    folder = write_project(tmp_path, 'accept = ["train_3: sign"]', np.negative)
    config = load_config(folder)
    assert find_refusals(config, load_dataset(config)) == ()
    assert call(folder, "train").exit_code == 0


@pytest.mark.parametrize("entry", ["train_2: sign", "train_3: gain", "train 3: sign"])
def test_entry_that_matches_no_note_names_the_nearest(tmp_path, entry):
    config = load_config(write_project(tmp_path, f'accept = ["{entry}"]', np.negative))
    with pytest.raises(InputError, match=r"did you mean 'train_3: sign'"):
        find_refusals(config, load_dataset(config))


def test_entry_without_a_kind_is_refused(tmp_path):
    with pytest.raises(InputError, match=r'toml:13: .*expected "RUN: KIND"'):
        load_config(write_project(tmp_path, 'accept = ["train_3"]'))


def test_force_marks_header_and_manifest(tmp_path):
    folder = write_project(tmp_path, spoil=np.negative)
    assert call(folder, "firmware", "--force", "--no-uncertainty").exit_code == 0
    header = (folder / "firmware" / "x.h").read_text()
    said = " ".join(header.replace("*", " ").split())
    assert "FORCED: written although zerodrift refused it. Do not ship. Why it was refused:" in said
    assert "run train_3, column y: the column has the opposite sign" in said
    assert "opposite sign" in (folder / "firmware" / "manifest.json").read_text()
