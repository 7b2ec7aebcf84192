import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from tests.physics.conftest import SLOPE, STEP_S, follow, make_dataset
from tests.projects import render_toml

from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.physics.effect import READING_ORDER

TOML = render_toml(
    """\
[inputs]
supply = "supply_V"

[logs]
train = ["run_*.csv"]
dwell = ["dwell.csv"]

[[effect]]
kind = "zero_tempco"
""",
    "small",
    STEP_S,
)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project on disk whose sensor lags, which its model does not know."""
    directory = tmp_path_factory.mktemp("project")

    def disturb(bench):
        return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE

    dataset = make_dataset(disturb, runs=6, length=400)
    header = "time_s,temperature_degC,Fz_N,Mx_Nm,ref_Fz_N,ref_Mx_Nm,supply_V"
    for run in (*dataset.train, *dataset.dwell):
        table = np.column_stack(
            [run.time_s, run.temperature_degC, run.measured, run.reference, run.inputs["supply"]]
        )
        path = directory / f"{run.name}.csv"
        np.savetxt(path, table, fmt="%.6g", delimiter=",", header=header, comments="")
    (directory / "zerodrift.toml").write_text(TOML, encoding="utf-8")
    return directory


def call(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)


@pytest.mark.long
def test_diagnose_names_the_lag_in_words_and_in_json(project):
    before = (project / "zerodrift.toml").read_bytes()
    said = call("diagnose", "-C", project)
    assert said.exit_code == 0
    assert "MISSING: thermal_lag" in said.output
    assert "zerodrift add thermal_lag" in said.output
    assert re.search(r"thermal_lag .* 7\.\d %\s+\d\d %\s+0\.", said.output)
    told = json.loads(call("diagnose", "-C", project, "--json").stdout)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert told["floor_ratio_after"] < 1.15
    assert (project / "zerodrift.toml").read_bytes() == before


@pytest.mark.long
def test_diagnose_auto_goes_on_until_complete(project):
    told = json.loads(call("diagnose", "-C", project, "--auto", "--json").stdout)
    assert [step["effect"] for step in told["added"]] == ["thermal_lag"]
    assert told["verdict"] == "complete"
    assert told["drop"] == []


def test_effects_lists_the_catalogue():
    said = call("effects")
    for kind in READING_ORDER:
        assert kind in said.output
    told = json.loads(call("effects", "--json").stdout)
    assert [effect["kind"] for effect in told["effects"]] == list(READING_ORDER)


@pytest.mark.parametrize("kind", READING_ORDER)
def test_effects_tells_all_about_one(kind):
    said = call("effects", kind)
    assert said.exit_code == 0
    for heading in ("Looks like:", "To provoke it:", "Cure in hardware:", "Source:"):
        assert heading in said.output
    assert any(0x2800 < ord(character) < 0x2900 for character in said.output)


def test_effects_writes_a_page_of_its_own(tmp_path):
    page = tmp_path / "creep.html"
    assert call("effects", "creep", "--html", page).exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert "creep and creep recovery" in text
    assert "https://" not in text.split("</head>")[0].split("<script")[0]


def test_effects_of_an_unknown_name_suggests_the_nearest():
    with pytest.raises(InputError, match=r"no effect 'crep'.*creep"):
        call("effects", "crep")


def test_effects_shows_a_projects_own(project, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "from zerodrift.physics.catalogue import register\n"
        "from zerodrift.physics.effect import Effect, Feature\n"
        "register(Effect(kind='mine', title='my own', build=lambda ops, signals, p:\n"
        "    [Feature('x', ops.power(signals.temperature_degC, 2))], needs=('temperature',)))\n",
        encoding="utf-8",
    )
    text = (project / "zerodrift.toml").read_text(encoding="utf-8")
    for name in ("run_0.csv", "dwell.csv"):
        (tmp_path / name).write_bytes((project / name).read_bytes())
    (tmp_path / "zerodrift.toml").write_text(
        text + '\n[plugins]\nfiles = ["own.py"]\n', encoding="utf-8"
    )
    said = call("effects", "mine", "-C", tmp_path, "--trust")
    assert "mine: my own" in said.output
    assert str(own) in said.output.replace("\n", "")
    assert "mine" not in call("effects").output
