"""Which sensors a fleet has: by folder, by the selectors of [logs], and what is refused."""

from pathlib import Path

import pytest

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.fleet.sensors import configure_sensor, find_sensors, match_names

BASE = """
[sensor]
name = "s"
time = "t"
temperature = "T"
sample_period_s = 1
[outputs.Fz]
measured = "F"
unit = "N"
full_scale = 10
"""


def make_project(directory: Path, tail: str, *logs: str) -> Path:
    for name in logs:
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("t,T,F\n0,1,2\n")
    (directory / "zerodrift.toml").write_text(BASE + tail)
    return directory


def refusal(directory: Path) -> str:
    with pytest.raises(InputError) as caught:
        find_sensors(load_config(directory))
    return str(caught.value)


def paths_of(directory: Path, sensor: str, use: str = "train") -> list[str]:
    config = configure_sensor(load_config(directory), sensor)
    return [str(s.path.relative_to(directory)) for s in expand_selectors(config, use)]


def test_sensors_are_the_folders_in_the_placeholders_place(tmp_path):
    tail = '[logs]\ntrain = ["a_*.csv"]\n[fleet]\nfolder = "fleet/{sensor}"\n'
    project = make_project(
        tmp_path, tail, "fleet/SN2/a_1.csv", "fleet/SN1/a_1.csv", "fleet/SN1/a_2.csv"
    )
    (project / "fleet" / "notes.txt").write_text("no folder")
    (project / "fleet" / "SN3").mkdir()  # without logs: an error of its own, not left out
    assert find_sensors(load_config(project)) == ("SN1", "SN2", "SN3")
    assert paths_of(project, "SN1") == ["fleet/SN1/a_1.csv", "fleet/SN1/a_2.csv"]


def test_sensors_are_told_from_the_names_of_logs_that_lie_together(tmp_path):
    tail = '[logs]\ntrain = ["logs/{sensor}_oven*.csv@0%:60%"]\ntest = ["logs/{sensor}_walk.csv"]\n'
    logs = ("logs/A-1_oven1.csv", "logs/A-1_oven2.csv", "logs/B_oven1.csv", "logs/C_walk.csv")
    project = make_project(tmp_path, tail, *logs)
    # C has a test log only: an error of its own later, not left out in silence.
    assert find_sensors(load_config(project)) == ("A-1", "B", "C")
    assert paths_of(project, "A-1") == ["logs/A-1_oven1.csv", "logs/A-1_oven2.csv"]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("x/{sensor}.csv", {"a", "b.c"}),
        ("x/{sensor}.c.csv", {"b"}),
        ("**/{sensor}.csv", {"a", "b.c"}),
        ("x/[!b]{sensor}.csv", set()),
        ("{sensor}/a.csv", {"x"}),
        ("y/{sensor}/{sensor}.csv", {"k"}),
    ],
)
def test_match_names_reads_globs(tmp_path, pattern, expected):
    for name in ("x/a.csv", "x/b.c.csv", "y/k/k.csv", "y/k/other.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = match_names(tmp_path, pattern, folders=False)
    assert found == (expected if pattern[:2] != "**" else {"a", "b.c", "k", "other"})


def test_sensor_whose_name_holds_a_glob_is_meant_literally(tmp_path):
    tail = '[logs]\ntrain = ["a.csv"]\n[fleet]\nfolder = "fleet/{sensor}"\n'
    project = make_project(tmp_path, tail, "fleet/S[1]/a.csv", "fleet/S1/a.csv")
    assert paths_of(project, "S[1]") == ["fleet/S[1]/a.csv"]


def test_design_without_a_placeholder_is_shown_how_to_write_one(tmp_path):
    tail = '[logs]\ntrain = ["logs/*.csv"]\n'
    project = make_project(tmp_path, tail, "sensors/SN1/a.csv", "sensors/SN2/a.csv")
    message = refusal(project)
    assert "zerodrift.toml:12" in message
    assert "sensors/ has 2 folders with logs (SN1, SN2)" in message
    assert 'folder = "sensors/{sensor}"' in message


def test_fleet_without_sensors_is_refused(tmp_path):
    tail = '[logs]\ntrain = ["a.csv"]\n[fleet]\nfolder = "fleet/{sensor}"\n'
    message = refusal(make_project(tmp_path, tail))
    assert "no folder matches 'fleet/{sensor}'" in message


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ('folder = "fleet"', "[fleet] folder is 'fleet'; expected a path with {sensor}"),
        ('folder = "fleet/{name}"', "the only text in braces, not {name}"),
        ('folder = "fleet/{sensor}#run1"', "belong to the selectors"),
        ('folders = "x"', "unknown key [fleet] folders; did you mean 'folder'"),
        ("ratio_limit = 0", "[fleet] ratio_limit is 0; expected a number > 0"),
        ("outlier_z = nan", "finite"),
        ("limits = { Fx = 1 }", "[fleet.limits] Fx is no output; did you mean 'Fz'?"),
        ("limits = { Fz = -1 }", "[fleet.limits] Fz is -1; expected a number > 0"),
    ],
)
def test_fleet_table_refuses_what_it_cannot_mean(tmp_path, table, expected):
    project = make_project(tmp_path, f'[logs]\ntrain = ["a.csv"]\n[fleet]\n{table}\n')
    message = refusal(project)
    assert expected in message
    assert "zerodrift.toml:" in message


def test_sensor_named_like_a_selector_is_refused(tmp_path):
    tail = '[logs]\ntrain = ["a.csv"]\n[fleet]\nfolder = "fleet/{sensor}"\n'
    project = make_project(tmp_path, tail, "fleet/S#1/a.csv")
    with pytest.raises(InputError, match="Rename"):
        configure_sensor(load_config(project), "S#1")
