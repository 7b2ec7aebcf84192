"""The loop on third-party measurements beside the repository; skipped by name without them."""

import json
from pathlib import Path

import pytest

DATA = Path(__file__).parents[3] / "shared" / "data"

TOML = """\
[sensor]
name = "{name}"
time = "time_s"
temperature = "{temperature}"
sample_period_s = {period}

[outputs.{output}]
measured = "{measured}"
{reference}unit = "{unit}"
full_scale = {full_scale}

[logs]
train = {train}
{more}
[[effect]]
kind = "zero_tempco"
"""


@pytest.fixture
def open_real(tmp_path):
    """Return a function that lays a log and its zerodrift.toml into a directory."""

    def lay_out(log, **values):
        if not (DATA / log).is_file():
            pytest.skip(f"../shared/data/{log} is not at hand")
        (tmp_path / log).symlink_to(DATA / log)
        (tmp_path / "zerodrift.toml").write_text(TOML.format(**values))
        return tmp_path

    return lay_out


def open_resistor(open_real, log, unit, train, test="", period=5, more=""):
    names = ", ".join(f'"{log}#{run}"' for run in train)
    more += f'where = {{ unit = "{unit}" }}\n'
    return open_real(
        log,
        name="resistor",
        temperature="oven_temperature_degC",
        period=period,
        output="R",
        measured="drift_ppm",
        reference="",
        unit="ppm",
        full_scale=100,
        train=f"[{names}]",
        more=more + (f'test = ["{log}#{test}"]\n' if test else ""),
    )


def test_genrad_diagnose_proposes_the_lag_and_add_reaches_the_mark(open_real, zerodrift):
    log = "resistor_genrad2k_oven_ramps.csv"
    directory = open_resistor(open_real, log, "2k_card1_R1", ["run1"], "run2")
    told = json.loads(zerodrift("diagnose", "-C", directory, "--json").out)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert 180.0 < told["parameters"]["tau_s"] < 220.0
    assert told["command"] == f"zerodrift add thermal_lag -C {directory}"
    added = json.loads(zerodrift("add", "thermal_lag", "-C", directory, "--json").out)
    assert added["before"]["rmse_heldout"]["R"] > 4.0
    # The mark of a cubic with a lag is 2.53 ppm on this run.
    assert added["after"]["rmse_heldout"]["R"] < 2.53
    assert "(thin evidence)" in zerodrift("diagnose", "-C", directory).out


@pytest.mark.long
def test_vhd200_diagnose_finds_the_slow_memory(open_real, zerodrift):
    log = "resistor_vhd200_oven_ramps.csv"
    runs = ["run11", "run12", "run13"]
    # ppm of each run's own beginning; three runs are too few to show that they are tared
    more = "tared = true\n"
    directory = open_resistor(open_real, log, "divider2_12.5k", runs, period=10, more=more)
    told = json.loads(zerodrift("diagnose", "-C", directory, "--json").out)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert told["parameters"]["time_constants"] == 2
    assert 1800.0 < told["parameters"]["slow_tau_s"] < 7200.0
    assert told["command"].startswith("zerodrift add thermal_lag --hold time_constants=2")
    assert told["evidence"].startswith("thin: 3 runs")


def test_one_run_of_the_load_cell_says_what_it_cannot_show(open_real, zerodrift):
    log = "loadcell_h40a_22kg.csv"
    directory = open_real(
        log,
        name="load_cell",
        temperature="temperature_degC",
        period=256,
        output="weight",
        measured="weight_kg",
        reference='reference = "static_load_nominal_kg"\n',
        unit="kg",
        full_scale=150,
        train=f'["{log}"]',
        more="",
    )
    said = zerodrift("diagnose", "-C", directory)
    assert said.code == 0
    words = " ".join(said.out.split())
    assert "MISSING (thin evidence): thermal_lag" in words
    assert "Evidence: thin: 1 run was cut into 8 pieces" in words
    assert "one run cannot show what differs from run to run" in said.err
    told = json.loads(zerodrift("diagnose", "-C", directory, "--json").out)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    lag = next(c for c in told["candidates"] if c["effect"] == "thermal_lag")
    assert 600.0 < lag["parameters"]["tau_s"] < 2400.0
    # A static load moves nothing that depends on the load.
    silent = {entry["effect"] for entry in told["not_testable"]}
    assert {"creep", "load_hysteresis", "span_tempco", "humidity"} <= silent
