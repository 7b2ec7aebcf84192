"""`compare` on whole projects: good logs, poor logs, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest


def compare(zerodrift, project, *more):
    result = zerodrift("compare", "-C", project.directory, "--json", *more)
    assert result.code == 0, result.err
    return json.loads(result.out)


def rewrite_logs(project, change):
    """Apply `change(columns, names)` to every training log."""
    for path in sorted((project.directory / "logs").glob("run_*.csv")):
        names = path.read_text().splitlines()[0].split(",")
        columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        change(columns)
        np.savetxt(
            path,
            np.stack(list(columns.values()), axis=1),
            delimiter=",",
            fmt="%.5f",
            header=",".join(columns),
            comments="",
        )


def edit_toml(project, old, new):
    text = project.toml.read_text()
    assert old in text
    project.toml.write_text(text.replace(old, new))


def test_missing_lag_is_seen_while_the_temperature_changes(project, zerodrift):
    told = compare(zerodrift, project)
    assert told["model"] == "physics"
    assert told["effects"] == ["zero_tempco"]
    assert told["held_out"] == "leave one run out"
    assert told["noise_floor_source"] == "dwell"
    fz = told["outputs"]["Fz"]
    assert fz["rmse_uncompensated"] > fz["rmse_heldout"] > 3.0 * fz["noise_floor"]
    assert fz["noise_floor"] == pytest.approx(0.05, rel=0.1)
    assert {p["output"] for p in told["patterns"]} == {"Fz", "Mx"}
    assert all("K/min" in p["pattern"] or "branch" in p["pattern"] for p in told["patterns"])


def test_complete_model_fails_nowhere(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    told = compare(zerodrift, project)
    assert told["patterns"] == []
    assert told["worst"] == []
    out = zerodrift("compare", "-C", project.directory).out
    assert "nowhere in particular" in out


def test_tables_hold_every_run_and_output(project, zerodrift):
    out = zerodrift("compare", "-C", project.directory).out
    for words in ("Fz", "Mx", "run_0", "run_4", "held out", "noise floor", "Where it fails"):
        assert words in out


def test_errors_equal_those_of_a_repeated_call(project, zerodrift):
    assert compare(zerodrift, project) == compare(zerodrift, project)


def test_compare_writes_nothing(project, zerodrift):
    before = project.read_all()
    compare(zerodrift, project)
    assert project.read_all() == before


def test_page_stands_alone(project, zerodrift, tmp_path):
    page = tmp_path / "page.html"
    result = zerodrift("compare", "-C", project.directory, "--html", page)
    assert result.code == 0
    text = page.read_text(encoding="utf-8")
    assert 'src="http' not in text
    assert "autocorrelation" in text
    assert "drift as measured" in text


def test_number_of_worst_segments_is_the_users_choice(project, zerodrift):
    assert len(compare(zerodrift, project, "--worst", "2")["worst"]) == 2
    assert compare(zerodrift, project, "--worst", "0")["worst"] == []


def test_without_a_dwell_the_floor_is_estimated_and_told_so(make_project, zerodrift):
    project = make_project(dwell=False)
    told = compare(zerodrift, project)
    assert told["noise_floor_source"] == "estimated"
    assert 0.04 < told["outputs"]["Fz"]["noise_floor"] < 0.07
    out = zerodrift("compare", "-C", project.directory).out
    assert "estimated" in out
    assert "[logs]" in out


def test_one_run_is_held_out_in_blocks_and_told_so(make_project, zerodrift):
    project = make_project(runs=1)
    assert compare(zerodrift, project)["held_out"] == "blocks of one run"
    assert "one run only" in zerodrift("compare", "-C", project.directory).out


def test_one_output_is_enough(project, zerodrift):
    text = project.toml.read_text()
    start, stop = text.index("[outputs.Mx]"), text.index("[logs]")
    project.toml.write_text(text[:start] + text[stop:])
    assert list(compare(zerodrift, project)["outputs"]) == ["Fz"]


def test_logs_without_a_reference_are_compared_with_zero(project, zerodrift):
    edit_toml(project, 'reference = "ref_Fz_N"\n', "")
    rewrite_logs(project, lambda c: c.update(Fz_N=c["Fz_N"] - c["ref_Fz_N"]))
    told = compare(zerodrift, project)
    assert told["outputs"]["Fz"]["rmse_heldout"] < told["outputs"]["Fz"]["rmse_uncompensated"]


def test_constant_load_is_no_load(project, zerodrift):
    rewrite_logs(
        project,
        lambda c: c.update(Fz_N=c["Fz_N"] - c["ref_Fz_N"] + 20.0, ref_Fz_N=20.0 + 0 * c["Fz_N"]),
    )
    told = compare(zerodrift, project)
    assert not any("load" in p["pattern"] for p in told["patterns"])
    result = zerodrift("add", "creep", "-C", project.directory)
    assert result.code == 2
    assert "reference that varies" in result.err


def test_channel_of_zeros_is_noted_and_compared(project, zerodrift):
    rewrite_logs(project, lambda c: c.update(Mx_Nm=0.0 * c["Mx_Nm"]))
    told = compare(zerodrift, project)
    assert told["outputs"]["Mx"]["rmse"] == pytest.approx(0.0, abs=1e-9)
    result = zerodrift("compare", "-C", project.directory)
    assert "connected" in result.err
    assert zerodrift("add", "thermal_lag", "-C", project.directory).code == 0


def test_floor_of_a_channel_dead_in_the_dwell_is_estimated_and_said_to_be(project, zerodrift):
    path = project.directory / "logs" / "dwell.csv"
    header, *rows = path.read_text().splitlines()
    dead = [",".join([*row.split(",")[:3], "0.0", row.split(",")[4]]) for row in rows]
    path.write_text("\n".join([header, *dead]) + "\n")
    # The lag is no noise, although the model does not know of it.
    told = compare(zerodrift, project)["outputs"]["Mx"]["noise_floor"]
    assert told == pytest.approx(0.004, rel=0.05)
    said = " ".join(zerodrift("compare", "-C", project.directory).out.split())
    assert "Mx never moves in them, so it is estimated there" in said


def test_run_of_ten_rows_is_compared(project, zerodrift):
    path = project.directory / "logs" / "run_4.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:11]) + "\n")
    told = compare(zerodrift, project)
    assert set(told["runs"]) == {f"run_{i}" for i in range(5)}
    low, high = told["runs"]["run_0"]["temperature_degC"]
    assert -60.0 < low < high < 120.0


def test_run_of_three_rows_is_refused_with_its_name(project, zerodrift):
    path = project.directory / "logs" / "run_4.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:4]) + "\n")
    before = project.read_all()
    result = zerodrift("compare", "-C", project.directory, "--json")
    assert result.code == 2
    assert "run_4.csv" in result.err
    assert result.out == ""
    assert project.read_all() == before


@pytest.mark.parametrize(
    ("kind", "words"), [("network", "zerodrift train"), ("integer", "zerodrift train")]
)
def test_model_that_was_not_built_is_refused_with_the_way_to_it(kind, words, project, zerodrift):
    result = zerodrift("compare", "-C", project.directory, "--model", kind)
    assert result.code == 2
    assert words in result.err


def test_unknown_model_is_refused(project, zerodrift):
    result = zerodrift("compare", "-C", project.directory, "--model", "pysics")
    assert result.code == 2


def test_missing_project_is_refused(tmp_path: Path, zerodrift):
    result = zerodrift("compare", "-C", tmp_path)
    assert result.code == 2
    assert "zerodrift init" in result.err


@pytest.mark.parametrize("command", ["compare", "add", "remove", "history"])
def test_help_says_what_the_command_does(command, zerodrift):
    result = zerodrift(command, "--help")
    assert result.code == 0
    assert "zerodrift.toml" in result.out or "model" in result.out


def test_integer_and_c_models_are_compared_like_any_other(make_project, zerodrift):
    project = make_project(runs=3)
    edit_toml(
        project,
        '\nkind = "zero_tempco"',
        '\nkind = "thermal_lag"\n\n[[effect]]\nkind = "zero_tempco"',
    )
    assert zerodrift("export", "-C", project.directory).code == 0
    physics = compare(zerodrift, project, "--model", "physics")["outputs"]["Fz"]
    integer = compare(zerodrift, project, "--model", "integer")
    in_c = compare(zerodrift, project, "--model", "c")
    assert integer["outputs"] == in_c["outputs"]
    assert integer["held_out"] == "none"
    assert integer["outputs"]["Fz"]["rmse"] == pytest.approx(physics["rmse"], rel=0.01)
    assert integer["outputs"]["Fz"]["rmse"] != physics["rmse"]


def test_model_of_other_effects_is_refused(make_project, zerodrift):
    project = make_project(runs=3)
    assert zerodrift("export", "-C", project.directory).code == 0
    zerodrift("add", "thermal_lag", "-C", project.directory)
    result = zerodrift("compare", "-C", project.directory, "--model", "integer")
    assert result.code == 2
    assert "zerodrift train" in result.err
    assert compare(zerodrift, project)["model"] == "physics"


def test_offsets_that_are_taken_off_are_told_beside_the_error(project, zerodrift):
    toml = project.toml.read_text()
    project.toml.write_text(toml.replace("[logs]\n", "[logs]\ntared = true\n"))
    told = compare(zerodrift, project)["outputs"]["Fz"]
    said = " ".join(zerodrift("compare", "-C", project.directory).out.split())
    error = told["rmse_left_out"]
    assert told["run_offset"] > 0.0
    assert f"Fz {told['run_offset']:.4g} beside {error:.4g} N" in said
