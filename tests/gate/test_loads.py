"""Chips whose load is what they measured less their own last answer, judged by the gate."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.gate.sensors import ask_gate

LOADS_ALIKE = """sensor = { name = "alike", temperature = "temperature_degC", sample_period_s = 1 }
outputs.p = { measured = "p", reference = "ref_p", unit = "V", full_scale = 1 }
outputs.q = { measured = "q", reference = "ref_q", unit = "V", full_scale = 2 }
logs = { train = ["a.csv", "b.csv", "c.csv"], test = ["d.csv"], tared = false, period_s = 1 }
effect = [{ kind = "zero_tempco" }, { kind = "crosstalk" }]
network = { kind = "none" }
"""


def write_loads_alike(folder: Path) -> Path:
    """Two outputs whose loads are one, but for little, with drifts that part them strongly."""
    rng = np.random.default_rng(4)
    for name in "abcd":
        first = np.repeat(np.linspace(0.1, 0.95, 18), 60)
        second = 1.95 * first + 0.05 + 2e-4 * np.repeat(rng.standard_normal(18), 60)
        warm = 22.0 + 2.0 * np.sin(np.arange(first.size) / rng.uniform(100.0, 200.0))
        loads = np.stack([first, second])
        drift = np.array([[2.4, -1.23], [4.52, -2.29]]) @ loads + [[0.065], [0.069]]
        table = [warm, *loads, *(loads + drift + 1e-5 * rng.standard_normal(drift.shape))]
        header = "temperature_degC,ref_p,ref_q,p,q"
        file = folder / f"{name}.csv"
        np.savetxt(file, np.transpose(table), "%.7g", ",", header=header, comments="")
    (folder / "zerodrift.toml").write_text(LOADS_ALIKE)
    return folder


def test_chip_whose_loads_feed_on_each_other_answers_as_the_float_model(tmp_path: Path) -> None:
    """No limit of the correction stands in the way of the loop through its loads."""
    verdict = ask_gate(write_loads_alike(tmp_path))
    assert verdict.passes
    assert [part.clamped for part in verdict.chip_error] == [0.0, 0.0]
    assert max(part.rounding for part in verdict.chip_error) < 1e-4


WITH_LOADS = """
[sensor]
name = "s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.p]
measured = "p"
reference = "ref"
unit = "N"
full_scale = 20.0

[logs]
train = ["train.csv"]
test = ["test.csv"]
tared = false
period_s = 1

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "{kind}"

[network]
kind = "none"
"""


def write_log(
    file: Path, celsius: NDArray[np.float64], load: NDArray[np.float64], drift: NDArray[np.float64]
) -> None:
    noise = 1e-3 * np.random.default_rng(len(file.name)).standard_normal(load.size)
    table = np.stack([celsius, load, load + drift + noise], axis=1)
    np.savetxt(file, table, "%.7g", ",", header="temperature_degC,ref,p", comments="")


def test_load_and_temperature_that_met_in_no_run_are_no_reason_to_stop(tmp_path: Path) -> None:
    """Each was seen, so the correction is limited by both together."""
    (tmp_path / "zerodrift.toml").write_text(WITH_LOADS.format(kind="span_tempco"))
    rows = np.arange(1800)
    celsius = 25.0 - 12.0 * np.cos(rows / 150.0)
    shaken = np.sin(rows / 7.0)
    for name, sign in (("train", -1.0), ("test", 1.0)):
        load = 5.0 + 4.0 * np.sign(sign * (celsius - 25.0)) + 0.5 * shaken
        drift = 0.002 * (celsius - 25.0) + 0.004 * load * (celsius - 25.0)
        write_log(tmp_path / f"{name}.csv", celsius, load, drift)
    verdict = ask_gate(tmp_path)
    assert verdict.passes
    assert verdict.chip_error[0].clamped == 0.0


def test_what_creep_keeps_of_a_load_beyond_its_limit_is_an_after_effect(tmp_path: Path) -> None:
    (tmp_path / "zerodrift.toml").write_text(WITH_LOADS.format(kind="creep"))
    rows = np.arange(1800)
    celsius = 25.0 - 8.0 * np.cos(rows / 150.0)
    for name, high in (("train", 4.0), ("test", 12.0)):
        load = high * ((rows // 150) % 2)
        crept = np.zeros(load.size)
        for n in range(1, load.size):
            crept[n] = crept[n - 1] + (load[n] - crept[n - 1]) / 60.0
        write_log(tmp_path / f"{name}.csv", celsius, load, 0.01 * (celsius - 25.0) + 0.02 * crept)
    verdict = ask_gate(tmp_path)
    assert [s for s in verdict.refused if s.kind == "worse_than_float"] == []
    (split,) = verdict.chip_error
    assert split.out_of_range > 10.0 * split.rounding
