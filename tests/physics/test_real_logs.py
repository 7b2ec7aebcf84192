"""The third-party measurements beside the repository, where they are at hand."""

from pathlib import Path

import numpy as np
import pytest

from zerodrift.base.config import EffectConfig, load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.diagnosis.diagnose import diagnose, diagnose_config
from zerodrift.physics.fit import fit

DATA = Path(__file__).parents[3] / "shared" / "data"

RESISTOR = """
[sensor]
name = "resistor"
time = "time_s"
temperature = "oven_temperature_degC"
sample_period_s = {period}

[outputs.R]
measured = "drift_ppm"
unit = "ppm"
full_scale = 1000

[logs]
train = {train}
test = {test}
where = {{ unit = "{unit}" }}

[[effect]]
kind = "zero_tempco"
"""

LOAD_CELL = """
[sensor]
name = "load_cell"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 256

[outputs.weight]
measured = "weight_kg"
reference = "static_load_nominal_kg"
unit = "kg"
full_scale = 150

[logs]
train = ["loadcell_h40a_22kg.csv"]

[[effect]]
kind = "zero_tempco"
"""


def open_logs(tmp_path, name, text):
    if not (DATA / name).is_file():
        pytest.skip(f"../shared/data/{name} is not at hand")
    (tmp_path / name).symlink_to(DATA / name)
    (tmp_path / "zerodrift.toml").write_text(text, encoding="utf-8")
    config = load_config(tmp_path)
    return config, load_dataset(config)


def open_genrad(tmp_path, test="[]"):
    name = "resistor_genrad2k_oven_ramps.csv"
    text = RESISTOR.format(
        period=5.0, train=f'["{name}#run1"]', test=f'["{name}#run2"]', unit="2k_card1_R1"
    )
    return open_logs(tmp_path, name, text)


def predict_test(dataset, effects):
    model = fit(
        effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
    )
    (run,) = dataset.test
    return float(np.sqrt(np.mean((run.drift - model.predict(run)) ** 2)))


def test_lag_of_the_resistor_is_named_and_predicts_the_other_run(tmp_path):
    config, dataset = open_genrad(tmp_path)
    diagnosis = diagnose_config(config, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_lag")
    assert 180.0 < diagnosis.parameters["tau_s"] < 220.0
    assert diagnosis.evidence.startswith("thin")
    before = predict_test(dataset, config.effects)
    after = predict_test(dataset, [*config.effects, EffectConfig("thermal_lag")])
    assert before > 4.5
    assert after < 2.6


def test_cubic_predicts_no_better_than_a_line(tmp_path):
    config, dataset = open_genrad(tmp_path)
    line = predict_test(dataset, config.effects)
    cubic = predict_test(dataset, [EffectConfig("zero_tempco", {"order": 3})])
    assert cubic > 0.95 * line


@pytest.mark.long
def test_slow_memory_of_the_divider_is_found(tmp_path):
    name = "resistor_vhd200_oven_ramps.csv"
    runs = [f"{name}#run{number}" for number in (11, 12, 13)]
    text = RESISTOR.format(
        period=10.0, train=str(runs).replace("'", '"'), test="[]", unit="divider2_12.5k"
    )
    # ppm of each run's own beginning; three runs are too few to show that they are tared
    text = text.replace("test = []\n", "tared = true\n")
    config, dataset = open_logs(tmp_path, name, text)
    diagnosis = diagnose_config(config, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_lag")
    assert 1800.0 < diagnosis.parameters["slow_tau_s"] < 7200.0


def test_lag_of_the_load_cell_is_named_from_one_run_and_called_thin(tmp_path):
    config, dataset = open_logs(tmp_path, "loadcell_h40a_22kg.csv", LOAD_CELL)
    diagnosis = diagnose(config.effects, dataset)
    assert diagnosis.evidence.startswith("thin: 1 run was cut")
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_lag")
    assert 900.0 < diagnosis.parameters["tau_s"] < 2400.0
    why = {untested.effect: untested.why for untested in diagnosis.not_testable}
    assert "load is unknown" in why["creep"]
    assert why["humidity"] == "no input 'humidity'"
