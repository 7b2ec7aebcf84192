"""One left-out error per model: `add` tells of the model before and after what `compare` tells."""

import json

import pytest


def test_add_tells_what_compare_tells_where_offsets_are_read_anew(make_project, zerodrift):
    """The model without the lag takes the runs' offsets for a tare; the one with it does not."""
    project = make_project(runs=7, dwell=False, tau_s=108.0)

    def read(*arguments):
        result = zerodrift(*arguments, "-C", project.directory, "--json")
        assert result.code == 0, result.out
        return json.loads(result.out)

    before, added, after = read("compare"), read("add", "thermal_lag"), read("compare")
    assert (before["tared"], after["tared"]) == (True, False)
    judged = added["judged_before"]["rmse_left_out"], added["judged_after"]["rmse_left_out"]
    for name, output in before["outputs"].items():
        assert added["before"]["rmse_left_out"][name] == output["rmse_left_out"]
        assert added["after"]["rmse_left_out"][name] == after["outputs"][name]["rmse_left_out"]
        assert judged[0][name] > output["rmse_left_out"] > judged[1][name]
    assert read("history")["steps"][0]["rmse_left_out"] == judged[0]
    text = " ".join(zerodrift("remove", "thermal_lag", "-C", project.directory).out.split())
    assert "takes the runs' offsets for a tare" in text
    assert "they count as drift in both" in text


def test_logs_of_a_test_decide_nothing_and_what_they_lose_is_told(make_project, zerodrift):
    """The same logs, with another run as a test log or without it: one judgement."""

    def read(*arguments):
        result = zerodrift(*arguments, "-C", project.directory, "--json")
        assert result.code in (0, 1), result.out
        return json.loads(result.out)

    project = make_project(runs=6)
    text = project.toml.read_text()
    alone = text.replace('"logs/run_*.csv"', '"logs/run_[0-4].csv"')
    assert alone != text
    project.toml.write_text(alone)
    without = read("add", "thermal_lag")
    assert without["before"]["rmse_test"] is without["after"]["rmse_test"] is None
    for cause, factor in (("as it is", 1.0), ("reversed", -1.0)):
        log = project.directory / "logs" / "run_5.csv"
        head, *rows = log.read_text().splitlines()
        table = [[float(cell) for cell in row.split(",")] for row in rows]
        changed = [[*row[:2], row[4] + factor * (row[2] - row[4]), *row[3:]] for row in table]
        lines = [",".join(f"{cell:.5f}" for cell in row) for row in changed]
        log.write_text("\n".join([head, *lines, ""]))
        project.toml.write_text(alone.replace("[logs]\n", '[logs]\ntest = ["logs/run_5.csv"]\n'))
        (project.directory / "build" / "history.json").unlink()
        tested = read("add", "thermal_lag")
        for key in ("helps", "reason", "parameters", "held_out"):
            assert tested[key] == without[key], cause
        for side in ("before", "after"):
            assert tested[side]["rmse_left_out"] == without[side]["rmse_left_out"], cause
        fell = tested["after"]["rmse_test"]["Fz"] < tested["before"]["rmse_test"]["Fz"]
        assert fell is (factor > 0.0)
        text = " ".join(zerodrift("remove", "thermal_lag", "-C", project.directory).out.split())
        assert "On the test logs, which decide nothing here" in text


@pytest.mark.long
def test_propose_tells_what_compare_tells_without_a_formula_too(make_project, zerodrift):
    project = make_project(runs=5)
    read = {
        name: json.loads(zerodrift(name, "-C", project.directory, "--json").out)
        for name in ("compare", "propose", "diagnose")
    }
    assert not read["propose"]["found"]
    for name, output in read["compare"]["outputs"].items():
        assert read["propose"]["rmse_left_out"][name]["before"] == output["rmse_left_out"]
    assert read["propose"]["floor_ratio_before"] == read["diagnose"]["floor_ratio_before"]
