"""`add` and `remove`: what earns its place is written, all else leaves every file as it was."""

import errno
import json
import os
import tomllib
from pathlib import Path

import pytest


def test_add_of_the_missing_effect_reaches_the_floor_and_says_so_in_json(project, zerodrift):
    result = zerodrift("add", "thermal_lag", "-C", project.directory, "--json")
    assert result.code == 0
    told = json.loads(result.out)
    assert told["effect"] == "thermal_lag"
    assert told["added"] is True
    tau = told["parameters"]["tau_s"]
    assert tau["unit"] == "s"
    assert tau["value"] == pytest.approx(60.0, rel=0.05)
    assert abs(tau["value"] - 60.0) < 5.0 * tau["std_error"]
    for output in ("Fz", "Mx"):
        before = told["before"]["rmse_heldout"][output]
        after = told["after"]["rmse_heldout"][output]
        assert before > 2.0 * after
        assert after < 1.1 * told["noise_floor"][output]


def test_add_is_a_diff_of_one_table_and_keeps_all_comments(project, zerodrift):
    before = project.toml.read_text()
    zerodrift("add", "thermal_lag", "-C", project.directory)
    after = project.toml.read_text()
    table = '[[effect]]\nkind = "thermal_lag"\n'
    assert after.count(table) == 1
    assert after.replace("\n" + table, "", 1) == before


def test_remove_after_add_gives_the_same_bytes_back(project, zerodrift):
    before = project.toml.read_bytes()
    zerodrift("add", "thermal_lag", "-C", project.directory)
    result = zerodrift("remove", "thermal_lag", "-C", project.directory, "--json")
    assert result.code == 0
    assert json.loads(result.out)["helps"] is False
    assert project.toml.read_bytes() == before


def test_add_prints_errors_floor_and_parameters_with_units(project, zerodrift):
    out = zerodrift("add", "thermal_lag", "-C", project.directory).out
    for words in ("before", "after", "noise floor", "tau_s", "std error", "falls in 5 of 5 runs"):
        assert words in out


def test_add_that_does_not_help_leaves_every_file_as_it_was(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    before = project.read_all()
    result = zerodrift("add", "thermal_hysteresis", "-C", project.directory)
    assert result.code == 1
    assert "does not fall" in result.out or "falls too little" in result.out
    assert "as it was" in " ".join(result.out.split())
    assert project.read_all() == before


def test_add_by_force_keeps_what_does_not_help(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    result = zerodrift("add", "thermal_hysteresis", "--force", "-C", project.directory, "--json")
    assert result.code == 0
    told = json.loads(result.out)
    assert told["helps"] is False
    assert told["added"] is True
    kinds = [e["kind"] for e in tomllib.loads(project.toml.read_text())["effect"]]
    assert kinds == ["zero_tempco", "thermal_lag", "thermal_hysteresis"]


def test_add_holds_a_parameter_that_is_given(project, zerodrift):
    result = zerodrift(
        "add", "thermal_lag", "--hold", "tau_s=50", "-C", project.directory, "--json"
    )
    tau = json.loads(result.out)["parameters"]["tau_s"]
    assert (tau["value"], tau["held"], tau["std_error"]) == (50.0, True, None)
    assert tomllib.loads(project.toml.read_text())["effect"][1] == {
        "kind": "thermal_lag",
        "tau_s": 50,
    }


def test_add_of_a_present_effect_with_another_value_changes_its_table(project, zerodrift):
    zerodrift("add", "thermal_lag", "--hold", "tau_s=20", "-C", project.directory)
    result = zerodrift("add", "thermal_lag", "--hold", "tau_s=60", "-C", project.directory)
    assert result.code == 0
    assert tomllib.loads(project.toml.read_text())["effect"][1]["tau_s"] == 60
    assert json.loads(project.history.read_text())["entries"][-1]["action"] == "change"


def test_history_grows_by_one_entry_per_change_and_never_otherwise(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    first = json.loads(project.history.read_text())["entries"]
    zerodrift("remove", "thermal_lag", "-C", project.directory)
    second = json.loads(project.history.read_text())["entries"]
    assert len(first) == 1
    assert second[:1] == first
    assert [entry["action"] for entry in second] == ["add", "remove"]
    assert second[1]["before"] == first[0]["after"]


def test_same_steps_give_the_same_history(tmp_path, make_project, zerodrift):
    project = make_project()
    zerodrift("add", "thermal_lag", "-C", project.directory)
    first = project.history.read_bytes()
    zerodrift("remove", "thermal_lag", "-C", project.directory)
    project.history.unlink()
    zerodrift("add", "thermal_lag", "-C", project.directory)
    assert project.history.read_bytes() == first


REFUSED = {
    "twice": (["add", "zero_tempco"], "in the model already"),
    "unknown": (["add", "thermal_leg"], "did you mean 'thermal_lag'"),
    "missing channel": (["add", "humidity"], "no input 'humidity'"),
    "missing thermometer": (
        ["add", "thermal_lag", "--set", "signal=body_temperature"],
        "no input 'body_temperature'",
    ),
    "unknown parameter": (["add", "thermal_lag", "--hold", "tua_s=60"], "did you mean 'tau_s'"),
    "value out of bounds": (["add", "thermal_lag", "--hold", "tau_s=-5"], "expected"),
    "no number": (["add", "thermal_lag", "--hold", "tau_s=slow"], "'slow' is no number"),
    "no value": (["add", "thermal_lag", "--hold", "tau_s"], "expected NAME=VALUE"),
    "set twice": (["add", "thermal_lag", "--hold", "tau_s=5", "--hold", "tau_s=6"], "set twice"),
    "unknown option": (["add", "thermal_lag", "--set", "sginal=x"], "did you mean 'signal'"),
    "remove what is not there": (["remove", "thermal_lag"], "not in the model"),
    "remove a misspelt one": (["remove", "zero_tempc"], "did you mean 'zero_tempco'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_request_is_refused_and_changes_nothing(case, project, zerodrift):
    arguments, words = REFUSED[case]
    before = project.read_all()
    result = zerodrift(*arguments, "-C", project.directory, "--json")
    assert result.code == 2
    assert words in result.err
    assert result.out == ""
    assert project.read_all() == before


def test_read_only_file_is_refused_before_anything_is_fitted(project, zerodrift, monkeypatch):
    project.toml.chmod(0o444)
    before = project.read_all()
    monkeypatch.setattr("zerodrift.diagnosis.revision.revise", lambda *_: pytest.fail("fitted"))
    result = zerodrift("add", "thermal_lag", "-C", project.directory)
    assert result.code == 2
    assert "read-only" in result.err
    assert project.read_all() == before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is not JSON"),
        ("[]", "is of format"),
        ('{"format": 1}', "no list of entries"),
        ('{"format": 1, "entries": [{"action": "add"}]}', "entry 1"),
    ],
)
def test_damaged_history_is_refused_and_left_alone(content, words, project, zerodrift):
    project.history.parent.mkdir()
    project.history.write_text(content)
    before = project.read_all()
    for command in (["add", "thermal_lag"], ["remove", "zero_tempco"], ["history"]):
        result = zerodrift(*command, "-C", project.directory)
        assert result.code == 2
        assert words in result.err
        assert "history.json" in result.err
    assert project.read_all() == before


def test_failure_between_the_two_files_restores_the_first(project, zerodrift, monkeypatch):
    def fail_on_toml(source, target):
        if Path(target).name == "zerodrift.toml" and str(source).endswith(".zd-new"):
            raise OSError(errno.ENOSPC, "the disk is full")
        replace(source, target)

    replace = os.replace
    before = project.read_all()
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail_on_toml)
        result = zerodrift("add", "thermal_lag", "-C", project.directory)
    assert result.code == 2
    assert project.read_all() == before
    assert zerodrift("add", "thermal_lag", "-C", project.directory).code == 0
    before = project.read_all()
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail_on_toml)
        result = zerodrift("remove", "thermal_lag", "-C", project.directory)
    assert result.code == 2
    assert "the disk is full" in result.err and "Every file is as it was" in result.err
    assert project.read_all() == before


PLUGIN = """
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature


def build(ops, signals, p):
    {body}


register(Effect(kind="odd_{kind}", title="odd", build=build, needs=("temperature",)))
"""


def declare(project, kind, body):
    """Write a user's file of one effect, and name it in zerodrift.toml."""
    (project.directory / "mine.py").write_text(PLUGIN.format(kind=kind, body=body))
    with project.toml.open("a") as file:
        file.write('\n[plugins]\nfiles = ["mine.py"]\n')


BODIES = {
    "raises": ("raise ZeroDivisionError('oops')", "raised ZeroDivisionError: oops"),
    "nan": (
        "return [Feature('n', ops.affine(signals.temperature_degC, float('nan'), 0.0), '1')]",
        "NaN",
    ),
}


@pytest.mark.parametrize("case", BODIES)
def test_user_effect_that_fails_is_named_with_its_file(case, project, zerodrift):
    body, words = BODIES[case]
    declare(project, case, body)
    before = project.read_all()
    result = zerodrift("add", f"odd_{case}", "-C", project.directory)
    assert result.code == 2
    assert "mine.py" in result.err
    assert f"'odd_{case}'" in result.err
    assert words in result.err
    after = {k: v for k, v in project.read_all().items() if "__pycache__" not in k}
    assert after == before


def test_user_effect_that_helps_is_added_like_a_built_in(project, zerodrift):
    body = "return [Feature('late', ops.lowpass(signals.temperature_degC, 60.0), 'K')]"
    declare(project, "good", body)
    result = zerodrift("add", "odd_good", "-C", project.directory, "--json")
    assert result.code == 0
    told = json.loads(result.out)
    assert {row["output"] for row in told["coefficients"]} == {"Fz", "Mx"}
    assert {row["unit"] for row in told["coefficients"]} == {"N/K", "Nm/K"}


OWN = """
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature, Parameter


def build(ops, signals, p):
    return [Feature("k", ops.lowpass(signals.temperature_degC, p["tau_s"]), "K")]


tau = Parameter("tau_s", "s", 1.0, 3000.0, (10.0, 300.0))
needs = ("temperature",)
register(Effect(kind="mine", title="my own", build=build, parameters=(tau,), needs=needs))
"""
MORE = """
register(Effect(kind="other", title="other", build=build, parameters=(tau,), needs=needs))
"""


def test_a_file_of_one_effect_is_added_as_an_effect_is(project, zerodrift, monkeypatch):
    file = project.directory / "own.py"
    file.write_text(OWN)
    before = project.toml.read_text()
    monkeypatch.chdir(project.directory.parent)
    seen_from_here = f"{project.directory.name}/own.py"
    told = json.loads(zerodrift("add", seen_from_here, "-C", project.directory, "--json").out)
    assert told["added"] and told["effect"] == "mine"
    after = project.toml.read_text()
    assert after == before.replace("\n[network]", '\n[[effect]]\nkind = "mine"\n\n[network]', 1) + (
        '\n[plugins]\nfiles = ["own.py"]\n'
    )
    assert zerodrift("compare", "-C", project.directory).code == 0
    # Named there already, it is not named twice.
    project.toml.write_text(after.replace('\n[[effect]]\nkind = "mine"\n', ""))
    assert zerodrift("add", "own.py", "-C", project.directory).code == 0
    assert project.toml.read_text() == after


def test_a_file_that_does_not_help_is_not_named(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    (project.directory / "own.py").write_text(OWN)
    before = project.read_all()
    assert zerodrift("add", "own.py", "-C", project.directory).code == 1
    assert project.read_all() == before


def test_a_file_that_is_not_there_or_has_several_effects_is_refused(project, zerodrift):
    before = project.read_all()
    lacking = zerodrift("add", "own.py", "-C", project.directory)
    assert lacking.code == 2 and "own.py: there is no such file of effects" in lacking.err
    assert project.read_all() == before
    (project.directory / "own.py").write_text(OWN + MORE)
    several = zerodrift("add", "own.py", "-C", project.directory)
    assert several.code == 2 and "declares 2 effects, mine, other; expected one" in several.err
