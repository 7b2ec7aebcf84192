"""A run that is another one's copy is known by its content, whatever was done to its file."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from benchmarks.bench_copies import CLEAN_KINDS, COPIES, find, make_clean, try_copy
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.resolution import measure_step
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.shared_rows import LEAST_NOISE_STEPS, measure_white_noise

HEADER = "time_s,temperature_degC,Fz_N,ref_Fz_N"


def write_log(path: Path, seed: int, rows: int = 600) -> np.ndarray:
    """Write one programme of the chamber with noise of its own; return time, temperature, force."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(rows, dtype=float)
    temperature = (20 + 8 * np.sin(time_s / 90) + rng.normal(0, 0.02, rows)).round(4)
    force = (2 * temperature + rng.normal(0, 0.3, rows)).round(3)
    return write_rows(path, np.column_stack([time_s, temperature, force]))


def write_rows(path: Path, rows: np.ndarray) -> np.ndarray:
    text = "\n".join(",".join([*(f"{value:.12g}" for value in row), "0"]) for row in rows)
    path.write_text(f"{HEADER}\n{text}\n")
    return rows


def load(directory: Path, **logs: list[str]) -> Dataset:
    lines = [f"{use} = {json.dumps(names)}" for use, names in logs.items()]
    text = render_toml("\n".join(["[logs]", *lines, ""]), outputs=(FORCE,))
    (directory / "zerodrift.toml").write_text(text)
    return load_dataset(load_config(directory))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for seed, name in enumerate(("a.csv", "b.csv", "c.csv")):
        write_log(tmp_path / name, seed)
    return tmp_path


def make_copy(kind: str, folder: Path) -> None:
    """Make `copy.csv` of rows 101 to 500 of `b.csv`, or of all of its rows."""
    source, target = folder / "b.csv", folder / "copy.csv"
    rows = np.loadtxt(source, delimiter=",", skiprows=1)[:, :3]
    if kind == "copy":
        target.write_bytes(source.read_bytes())
    elif kind == "hard link":
        os.link(source, target)
    elif kind == "excerpt":
        write_rows(target, rows[100:500])
    elif kind == "time shifted":
        write_rows(target, rows + np.array([86400.25, 0, 0]))
    elif kind == "rounded":
        write_rows(target, np.column_stack([rows[:, 0], rows[:, 1].round(2), rows[:, 2].round(1)]))


KINDS = ("copy", "hard link", "excerpt", "time shifted", "rounded")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("here", "there"), [("train", "test"), ("train", "dwell"), ("test", "dwell")]
)
def test_copy_for_another_use_is_refused(folder: Path, kind: str, here: str, there: str) -> None:
    make_copy(kind, folder)
    logs = {"train": ["a.csv"], here: ["b.csv"], there: ["c.csv", "copy.csv"]}
    with pytest.raises(InputError) as caught:
        load(folder, **logs)
    message = str(caught.value)
    first = 102 if kind == "excerpt" else 2
    last = 501 if kind == "excerpt" else 601
    assert f"b.csv:{first} to b.csv:{last}" in message
    assert f"copy.csv:2 to copy.csv:{last - first + 2}" in message
    assert f"{last - first + 1} rows" in message
    assert f"[logs] {there}: copy.csv and b.csv hold the same measurements" in message


@pytest.mark.parametrize("kind", KINDS)
def test_copy_among_training_logs_counts_once_and_is_named(folder: Path, kind: str) -> None:
    make_copy(kind, folder)
    dataset = load(folder, train=["a.csv", "b.csv", "c.csv", "copy.csv"])
    assert [run.name for run in dataset.train] == ["a", "b", "c"]
    (note,) = (note for note in dataset.notes if "copy.csv" in note)
    assert note.startswith("copy.csv is a copy of rows of b.csv")
    assert "counted once, copy.csv is left out" in note


def test_three_copies_count_once(folder: Path) -> None:
    for name in ("x.csv", "y.csv"):
        (folder / name).write_bytes((folder / "a.csv").read_bytes())
    dataset = load(folder, train=["*.csv"])
    assert [run.name for run in dataset.train] == ["a", "b", "c"]


def test_copy_under_another_name_of_run_in_one_file_is_refused(folder: Path) -> None:
    rows = (folder / "a.csv").read_text().splitlines()[1:]
    named = [f"{row},{name}" for name in ("one", "two") for row in rows]
    (folder / "both.csv").write_text("\n".join([f"{HEADER},run", *named]) + "\n")
    with pytest.raises(
        InputError, match=r"both.csv run 'two' and both.csv run 'one' hold the same"
    ):
        load(folder, train=["both.csv#one"], test=["both.csv#two"])


@pytest.mark.parametrize("names", [("early", "late"), ("z_early", "a_late")])
def test_training_logs_that_overlap_count_the_overlap_once(
    names: tuple[str, str], folder: Path
) -> None:
    rows = write_log(folder / "long.csv", 9, rows=900)
    (folder / "long.csv").unlink()
    early, late = names
    write_rows(folder / f"{early}.csv", rows[:500])
    write_rows(folder / f"{late}.csv", rows[400:])
    dataset = load(folder, train=["*.csv"])
    runs = {run.name: run for run in dataset.train}
    np.testing.assert_array_equal(runs[early].measured[:, 0], rows[:400, 2])
    np.testing.assert_array_equal(runs[late].measured[:, 0], rows[400:, 2])
    (note,) = (note for note in dataset.notes if "overlap" in note)
    assert f"counted once, {early}.csv ends there, as by '@:400'" in note
    # What the note says it did is what the selector does.
    others = [f"{late}.csv", "a.csv", "b.csv", "c.csv"]
    by_hand = load(folder, train=[f"{early}.csv@:400", *others])
    cut = next(run for run in by_hand.train if run.name == f"{early}@:400")
    np.testing.assert_array_equal(cut.measured, runs[early].measured)
    np.testing.assert_array_equal(cut.time_s, runs[early].time_s)
    assert not [note for note in by_hand.notes if "overlap" in note]


def test_three_logs_that_overlap_in_turn_count_every_row_once(folder: Path) -> None:
    rows = write_log(folder / "a.csv", 9, rows=900)
    write_rows(folder / "a.csv", rows[:400])
    write_rows(folder / "b.csv", rows[300:700])
    write_rows(folder / "c.csv", rows[350:])
    dataset = load(folder, train=["*.csv"])
    together = np.concatenate([run.measured[:, 0] for run in dataset.train])
    np.testing.assert_array_equal(np.sort(together), np.sort(rows[:, 2]))


def test_overlap_of_an_averaged_log_leaves_no_shared_row_in_the_run_that_ends(folder: Path) -> None:
    rows = write_log(folder / "long.csv", 9, rows=9000)
    (folder / "long.csv").unlink()
    rows[:, 0] = rows[:, 0] * 0.1
    write_rows(folder / "early.csv", rows[:5000])
    write_rows(folder / "late.csv", rows[4003:])
    runs = {run.name: run for run in load(folder, train=["early.csv", "late.csv"]).train}
    assert 399.0 <= runs["early"].time_s[-1] < rows[4003, 0]
    np.testing.assert_allclose(
        runs["early"].measured[-1, 0], rows[3990:4000, 2].mean(), rtol=1e-12, atol=0
    )


def test_logs_that_share_rows_amid_both_are_refused_with_the_rows(folder: Path) -> None:
    rows = write_log(folder / "long.csv", 9, rows=900)
    other = write_log(folder / "other.csv", 10, rows=900)
    write_rows(folder / "early.csv", np.concatenate([rows[:500], other[500:700]]))
    mixed = np.concatenate([other[:300], rows[400:500], other[800:]])
    mixed[:, 0] = np.arange(len(mixed))
    write_rows(folder / "late.csv", mixed)
    with pytest.raises(
        InputError, match=r"overlap: late.csv:302 to late.csv:401 are the rows of early.csv:402"
    ):
        load(folder, train=["early.csv", "late.csv"])


def test_an_overlap_of_a_training_and_a_test_log_stays_refused(folder: Path) -> None:
    rows = write_log(folder / "long.csv", 9, rows=900)
    write_rows(folder / "early.csv", rows[:500])
    write_rows(folder / "late.csv", rows[400:])
    with pytest.raises(InputError, match=r"hold the same measurements"):
        load(folder, train=["early.csv"], test=["late.csv"])


def test_parts_of_one_run_that_selectors_split_are_no_copies(folder: Path) -> None:
    dataset = load(folder, train=["a.csv@:50%", "b.csv"], test=["a.csv@50%:"], dwell=["b.csv@:60"])
    assert len(dataset.train) == 2
    os.link(folder / "a.csv", folder / "link.csv")
    assert len(load(folder, train=["a.csv@:50%"], test=["link.csv@50%:"]).test) == 1


def test_programmes_alike_with_noise_of_their_own_are_no_copies(folder: Path) -> None:
    dataset = load(folder, train=["a.csv", "b.csv"], test=["c.csv"])
    assert not [note for note in dataset.notes if "copy" in note]


def test_one_thermometer_for_two_sensors_makes_no_copy(folder: Path) -> None:
    rows = np.loadtxt(folder / "a.csv", delimiter=",", skiprows=1)[:, :3]
    rows[:, 2] += np.random.default_rng(5).normal(0, 0.3, len(rows))
    write_rows(folder / "other.csv", rows)
    assert len(load(folder, train=["a.csv"], test=["other.csv"]).test) == 1


@pytest.mark.parametrize("kind", COPIES)
@pytest.mark.parametrize("seed", range(2))
def test_copies_of_every_kind_are_found(kind: str, seed: int) -> None:
    assert try_copy(seed, COPIES[kind])


@pytest.mark.parametrize("kind", [*CLEAN_KINDS, "twin"])
def test_clean_sets_do_not_alarm(kind: str) -> None:
    assert [find(make_clean(kind, seed)) for seed in range(4)] == [{}] * 4


@pytest.mark.parametrize("digits", [0, 1, 4, 6])
def test_step_of_decimals_is_measured(digits: int) -> None:
    values = (25 + np.random.default_rng(0).normal(0, 9, 200)).round(digits)
    assert measure_step(values) == pytest.approx(10.0**-digits, rel=1e-3)


def test_step_of_a_converter_is_measured_and_that_of_doubles_is_none() -> None:
    values = np.random.default_rng(0).normal(0, 9, 200)
    assert measure_step(np.rint(values * 128) / 128) == pytest.approx(1 / 128)
    assert measure_step(values) == 0
    assert measure_step(np.ones(200)) == 0


def test_noise_is_measured_on_a_drift_and_not_in_a_smooth_curve() -> None:
    at = np.arange(2000.0)
    noise = np.random.default_rng(0).normal(0, 0.1, at.size)
    assert measure_white_noise(20 * np.sin(at / 100) + noise) == pytest.approx(0.1, rel=0.15)
    assert measure_white_noise(20 * np.sin(at / 100)) == 0
    assert measure_white_noise(np.repeat(np.arange(20.0), 100)) == 0


@pytest.mark.parametrize("slope", [0.5, 0.47, 0.34, 1.3])
def test_ramp_over_a_coarse_converters_steps_is_no_noise(slope: float) -> None:
    ramp = np.rint(slope * np.arange(200.0) + 0.2)
    assert measure_white_noise(ramp) < LEAST_NOISE_STEPS


def record_coarsely(seed: int, rows: int = 1500) -> list[np.ndarray]:
    """Return one column of a converter of two or three codes, zeroed where it stands."""
    rng = np.random.default_rng(seed)
    slow = 0.4 * np.sin(np.arange(rows) / rng.uniform(150, 400) + rng.uniform(0, 6))
    codes = np.rint(slow + rng.uniform(-0.5, 0.5) + rng.normal(0, 0.33, rows))
    return [0.2 * (codes + rng.integers(-500, 500))]


def test_two_codes_of_a_zeroed_converter_are_no_copy() -> None:
    runs = [record_coarsely(seed) for seed in range(24)]
    assert find(runs) == {}
    copied = [*runs[:3], [runs[0][0][200:900] + 0.4]]
    assert find(copied) == {}  # so few bits prove nothing, be it a copy or not
