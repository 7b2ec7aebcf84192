"""The command that `diagnose` prints, run as it stands, adds what is missing."""

import json
import shlex

import numpy as np
import pytest

from zerodrift.base.config import EffectConfig, load_config
from zerodrift.diagnosis.changes import propose_command
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.catalogue import load_catalogue

pytestmark = pytest.mark.long


def rewrite_outputs(project, drift):
    """Rewrite the logs so that the drift of Fz is what `drift(temperature)` gives, plus noise."""
    for number, path in enumerate(sorted((project.directory / "logs").glob("*.csv"))):
        table = np.genfromtxt(path, delimiter=",", names=True)
        rng = np.random.default_rng(7000 + number)
        fz = drift(table["temperature_degC"])
        noise = rng.standard_normal((2, len(table)))
        table["Fz_N"] = table["ref_Fz_N"] + fz + 0.05 * noise[0]
        table["Mx_Nm"] = -0.05 * fz + 0.004 * noise[1]
        columns = np.stack([table[name] for name in table.dtype.names], axis=1)
        header = ",".join(table.dtype.names)
        np.savetxt(path, columns, delimiter=",", fmt="%.5f", header=header, comments="")


def bend(temperature):
    return 0.2 * (temperature - 25.0) - 0.01 * (temperature - 25.0) ** 2


def lag_by_two_ways(temperature):
    felt = 0.6 * lowpass(temperature, 1.0, 20.0) + 0.4 * lowpass(temperature, 1.0, 200.0)
    return 0.4 * (felt - 25.0)


@pytest.mark.parametrize(
    ("drift", "told", "expected"),
    [
        (bend, "", "zerodrift add zero_tempco --hold order=2"),
        (
            lag_by_two_ways,
            '[[effect]]\nkind = "thermal_lag"\n\n',
            "zerodrift add thermal_lag --hold time_constants=2",
        ),
    ],
)
def test_the_richer_form_of_an_effect_is_proposed_and_reaches_the_floor(
    make_project, zerodrift, drift, told, expected
):
    project = make_project(runs=8)
    rewrite_outputs(project, drift)
    text = project.toml.read_text()
    project.toml.write_text(text.replace("[network]", f"{told}[network]"))
    diagnosis = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    command = f"{expected} -C {project.directory}"
    assert diagnosis["command"] == command
    said = zerodrift("diagnose", "-C", project.directory).out
    assert f"To add it: {command}" in " ".join(said.split())
    result = zerodrift(*shlex.split(diagnosis["command"])[1:], "--json")
    assert result.code == 0
    added = json.loads(result.out)
    for output, floor in added["noise_floor"].items():
        assert added["after"]["rmse_heldout"][output] < 1.1 * floor
    after = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert (after["verdict"], after["command"]) == ("complete", "")


def test_add_takes_the_form_that_is_needed_by_itself(make_project, zerodrift):
    project = make_project(runs=8)
    rewrite_outputs(project, bend)
    result = zerodrift("add", "zero_tempco", "-C", project.directory, "--json")
    assert result.code == 0
    assert json.loads(result.out)["parameters"]["order"] == {
        "value": 2.0,
        "std_error": None,
        "unit": "1",
        "held": True,
        "at_bound": False,
    }
    assert "order = 2" in project.toml.read_text()
    before = project.read_all()
    result = zerodrift("add", "zero_tempco", "-C", project.directory)
    assert result.code == 2
    assert "in the model already, and no richer form of it helps" in result.err
    assert project.read_all() == before


def lag_of_its_own(temperature):
    """Follow the thermometer by one coefficient, and what lags it by another."""
    return 0.3 * (temperature - 25.0) + 0.2 * (lowpass(temperature, 1.0, 60.0) - temperature)


def test_add_takes_no_form_with_a_time_constant_at_its_bound_where_another_says_the_same(
    make_project, zerodrift
):
    project = make_project(runs=8)
    rewrite_outputs(project, lag_of_its_own)
    for _ in range(2):  # the lag of all that follows the temperature, then the form that fits
        assert zerodrift("add", "thermal_lag", "-C", project.directory).code in (0, 2)
    told = json.loads(zerodrift("compare", "-C", project.directory, "--json").out)
    fitted = load_config(project.directory).effects[-1]
    assert (fitted.kind, fitted.held.get("own_terms")) == ("thermal_lag", 1.0)
    assert "time_constants" not in fitted.held
    assert told["outputs"]["Fz"]["rmse"] < 0.055  # the noise is 0.05


def lag_against_the_rest(temperature):
    """Follow the thermometer at once, and give a part of it back late: no lag of everything."""
    return 0.3 * (temperature - 25.0) - 0.15 * lowpass(temperature, 1.0, 240.0)


def test_a_part_that_lags_against_the_rest_is_named_and_added_by_its_name_alone(
    make_project, zerodrift
):
    project = make_project(runs=8)
    rewrite_outputs(project, lag_against_the_rest)
    found = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert (found["verdict"], found["effect"]) == ("missing", "thermal_lag")
    assert "--hold own_terms=1" in found["command"]
    assert zerodrift("add", "thermal_lag", "-C", project.directory).code == 0
    assert load_config(project.directory).effects[-1].held == {"own_terms": 1.0}
    after = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert after["verdict"] == "complete"


def test_a_new_effect_is_added_in_the_form_that_was_found():
    creep = load_catalogue()["creep"]
    found = {"time_constants": 2.0, "tau_s": 90.0, "slow_tau_s": 900.0}
    assert (
        propose_command([], creep, found).write() == "zerodrift add creep --hold time_constants=2"
    )
    assert propose_command([], creep, {"tau_s": 90.0}).write() == "zerodrift add creep"


def test_a_choice_that_is_held_already_is_not_held_again():
    creep = load_catalogue()["creep"]
    present = [EffectConfig("creep", {"time_constants": 2.0})]
    found = {"time_constants": 2.0, "cross_axes": 1.0, "tau_s": 90.0, "slow_tau_s": 900.0}
    assert (
        propose_command(present, creep, found).write() == "zerodrift add creep --hold cross_axes=1"
    )


def test_another_thermometer_that_the_drift_follows_is_found(make_project, zerodrift):
    project = make_project(runs=6)
    for number, path in enumerate(sorted((project.directory / "logs").glob("*.csv"))):
        table = np.genfromtxt(path, delimiter=",", names=True)
        rng = np.random.default_rng(8000 + number)
        at_rest = path.stem == "dwell"
        knots = np.full(6, 25.0) if at_rest else rng.uniform(10.0, 40.0, 6)
        body = np.interp(np.linspace(0.0, 1.0, len(table)), np.linspace(0.0, 1.0, 6), knots)
        table["Fz_N"] += 0.3 * (body - 25.0)
        names = (*table.dtype.names, "body_degC")
        columns = [*(table[name] for name in table.dtype.names), body]
        header = ",".join(names)
        rows = np.stack(columns, axis=1)
        np.savetxt(path, rows, delimiter=",", fmt="%.5f", header=header, comments="")
    text = project.toml.read_text()
    tables = '[inputs]\nbody = "body_degC"\n\n[logs]'
    lag = '[[effect]]\nkind = "thermal_lag"\n\n[network]'
    project.toml.write_text(text.replace("[logs]", tables).replace("[network]", lag))
    told = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert told["verdict"] == "unknown"
    (other,) = told["thermometers"]
    command = "zerodrift add zero_tempco --set signal=body"
    assert (other["signal"], other["command"]) == ("body", f"{command} -C {project.directory}")
    said = " ".join(zerodrift("diagnose", "-C", project.directory).out.split())
    assert "The drift follows another thermometer, body: " in said
    assert zerodrift(*shlex.split(other["command"])[1:]).code == 0
    after = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert (after["verdict"], after["thermometers"]) == ("complete", [])
