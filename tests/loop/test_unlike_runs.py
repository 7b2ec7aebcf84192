"""Runs that are unlike those that the model learnt from are pointed at."""

import json

import numpy as np
import pytest

from zerodrift.base.records import to_dict
from zerodrift.report.report import render_report
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.report import summarise_survey
from zerodrift.tasks.survey import SurveyRequest, survey

pytestmark = pytest.mark.long


def edit_log(path, change):
    table = np.genfromtxt(path, delimiter=",", names=True)
    change(table)
    columns = np.stack([table[name] for name in table.dtype.names], axis=1)
    header = ",".join(table.dtype.names)
    np.savetxt(path, columns, delimiter=",", fmt="%.5f", header=header, comments="")


def add_lag(project):
    text = project.toml.read_text()
    project.toml.write_text(
        text.replace("[network]", '[[effect]]\nkind = "thermal_lag"\n\n[network]')
    )


def jump(table):
    """Let both outputs step by many times the noise for the last third of the run."""
    after = np.arange(len(table)) > 600
    table["Fz_N"][after] += 2.0
    table["Mx_Nm"][after] -= 0.2


def diagnose(zerodrift, project):
    result = zerodrift("diagnose", "-C", project.directory, "--json")
    assert result.code == 0, result.err
    return json.loads(result.out)


def test_one_bad_run_is_named_where_no_effect_explains_it(make_project, zerodrift):
    project = make_project(runs=8)
    add_lag(project)
    edit_log(project.directory / "logs" / "run_3.csv", jump)
    told = diagnose(zerodrift, project)
    assert (told["verdict"], told["effect"]) == ("unknown", None)
    (note,) = [note for note in told["remarks"] if "squared error beyond the noise" in note]
    assert "in run run_3" in note
    found = survey(SurveyRequest(ProjectFolder(project.directory)))
    reported = to_dict(summarise_survey(found, (), None))["diagnose"]
    for one in (told, reported):
        one.pop("schema", None)
        one.pop("advice", None)  # the report has it from `compare`
    assert reported == told
    assert note in render_report(found)


def test_no_run_is_blamed_for_what_all_of_them_have(make_project, zerodrift):
    project = make_project(runs=8)
    add_lag(project)
    for path in (project.directory / "logs").glob("run_*.csv"):
        edit_log(path, jump)
    told = diagnose(zerodrift, project)
    assert not any("squared error beyond the noise" in note for note in told["remarks"])


def test_test_logs_that_hold_more_than_the_train_logs_are_told(make_project, zerodrift):
    project = make_project(runs=6)
    add_lag(project)
    test = project.directory / "logs" / "test.csv"
    (project.directory / "logs" / "run_5.csv").rename(test)
    text = project.toml.read_text()
    project.toml.write_text(text.replace("[logs]\n", '[logs]\ntest = ["logs/test.csv"]\n'))
    told = diagnose(zerodrift, project)
    assert told["verdict"] == "complete"
    assert not any("test logs" in note for note in told["remarks"])
    edit_log(test, jump)
    told = diagnose(zerodrift, project)
    assert told["verdict"] == "complete"
    (note,) = [note for note in told["remarks"] if "test logs" in note]
    assert "most of test" in note
