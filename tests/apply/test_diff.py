"""`diff`: what changed is named, and the drifts' difference is the true one."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from zerodrift.app.cli import cli
from zerodrift.app.diff import measure_over_range, open_model
from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import predict_integer
from zerodrift.export.model_files import load_model


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
    shutil.copy(other / "build/model.json", stale / "build/model.json")
    with pytest.raises(InputError, match="its firmware is of the model"):
        open_model(stale / "firmware")
