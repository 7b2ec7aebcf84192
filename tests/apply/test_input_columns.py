"""A log's own columns come out of `apply` as they went in, whatever is converted."""

import csv
import json
import math
import random
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.conftest import Result
from tests.surroundings.conftest import Command

from zerodrift.cli.main import cli

HEAD = ["date", "time", "temp", "HX711 [counts]", "place", "=remark"]
SCALE = """\
[sensor]
name = "cell"
time = { column = ["date", "time"] }
temperature = "temp"
sample_period_s = 1.0

[outputs.weight]
measured = { column = "HX711 [counts]", scale = 0.002, offset = -16, unit = "g" }
unit = "g"
full_scale = 100

[logs]
train = ["logs/[ab].csv"]
test = ["logs/c.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "none"
"""


def write_rows(log: str) -> list[list[str]]:
    rows, rng = [], random.Random(log)
    for second in range(400):
        degc = 25 + 8 * math.sin(second / 40 + ord(log)) + rng.gauss(0.0, 0.01)
        at = f"10:{second // 60:02}:{second % 60:02}"
        counts = 8000 + round(150 * (degc - 25) + rng.gauss(0.0, 3.0))
        rows.append(["27.11.2026", at, f"{degc:.3f}", f"{counts}", "bench, 3", "@SUM(1)"])
    return rows


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project with its firmware; not to be changed."""
    folder = tmp_path_factory.mktemp("scale") / "project"
    (folder / "logs").mkdir(parents=True)
    for name in ("a", "b", "c"):
        with (folder / f"logs/{name}.csv").open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEAD, *write_rows(name)])
    (folder / "zerodrift.toml").write_text(SCALE)
    done = CliRunner().invoke(cli, ["firmware", "-C", str(folder), "--no-uncertainty"])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def scale(built: Path, tmp_path: Path) -> Path:
    """A project of a simulated load cell whose logs hold a converter's counts."""
    return Path(shutil.copytree(built, tmp_path / "project"))


def apply(scale: Path, zerodrift: Command, *options: str) -> Result:
    out = scale / "out.csv"
    done = zerodrift("apply", scale / "logs/c.csv", "-C", scale, "--out", out, *options)
    assert done.code == 0, done.err
    return done


def test_columns_come_out_as_they_went_in_and_new_ones_are_added(
    scale: Path, zerodrift: Command
) -> None:
    apply(scale, zerodrift)
    with (scale / "out.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    added = ["weight_drift", "weight_compensated", "weight_uncertainty", "flags"]
    assert head == [*HEAD[:-1], "'=remark", *added]  # safe for spreadsheets
    assert [row[:6] for row in rows] == [[*row[:5], "'@SUM(1)"] for row in write_rows("c")]
    for row in rows:
        grams = 0.002 * float(row[3]) - 16
        assert math.isclose(float(row[7]), grams - float(row[6]), abs_tol=1e-9)
        assert abs(float(row[7])) < 0.1


def test_the_float_model_of_another_project_is_told(scale: Path, zerodrift: Command) -> None:
    assert "was not trained from" not in apply(scale, zerodrift, "--model", "float").err
    log = scale / "logs/a.csv"
    log.write_text(log.read_text().replace(",8", ",9", 1))
    assert "was not trained from these logs" in apply(scale, zerodrift, "--model", "float").err


def test_the_float_model_of_other_outputs_is_refused(scale: Path, zerodrift: Command) -> None:
    kept = scale / "build/compensator.json"
    toml = scale / "zerodrift.toml"
    other = scale.with_name(f"{scale.name}-other")
    (other / "logs").mkdir(parents=True)
    for log in (scale / "logs").iterdir():
        (other / "logs" / log.name).write_bytes(log.read_bytes())
    (other / "zerodrift.toml").write_text(
        toml.read_text().replace("outputs.weight", "outputs.force")
    )
    assert zerodrift("train", "-C", other).code == 0
    kept.write_bytes((other / "build/compensator.json").read_bytes())
    done = zerodrift("apply", scale / "logs/c.csv", "-C", scale, "--model", "float")
    assert done.code == 2 and "another project's" in done.err and "force" in done.err


def test_json_counts_the_same_rows(scale: Path, zerodrift: Command) -> None:
    told = json.loads(apply(scale, zerodrift, "--json").out)
    assert told["logs"][0]["rows"] == 400


def test_a_model_of_physics_alone_has_no_network_beside_it(built: Path) -> None:
    there = {path.name for path in (built / "firmware").glob("zd_*")}
    assert there == {"zd_runtime.h", "zd_runtime.c", "zd_signals.h"}
