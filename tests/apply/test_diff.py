"""`diff`: what changed is named, and the drifts' difference is the true one."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import predict_integer
from zerodrift.export.model_files import load_model
from zerodrift.tasks.diff import measure_over_range, open_model


def diff(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["diff", *map(str, arguments)])


@pytest.fixture(scope="session")
def other(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same project with a bent tempco and a narrower chamber."""
    project = Path(shutil.copytree(built, tmp_path_factory.mktemp("other") / "project"))
    text = (project / "zerodrift.toml").read_text()
    text = text.replace('kind = "zero_tempco"', 'kind = "zero_tempco"\norder = 2')
    (project / "zerodrift.toml").write_text(text)
    result = CliRunner().invoke(cli, ["firmware", "-C", str(project)])
    assert result.exit_code == 0, result.output
    return project


def test_a_model_is_the_same_as_itself(built: Path) -> None:
    told = json.loads(diff(built, built / "firmware", "--json").stdout)
    assert told["same"] and told["changes"] == []
    assert told["outputs"]["y"]["largest"] == 0.0


@pytest.mark.long
def test_what_changed_is_named(built: Path, other: Path) -> None:
    told = json.loads(diff(built, other, "--json").stdout)
    changed = {change["what"]: change for change in told["changes"]}
    assert "effect zero_tempco" in changed
    assert not told["same"] and 0.0 < told["outputs"]["y"]["largest"] < 0.1


def test_over_a_log_it_is_the_difference_of_the_two(built: Path, other: Path) -> None:
    log = built / "logs/run3.csv"
    told = json.loads(diff(built, other, log, "--json").stdout)
    (run,) = load_dataset(load_config(built)).test
    models = [load_model(p / "build/model.json") for p in (built, other)]
    old, new = (predict_integer(model, run)[:, 0] for model in models)
    expected = np.abs(new - old)
    assert told["outputs"]["y"]["largest"] == pytest.approx(expected.max(), abs=1e-12)
    rms = float(np.sqrt(np.mean(expected**2)))
    assert told["outputs"]["y"]["rms"] == pytest.approx(rms, rel=1e-9)


def test_the_sweep_finds_a_bent_end(built: Path) -> None:
    """A model whose slope is 1 % larger differs most at the ends: by 1 % of the drift there."""
    model = load_model(built / "build/model.json")
    drift = model.drift
    steeper = replace(
        drift,
        coefficients=np.round(1.01 * drift.coefficients).astype(np.int64),
        bias=np.round(1.01 * drift.bias.astype(np.float64)).astype(np.int64),
    )
    bent = replace(model, nodes=(*model.nodes[:-1], steeper))
    found = measure_over_range(model, bent)["y"]
    limit = max(abs(int(model.drift.high[0])), abs(int(model.drift.low[0]))) / 10_000
    assert 0.6 * 0.01 * limit < found.largest <= 0.0102 * limit


def test_a_limit_fails_the_command(built: Path, other: Path) -> None:
    assert diff(built, other, "--limit", 1).exit_code == 0
    failed = diff(built, other, "--limit", 0.0001)
    assert isinstance(failed.exception, CheckError)
    assert "of full scale; the limit is 0.0001 %" in str(failed.exception)


def test_what_cannot_be_is_refused(built: Path, other: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no model\.json here"):
        open_model(tmp_path)
    stale = Path(shutil.copytree(built, tmp_path / "stale"))
    shutil.copy(other / "build/model.json", stale / "firmware/model.json")
    with pytest.raises(InputError, match="its firmware is of the model"):
        open_model(stale / "firmware")


def take_away(project: Path, place: Path) -> Path:
    """Return a copy of a project's firmware folder, without the project."""
    return Path(shutil.copytree(project / "firmware", place / "firmware"))


@pytest.mark.long
def test_two_firmware_folders_suffice(built: Path, other: Path, tmp_path: Path) -> None:
    """What is said of the folders alone is what is said of the projects."""
    old, new = take_away(built, tmp_path / "old"), take_away(other, tmp_path / "new")
    result = diff(old, new, "--json")
    assert result.exit_code == 0 and result.stderr == ""
    told, expected = json.loads(result.stdout), json.loads(diff(built, other, "--json").stdout)
    assert told["changes"] == expected["changes"] and told["outputs"] == expected["outputs"]
    assert "effect zero_tempco" in {change["what"] for change in told["changes"]}
    same = json.loads(diff(old, built, "--json").stdout)
    assert same["same"] and same["changes"] == []


@pytest.mark.long
def test_folders_alone_read_logs_by_a_project_that_is_named(
    built: Path, other: Path, tmp_path: Path
) -> None:
    old, new = take_away(built, tmp_path / "old"), take_away(other, tmp_path / "new")
    log = built / "logs/run3.csv"
    told = json.loads(diff(old, new, log, "-C", built, "--json").stdout)
    expected = json.loads(diff(built, other, log, "--json").stdout)
    assert told["outputs"] == expected["outputs"]
    refused = diff(old, new, log)
    assert isinstance(refused.exception, InputError) and "-C" in str(refused.exception)
    assert diff(old, new, log, "-C", built, "--limit", 0.0001).exception.exit_code == 1


def test_a_folder_of_an_older_version_is_told_apart(built: Path, tmp_path: Path) -> None:
    """Without model.json it needs the build/ beside it; without effects.json these are not told."""
    old = take_away(built, tmp_path / "old")
    (old / "effects.json").unlink()
    result = diff(old, built, "--json")
    notes = " ".join(json.loads(result.stdout)["notes"])
    assert "effects.json are not as manifest.json has them" in notes
    assert "no effects are recorded there" in notes
    assert json.loads(result.stdout)["changes"] == []
    (old / "model.json").unlink()
    refused = diff(old, built)
    assert isinstance(refused.exception, InputError) and refused.exception.exit_code == 2
    assert "a folder that an older version wrote" in str(refused.exception)
    shutil.copytree(built / "build", tmp_path / "old" / "build")
    assert json.loads(diff(old, built, "--json").stdout)["same"]
