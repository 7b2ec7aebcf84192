"""`zerodrift plan` before any log: what it prints, writes and refuses."""

import csv
import json

import pytest

import zerodrift as zd
from tests.plan.projects import write_blank

QUICK = ("--hours", "2", "--budget", "2", "--target", "0.1%")
PAIR = ("--between", "creep", "load_hysteresis")


@pytest.mark.long
def test_a_plan_before_any_log(tmp_path, zerodrift):
    write_blank(tmp_path)
    file = tmp_path / "plan.csv"
    picture = tmp_path / "plan.html"
    options = ("--out", file, "--picture", picture, "--json")
    told = zerodrift("plan", "-C", tmp_path, *QUICK, *PAIR, *options)
    assert told.code == 0, told.err
    plan = json.loads(told.out)
    assert plan["hours"] <= 2.0
    assert plan["file"] == str(file)
    assert {"from_s", "temperature_degC", "rate_K_per_min", "loads", "inputs"} <= set(
        plan["programme"][0]
    )
    (pair,) = plan["separates"]
    assert pair["effects"] == ["creep", "load_hysteresis"] and 0.0 < pair["probability"] < 1.0
    rows = list(csv.DictReader(file.open(encoding="utf-8")))
    assert len(rows) == len(plan["programme"])
    assert rows[0]["Fz_N"] == "0" and float(rows[-1]["from_s"]) < 7200.0
    assert len(plan["files"]) == 1 + len(plan["logs"])
    assert (tmp_path / "plan_1.txt").read_text(encoding="utf-8").startswith("title Planned log 1")
    assert "chamber, degC" in picture.read_text(encoding="utf-8")


@pytest.mark.long
def test_a_plan_in_words(tmp_path, zerodrift):
    told = zerodrift("plan", "-C", write_blank(tmp_path), *QUICK, *PAIR)
    assert "PLAN: " in told.out and "named alone" in told.out
    assert "noise of 0.01 % of full scale, assumed" in told.err


@pytest.mark.long
def test_limits_beside_those_of_the_file(tmp_path, zerodrift):
    write_blank(tmp_path)
    within = "temperature_degC = [20, 30]; heating_K_per_min = 1"
    told = zerodrift("plan", "-C", tmp_path, *QUICK, *PAIR, "--within", within, "--json")
    plan = json.loads(told.out)
    assert all(20.0 <= s["temperature_degC"] <= 30.0 for s in plan["programme"])
    assert max(s["rate_K_per_min"] for s in plan["programme"]) <= 2.0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--within", "temperature_degC = 5"), "[LOW, HIGH]"),
        (("--within", "temperature = [1, 2]"), "temperature_degC"),
        (("--within", "nowhere.toml"), "there is no such file"),
        (("--target", "lots"), "a share of full scale"),
        (("--out", "plan.txt"), "ends in .csv"),
        (("--picture", "plan.png"), "ends in .html"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, zerodrift, options, told):
    found = zerodrift("plan", "-C", write_blank(tmp_path), *QUICK, *PAIR, *options)
    assert found.code == 2
    assert told in found.err


@pytest.mark.parametrize(
    ("pair", "told"),
    [
        (("ageing", "creep"), "--between ageing: ageing shows over days"),
        (("creep", "creep"), "--between creep creep: the same effect twice"),
        (("dark_current", "creep"), "--between dark_current: the model has dark_current already"),
        (("crep", "load_hysteresis"), "did you mean 'creep'?"),
    ],
)
def test_pairs_that_nothing_can_tell_apart_are_refused(tmp_path, zerodrift, pair, told):
    found = zerodrift("plan", "-C", write_blank(tmp_path), *QUICK, "--between", *pair)
    assert found.code == 2 and not found.out
    assert told in found.err


@pytest.mark.long
def test_the_python_face_plans_too(tmp_path):
    project = zd.Project(write_blank(tmp_path))
    plan = project.plan(2.0, between=("creep", "load_hysteresis"), target=0.001, budget_s=2.0)
    assert plan.separates[0].effects == ("creep", "load_hysteresis")
    assert plan.plot().panels[0].title == "chamber, degC"
