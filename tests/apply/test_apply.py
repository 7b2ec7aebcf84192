"""`apply`: what it writes is what the chip gives, row by row, and bad logs are told."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.log_steps import name_columns, read_log_steps
from zerodrift.export.compose import predict_integer
from zerodrift.export.integer_model import FLAG_NO_READING, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.tasks.apply import FLAG_NAMES, Chip, answer, choose_file

HEADER = "time_s,temperature_degC,y_N"


def apply(project: Path, *arguments: object) -> Result:
    return CliRunner().invoke(cli, ["apply", "-C", str(project), *map(str, arguments)])


def load(project: Path) -> IntegerModel:
    return load_model(project / "build" / "model.json")


def write_log(path: Path, time_s: np.ndarray, temperature: np.ndarray, more: str = "") -> Path:
    rows = [
        f"{t:.4f},{x:.4f},{0.3 * (x - 25):.5f}{more}"
        for t, x in zip(time_s, temperature, strict=True)
    ]
    path.write_text("\n".join([HEADER + (",note" if more else ""), *rows]) + "\n")
    return path


def wave(time_s: np.ndarray) -> np.ndarray:
    return 25 + 8 * np.sin(time_s / 80)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_rows_are_what_the_integer_model_gives(built: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"out.{suffix}"
    result = apply(built, built / "logs/run3.csv", "--out", out)
    assert result.exit_code == 0, result.output
    frame = pl.read_csv(out) if suffix == "csv" else pl.read_parquet(out)
    (run,) = load_dataset(load_config(built)).test
    expected = predict_integer(load(built), run)[:, 0]
    assert np.array_equal(frame["y_drift"].to_numpy(), expected)
    assert np.allclose(frame["y_compensated"], frame["y_N"].to_numpy() - expected, atol=1e-12)
    assert (frame["flags"] == 0).all()
    assert frame.columns[:3] == HEADER.split(",")


def test_a_gap_is_bridged_as_compare_does(built: Path, tmp_path: Path) -> None:
    time_s = np.arange(400.0)
    time_s[200:] += 57.0
    (built / "logs").mkdir(exist_ok=True)
    log = write_log(tmp_path / "gap.csv", time_s, wave(time_s))
    config = replace(load_config(built), test_logs=(str(log),))
    runs = load_dataset(config).test
    assert len(runs) == 2
    expected = np.concatenate([predict_integer(load(built), run)[:, 0] for run in runs])
    model = load(built)
    columns = name_columns(config, ["temperature_degC", "measured:y"])
    steps = read_log_steps(config, log, columns)
    told = answer(Chip(model), config, steps)
    assert np.array_equal(told.drift[:, 0] / model.outputs[0].lsb_per_unit, expected)
    assert "interrupted" in steps.notes[0]


def test_faster_rows_take_the_last_complete_step(built: Path, tmp_path: Path) -> None:
    time_s = np.arange(0.0, 100.0, 0.25)
    log = write_log(tmp_path / "fast.csv", time_s, wave(time_s))
    out = tmp_path / "fast_out.csv"
    assert apply(built, log, "--out", out).exit_code == 0
    drift = pl.read_csv(out)["y_drift"].to_numpy()
    assert drift.size == 400
    # a step ends at whole seconds: the four rows from there on share it
    assert np.array_equal(
        drift[4:396].reshape(-1, 4).min(axis=1), drift[4:396].reshape(-1, 4).max(axis=1)
    )
    assert np.unique(drift).size > 90


def test_missing_readings_are_given_to_the_chip_as_such(built: Path, tmp_path: Path) -> None:
    time_s = np.arange(100.0)
    log = write_log(tmp_path / "holes.csv", time_s, wave(time_s), ",x")
    lines = log.read_text().splitlines()
    for row in (31, 32, 33):
        lines[1 + row] = f"{row}.0000,,0.5,lost"
    lines[1 + 50] = "50.0000,-256,0.5,not ready"
    log.write_text("\n".join(lines) + "\n")
    out = tmp_path / "holes_out.csv"
    result = apply(built, log, "--out", out)
    assert result.exit_code == 0, result.output
    frame = pl.read_csv(out)
    lacks = (frame["flags"].to_numpy() & FLAG_NO_READING) != 0
    assert np.flatnonzero(lacks).tolist() == [31, 32, 33, 50]
    assert frame["y_drift"][33] == frame["y_drift"][30], "the chip goes on with the last reading"
    assert frame["y_uncertainty"][32] is None and frame["y_uncertainty"][34] is not None
    assert frame["note"][31] == "lost", "other columns stay as they were"
    assert FLAG_NAMES[FLAG_NO_READING] in result.output


def test_a_channel_without_a_code_for_none_holds_its_last_reading(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gap that begins in one block and fills the next holds what came before both."""
    time_s = np.arange(300.0)
    log = write_log(tmp_path / "holes.csv", time_s, wave(time_s))
    lines = log.read_text().splitlines()
    held = lines[1 + 39].split(",")[1]
    with_hole, filled = list(lines), list(lines)
    for row in range(40, 130):
        with_hole[1 + row] = f"{row}.0000,,0.5"
        filled[1 + row] = f"{row}.0000,{held},0.5"
    model = load(built)
    channel = replace(model.channels[0], no_reading=None)
    chip = Chip(replace(model, channels=(channel, *model.channels[1:])))
    config = load_config(built)
    columns = name_columns(config, ["temperature_degC", "measured:y"])
    monkeypatch.setattr("zerodrift.tasks.apply.BLOCK", 32)
    told = []
    for text in (with_hole, filled):
        log.write_text("\n".join(text) + "\n")
        told.append(answer(chip, config, read_log_steps(config, log, columns)))
    assert np.array_equal(told[0].drift, told[1].drift)
    assert "no reading at 90 steps" in " ".join(told[0].notes)


def test_outside_the_range_the_uncertainty_grows(built: Path, tmp_path: Path) -> None:
    time_s = np.arange(200.0)
    log = write_log(tmp_path / "hot.csv", time_s, 25 + 0.2 * time_s)
    out = tmp_path / "hot_out.parquet"
    assert apply(built, log, "--out", out).exit_code == 0
    frame = pl.read_parquet(out)
    inside = frame.filter(pl.col("flags") == 0)["y_uncertainty"]
    outside = frame.filter((pl.col("flags") & 2 != 0) & (pl.col("flags") & 8 == 0))["y_uncertainty"]
    assert inside.n_unique() == 1
    assert outside.min() > inside.max()
    assert np.all(np.diff(outside.to_numpy()) >= 0.0), "the further out, the less is known"


def test_runs_that_alternate_in_a_file_are_kept_apart(built: Path, tmp_path: Path) -> None:
    time_s = np.arange(120.0)
    one, other = wave(time_s), wave(time_s + 200)
    lines = ["run," + HEADER]
    for t, a, b in zip(time_s, one, other, strict=True):
        lines += [f"a,{t:.1f},{a:.4f},0", f"b,{t:.1f},{b:.4f},0"]
    mixed = tmp_path / "mixed.csv"
    mixed.write_text("\n".join(lines) + "\n")
    alone = write_log(tmp_path / "alone.csv", time_s, other)
    for log in (mixed, alone):
        assert apply(built, log, "--out", tmp_path / f"{log.stem}_out.csv").exit_code == 0
    both = pl.read_csv(tmp_path / "mixed_out.csv")
    assert both["run"].to_list() == ["a", "b"] * 120, "rows stay where they were"
    expected = pl.read_csv(tmp_path / "alone_out.csv")["y_drift"]
    assert both.filter(pl.col("run") == "b")["y_drift"].equals(expected)


def test_without_a_compiler_the_reference_gives_the_same(
    built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, model = load_config(built), load(built)
    columns = name_columns(config, ["temperature_degC", "measured:y"])
    steps = read_log_steps(config, built / "logs/run3.csv", columns)
    by_c = answer(Chip(model), config, steps)

    def refuse(*_: object, **__: object) -> None:
        raise OSError("no compiler")

    monkeypatch.setattr("zerodrift.tasks.apply.HostModel", refuse)
    slow = Chip(model)
    assert "no compiler" in slow.note
    by_reference = answer(slow, config, steps)
    assert np.array_equal(by_c.drift, by_reference.drift)
    assert np.array_equal(by_c.flags, by_reference.flags)


def test_json_says_what_was_written(built: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.csv"
    told = json.loads(apply(built, built / "logs/run3.csv", "--out", out, "--json").stdout)
    (log,) = told["logs"]
    assert log["rows"] == log["steps"] == 600
    assert log["outputs"]["y"]["unit"] == "N"
    assert told["model_hash"] == load(built).hash


def test_the_float_model_can_stand_for_the_chip(built: Path, tmp_path: Path) -> None:
    log = built / "logs/run3.csv"
    assert apply(built, log, "--out", tmp_path / "i.csv").exit_code == 0
    result = apply(built, log, "--model", "float", "--out", tmp_path / "f.csv")
    assert result.exit_code == 0, result.output
    integer, floating = (pl.read_csv(tmp_path / name)["y_drift"] for name in ("i.csv", "f.csv"))
    assert 0.0 < (integer - floating).abs().max() < 0.01


def refuse(project: Path, *arguments: object) -> str:
    """Return the error of a call that must be refused."""
    result = apply(project, *arguments)
    assert isinstance(result.exception, InputError), result.output
    return str(result.exception)


@pytest.mark.long
def test_what_cannot_be_is_refused(built: Path, tmp_path: Path) -> None:
    log = Path(shutil.copy(built / "logs/run3.csv", tmp_path / "log.csv"))
    out = tmp_path / "out.csv"
    assert apply(built, log, "--out", out).exit_code == 0
    twice = tmp_path / "twice.csv"
    assert "has a column 'y_drift' already" in refuse(built, out, "--out", twice)
    assert "is a log itself" in refuse(built, log, "--out", log)
    other = tmp_path / "notes.csv"
    other.write_text("mine\n")
    assert "was not written by" in refuse(built, log, "--out", other)
    assert other.read_text() == "mine\n"
    table = tmp_path / "mine.parquet"
    pl.DataFrame({"mine": [1.0]}).write_parquet(table)
    assert "was not written by" in refuse(built, log, "--out", table)
    assert apply(built, log, "--out", out).exit_code == 0, "its own answer may be written again"
    lacking = tmp_path / "lacking.csv"
    lacking.write_text("time_s,y_N\n0,1\n1,2\n")
    assert "temperature_degC" in refuse(built, lacking, "--out", twice)
    short = tmp_path / "short.csv"
    short.write_text(f"{HEADER}\n0,25,1\n")
    assert "1 row" in refuse(built, short, "--out", twice)
    with pytest.raises(InputError, match="stands for no format"):
        choose_file(log, tmp_path / "x.doc", several=False)
    assert choose_file(Path("a/run.feather"), None, several=False) == Path("run_compensated.csv")
    assert choose_file(Path("run.pq"), None, several=False) == Path("run_compensated.pq")
    with pytest.raises(InputError, match="is no directory"):
        choose_file(log, tmp_path / "x.csv", several=True)
    assert not twice.exists() and not list(tmp_path.glob(".*.part"))


def test_an_older_models_uncertainty_is_not_stated(built: Path, tmp_path: Path) -> None:
    project = Path(shutil.copytree(built, tmp_path / "project"))
    kept = project / "build" / "uncertainty.json"
    kept.write_text(kept.read_text().replace('"noise": 0', '"noise": 1'))
    out = tmp_path / "o.csv"
    result = apply(project, project / "logs/run3.csv", "--out", out)
    assert result.exit_code == 0 and "no uncertainty is stated" in result.output
    assert pl.read_csv(out)["y_uncertainty"].null_count() == 600


def test_outputs_that_no_channel_takes_are_not_held(built: Path, tmp_path: Path) -> None:
    """They have to be there, as numbers, and are read again when the rows are written."""
    config, model = load_config(built), load(built)
    columns = name_columns(config, ["temperature_degC", "measured:y"])
    log = built / "logs/run3.csv"
    steps = read_log_steps(config, log, columns, streamed=frozenset({"y_N"}))
    assert list(steps.table.columns) == ["time_s", "temperature_degC"]
    whole = read_log_steps(config, log, columns)
    assert "y_N" in whole.table.columns
    chip = Chip(model)
    assert np.array_equal(answer(chip, config, steps).drift, answer(chip, config, whole).drift)
    assert steps.drop_values().steps == steps.steps == 600
    bare = tmp_path / "bare.csv"
    bare.write_text("time_s,temperature_degC\n0,25\n1,25\n")
    assert "there is no column 'y_N'" in refuse(built, bare, "--out", tmp_path / "x.csv")
    worded = tmp_path / "worded.parquet"
    rows = {"time_s": [0.0, 1.0], "temperature_degC": [25.0, 25.0], "y_N": ["a", "b"]}
    pl.DataFrame(rows).write_parquet(worded)
    assert "expected numbers" in refuse(built, worded, "--out", tmp_path / "x.csv")
