"""What the report says went into it: every file of a run, with its hash."""

import hashlib
from pathlib import Path

import numpy as np
import polars as pl
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.tasks.survey import trace_provenance


def test_each_file_of_a_run_that_is_a_folder_is_listed(tmp_path: Path) -> None:
    t = np.arange(60.0)
    meter = {"time_s": t, "Fz_N": t, "ref_Fz_N": 0 * t}
    (tmp_path / "day1").mkdir()
    pl.DataFrame(meter).write_csv(tmp_path / "day1" / "meter.csv")
    climate = {"time_s": t, "temperature_degC": 20 + t / 3}
    pl.DataFrame(climate).write_csv(tmp_path / "day1" / "climate.csv")
    rest = '[logs]\ntrain = ["day1@0%:50%"]\ntest = ["day1@50%:100%"]\n'
    (tmp_path / "zerodrift.toml").write_text(render_toml(rest, outputs=(FORCE,)))
    config = load_config(tmp_path)
    told = trace_provenance(config, load_dataset(config))
    assert {file.file: file.use for file in told.files} == {
        "zerodrift.toml": "configuration",
        "day1/climate.csv": "train, test",
        "day1/meter.csv": "train, test",
    }
    for file in told.files:
        assert file.sha256 == hashlib.sha256((tmp_path / file.file).read_bytes()).hexdigest()
