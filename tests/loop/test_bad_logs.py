"""Logs with something missing or dead: a clear message, or an honest verdict; nothing written."""

import json
import warnings

import numpy as np
import pytest

COMMANDS = (("compare",), ("diagnose",), ("add", "thermal_lag"))


def edit_logs(project, change, pattern="*.csv"):
    """Rewrite logs: `change` gets and gives a table of named columns."""
    for path in sorted((project.directory / "logs").glob(pattern)):
        table = change(np.genfromtxt(path, delimiter=",", names=True))
        np.savetxt(
            path,
            np.stack([table[name] for name in table.dtype.names], axis=1),
            delimiter=",",
            fmt="%.5f",
            header=",".join(table.dtype.names),
            comments="",
        )


def set_to(**values):
    """Return a change that sets whole columns."""

    def change(table):
        for name, value in values.items():
            table[name] = value
        return table

    return change


def edit_toml(project, old, new):
    text = project.toml.read_text()
    assert old in text
    project.toml.write_text(text.replace(old, new))


def diagnose(zerodrift, project, *options):
    result = zerodrift("diagnose", "-C", project.directory, "--json", *options)
    assert result.code == 0, result.err
    return json.loads(result.out)


@pytest.fixture(autouse=True)
def no_warnings():
    """Let no warning of the numerics pass."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def assert_refused(zerodrift, project, *patterns, commands=COMMANDS):
    """Every command says why, ends with 2, and leaves every file as it was."""
    before = project.read_all()
    for command in commands:
        result = zerodrift(*command, "-C", project.directory)
        assert result.code == 2, command
        assert result.out == ""
        for pattern in patterns:
            assert pattern in result.err
        assert project.read_all() == before


def test_without_a_dwell_the_floor_is_estimated_and_said_to_be(make_project, zerodrift):
    told = diagnose(zerodrift, make_project(dwell=False))
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert told["floor"] == "estimated"
    assert any("no dwell" in note for note in told["remarks"])


def test_one_run_is_called_thin(make_project, zerodrift):
    told = diagnose(zerodrift, make_project(runs=1))
    assert told["evidence"].startswith("thin: 1 run was cut into")


def test_one_output_will_do(project, zerodrift):
    text = project.toml.read_text()
    head, rest = text.split("[outputs.Mx]")
    project.toml.write_text(head + "[logs]" + rest.split("[logs]")[1])
    told = diagnose(zerodrift, project)
    assert told["effect"] == "thermal_lag"
    assert list(told["outputs"]) == ["Fz"]


def test_without_references_load_effects_are_not_testable(project, zerodrift):
    edit_toml(project, 'reference = "ref_Fz_N"\n', "")
    edit_logs(project, lambda table: set_to(Fz_N=table["Fz_N"] - table["ref_Fz_N"])(table))
    told = diagnose(zerodrift, project)
    assert told["effect"] == "thermal_lag"
    why = {entry["effect"]: entry["why"] for entry in told["not_testable"]}
    for effect in ("span_tempco", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"):
        assert "no output has a reference that varies" in why[effect]


@pytest.mark.long
def test_loads_that_nobody_wrote_down_have_no_name(project, zerodrift):
    edit_toml(project, 'reference = "ref_Fz_N"\n', "")
    told = diagnose(zerodrift, project)
    assert (told["verdict"], told["effect"]) == ("unknown", None)


def test_a_load_that_never_changes_is_no_load(project, zerodrift):
    edit_logs(project, lambda t: set_to(Fz_N=t["Fz_N"] - t["ref_Fz_N"] + 50.0, ref_Fz_N=50.0)(t))
    told = diagnose(zerodrift, project)
    assert told["effect"] == "thermal_lag"
    assert "creep" in {entry["effect"] for entry in told["not_testable"]}
    result = zerodrift("add", "creep", "-C", project.directory)
    assert result.code == 2
    assert "no output has a reference that varies" in result.err


def test_constant_temperature_is_refused(project, zerodrift):
    edit_logs(project, set_to(temperature_degC=25.0))
    assert_refused(zerodrift, project, "zerodrift.toml:", "25 degC in every row", "Record a log")


def test_a_dead_channel_is_left_out_and_the_others_diagnosed(project, zerodrift):
    edit_logs(project, set_to(Mx_Nm=0.0))
    told = diagnose(zerodrift, project)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert list(told["outputs"]) == ["Fz"]
    assert any("output Mx never moves" in note for note in told["remarks"])
    added = json.loads(zerodrift("add", "thermal_lag", "-C", project.directory, "--json").out)
    tau = added["parameters"]["tau_s"]
    assert 0.0 < tau["std_error"] < 1.0
    assert abs(tau["value"] - 60.0) < 5.0 * tau["std_error"]
    assert added["after"]["rmse_heldout"]["Mx"] == 0.0


def test_a_dead_channel_under_load_is_no_cross_talk(project, zerodrift):
    edit_logs(project, set_to(Fz_N=0.0))
    told = diagnose(zerodrift, project)
    assert told["effect"] == "thermal_lag"
    assert list(told["outputs"]) == ["Mx"]


def test_a_channel_dead_in_the_dwell_alone_has_an_estimated_floor(project, zerodrift):
    edit_logs(project, set_to(Mx_Nm=0.0), "dwell.csv")
    told = diagnose(zerodrift, project)
    assert told["effect"] == "thermal_lag"
    assert told["floor"] == "estimated"
    assert any("Mx never moves in the dwell" in note for note in told["remarks"])
    # Beside a whole model what is left is noise, so the estimate can be held against the truth.
    edit_toml(project, "[network]", '[[effect]]\nkind = "thermal_lag"\n\n[network]')
    result = zerodrift("compare", "-C", project.directory, "--json")
    floors = {k: v["noise_floor"] for k, v in json.loads(result.out)["outputs"].items()}
    assert floors["Mx"] == pytest.approx(0.004, rel=0.1)
    assert floors["Fz"] == pytest.approx(0.05, rel=0.1)


def test_no_output_that_moves_is_refused(project, zerodrift):
    edit_logs(project, set_to(Mx_Nm=0.0, Fz_N=0.0, ref_Fz_N=0.0))
    assert_refused(zerodrift, project, "no output moves", "Fz, Mx", commands=(("diagnose",),))
    assert zerodrift("compare", "-C", project.directory).code == 0
    assert zerodrift("add", "thermal_lag", "-C", project.directory).code == 1


def test_one_run_of_ten_rows_among_others_does_no_harm(project, zerodrift):
    edit_logs(project, lambda table: table[:10], "run_0.csv")
    told = diagnose(zerodrift, project)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert told["parameters"]["tau_s"] == pytest.approx(60.0, rel=0.05)


def test_nothing_but_ten_rows_names_nothing(make_project, zerodrift):
    project = make_project(runs=1, dwell=False)
    edit_logs(project, lambda table: table[:10])
    told = diagnose(zerodrift, project)
    assert told["effect"] is None
    assert told["evidence"].startswith("thin")


def test_a_run_of_nine_rows_is_refused(project, zerodrift):
    edit_logs(project, lambda table: table[:9], "run_0.csv")
    assert_refused(zerodrift, project, "run_0.csv", "at least 10 steps")


def test_an_effect_that_stands_there_twice_is_refused(project, zerodrift):
    edit_toml(project, "[network]", '[[effect]]\nkind = "zero_tempco"\n\n[network]')
    assert_refused(zerodrift, project, "zerodrift.toml:", "'zero_tempco' stands here twice")


def test_an_effect_that_is_there_is_not_added_again(project, zerodrift):
    before = project.read_all()
    result = zerodrift("add", "zero_tempco", "-C", project.directory)
    assert result.code == 2
    assert "in the model already" in result.err
    assert project.read_all() == before
