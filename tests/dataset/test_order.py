"""The order in which logs are named changes nothing: not a bit of what is fitted from them."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset

EFFECTS = """
[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "thermal_lag"
"""


def write_noisy_log(path: Path, seed: int, rows: int = 400) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.arange(rows, dtype=float)
    temperature = 20 + 10 * np.sin(time_s / (40 + 11 * seed)) + rng.normal(0, 0.02, rows)
    force = 3 * temperature + np.cumsum(rng.normal(0, 0.1, rows)) + rng.normal(0, 1, rows)
    table = np.column_stack([time_s, temperature, force, np.zeros(rows)])
    header = "time_s,temperature_degC,Fz_N,ref_Fz_N"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")


def export(directory: Path, train: tuple[str, ...]) -> tuple[str, bytes]:
    """Return the model's hash and the bytes of its coefficients."""
    text = render_toml(f"[logs]\ntrain = {json.dumps(train)}\n{EFFECTS}", outputs=(FORCE,))
    (directory / "zerodrift.toml").write_text(text)
    result = CliRunner().invoke(cli, ["export", "--json", "-C", str(directory)])
    assert result.exit_code == 0, result.output
    (build,) = (path for path in (directory / "build").iterdir() if path.name == "compensator.json")
    coefficients = build.read_bytes()
    build.unlink()
    found: str = json.loads(result.stdout)["model_hash"]
    return found, coefficients


@pytest.mark.long
def test_order_of_train_logs_changes_no_bit_of_the_model(tmp_path: Path) -> None:
    names = ("a.csv", "b.csv", "c.csv")
    for seed, name in enumerate(names):
        write_noisy_log(tmp_path / name, seed)
    found = {export(tmp_path, order) for order in itertools.permutations(names)}
    assert len(found) == 1


@pytest.mark.parametrize(
    "train", [("b.csv", "a.csv"), ("[b]*.csv", "a*.csv"), ("b.csv@50%:", "b.csv@:50%", "a.csv")]
)
def test_order_of_selectors_changes_no_run(tmp_path: Path, train: tuple[str, ...]) -> None:
    for seed, name in enumerate(("a.csv", "b.csv")):
        write_noisy_log(tmp_path / name, seed)
    found = []
    for order in itertools.permutations(train):
        text = render_toml(f"[logs]\ntrain = {json.dumps(order)}\n", outputs=(FORCE,))
        (tmp_path / "zerodrift.toml").write_text(text)
        runs = load_dataset(load_config(tmp_path)).train
        found.append([(run.name, run.measured.tobytes()) for run in runs])
    assert all(one == found[0] for one in found)


def test_order_of_runs_in_one_file_is_the_files(tmp_path: Path) -> None:
    for seed, name in enumerate(("late", "early")):
        write_noisy_log(tmp_path / f"{name}.csv", seed)
    lines = {
        name: (tmp_path / f"{name}.csv").read_text().splitlines() for name in ("late", "early")
    }
    rows = [f"{row},{name}" for name, text in lines.items() for row in text[1:]]
    (tmp_path / "both.csv").write_text("\n".join([lines["late"][0] + ",run", *rows]) + "\n")
    for train in (["both.csv#early", "both.csv#late"], ["both.csv"]):
        text = render_toml(f"[logs]\ntrain = {json.dumps(train)}\n", outputs=(FORCE,))
        (tmp_path / "zerodrift.toml").write_text(text)
        names = [run.name for run in load_dataset(load_config(tmp_path)).train]
        assert names == ["late", "early"]


def test_init_guesses_the_same_whatever_the_order(tmp_path: Path) -> None:
    for seed, name in enumerate(("a.csv", "b.csv")):
        write_noisy_log(tmp_path / name, seed)
    found = set()
    for order in (["a.csv", "b.csv"], ["b.csv", "a.csv"]):
        result = CliRunner().invoke(cli, ["init", "-C", str(tmp_path), "--force", *order])
        assert result.exit_code == 0, result.output
        found.add((tmp_path / "zerodrift.toml").read_text())
    assert len(found) == 1
