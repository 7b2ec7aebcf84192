"""The benchmark on real records sees nothing of what it predicts; its simple fits are plain."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import bench_real
from benchmarks.real.loop import run_loop
from benchmarks.real.records import Record, list_entries
from benchmarks.real.simple import (
    FOLDS,
    SIMPLE,
    choose_simple,
    delay,
    list_folds,
    measure_error,
    predict_simple,
)

ROWS, PERIOD_S, TAU_S = 240, 10.0, 80.0
FEWEST_RECORDS = 20


@pytest.fixture(scope="module")
def record() -> Record:
    """Return a line behind a lag, in a log with a gap inside its second fold."""
    rng = np.random.default_rng(3)
    place = np.arange(ROWS)
    place[60:] += 9
    temperature = 25.0 + 5.0 * np.sin(place / 20.0) + np.cumsum(rng.normal(0.0, 0.05, ROWS))
    humidity = {"humidity": 50.0 + rng.normal(0.0, 1.0, ROWS)}
    bare = Record("r", "ppm", PERIOD_S, place, temperature, np.zeros(ROWS), humidity)
    lagging = delay(bare, np.ones(ROWS, dtype=bool), TAU_S)
    return replace(bare, drift=3.0 + 2.0 * lagging + rng.normal(0.0, 0.1, ROWS))


def spoil(record, rows, channels):
    """Return the record with other values in some rows of its drift, or of every channel."""

    def change(values):
        return np.where(rows, 7.0 - 3.0 * values[::-1], values)

    other = replace(record, drift=change(record.drift))
    if channels:
        inputs = {name: change(values) for name, values in record.inputs.items()}
        other = replace(other, temperature_degC=change(record.temperature_degC), inputs=inputs)
    return other


@pytest.mark.parametrize("rows", [FOLDS, 239, 240, 241])
def test_folds_are_contiguous_disjoint_and_whole(rows):
    folds = list_folds(rows)
    assert len(folds) == FOLDS
    assert np.array_equal(np.sum(folds, axis=0), np.ones(rows))
    for fold in folds:
        assert np.all(np.diff(np.flatnonzero(fold)) == 1)
    assert np.ptp([fold.sum() for fold in folds]) <= 1


@pytest.mark.parametrize("left_out", range(FOLDS))
@pytest.mark.parametrize("method", SIMPLE)
def test_no_row_left_out_reaches_a_simple_fit(record, method, left_out):
    fold = list_folds(ROWS)[left_out]
    fitted = SIMPLE[method](record, ~fold)
    again = SIMPLE[method](spoil(record, fold, channels=True), ~fold)
    assert again.taus_s == fitted.taus_s
    assert np.array_equal(again.coefficients, fitted.coefficients)
    # a row that is taught does reach it
    taught = SIMPLE[method](spoil(record, ~fold, channels=False), ~fold)
    assert not np.allclose(taught.coefficients, fitted.coefficients)


def test_no_row_left_out_reaches_the_choice(record):
    fold, *others = list_folds(ROWS)
    chosen = choose_simple(record, others)
    assert chosen == choose_simple(spoil(record, fold, channels=True), others)
    assert chosen in ("cubic + lag", "two lags")


def test_no_row_left_out_reaches_the_loop(record):
    fold = list_folds(ROWS)[1]
    found = run_loop(record, ~fold, fold)
    assert np.array_equal(np.isfinite(found.drift), fold)
    again = run_loop(spoil(record, fold, channels=False), ~fold, fold)
    assert again.effects == found.effects
    assert np.array_equal(again.drift, found.drift, equal_nan=True)
    # its channels are read to predict it, and teach nothing
    moved = run_loop(spoil(record, fold, channels=True), ~fold, fold)
    assert (moved.effects, moved.verdicts) == (found.effects, found.verdicts)
    assert not np.array_equal(moved.drift, found.drift, equal_nan=True)
    assert "thermal_lag" in found.effects
    assert np.std((record.drift - found.drift)[fold]) < 0.2 * np.std(record.drift)


def test_simple_fits_are_plain_least_squares(record):
    fold = list_folds(ROWS)[2]
    t, drift = record.temperature_degC, record.drift
    errors = predict_simple(record, ~fold, fold)
    for name, degree in (("constant", 0), ("line", 1), ("cubic", 3)):
        table = np.vander(t - 25.0, degree + 1)
        answer = np.linalg.lstsq(table[~fold], drift[~fold], rcond=None)[0]
        rest = (drift - table @ answer)[fold]
        assert errors[name].rms == pytest.approx(np.sqrt(np.mean(rest**2)), rel=1e-9)
        assert errors[name].scatter == pytest.approx(np.std(rest), rel=1e-9)


def test_a_lag_fit_is_the_best_of_its_time_constants_on_what_is_taught(record):
    fold = list_folds(ROWS)[4]
    fitted = SIMPLE["cubic + lag"](record, ~fold)
    (tau_s,) = fitted.taus_s
    table = np.vander(delay(record, ~fold, tau_s) - 25.0, 4)
    answer, squares, *_ = np.linalg.lstsq(table[~fold], record.drift[~fold], rcond=None)
    assert fitted.squares == pytest.approx(squares[0], rel=1e-6)
    predicted = fitted.predict(record, np.ones(ROWS, dtype=bool))
    assert predicted[~fold] == pytest.approx((table @ answer)[~fold], rel=1e-6)
    assert 0.6 * TAU_S < tau_s < 1.6 * TAU_S


def test_a_lag_begins_at_rest_and_goes_straight_through_gaps():
    t = np.array([1.0, 1.0, 5.0, 5.0])
    record = Record("r", "K", 1.0, np.array([0, 1, 3, 4]), t, t)
    everything = np.ones(4, dtype=bool)
    assert np.array_equal(delay(record, everything, 0.0), t)
    # by hand: 1, 1, [3], 5, 5 on the grid, each step half of the way
    half = delay(record, everything, 1.0 / np.log(2.0))
    assert half == pytest.approx([1.0, 1.0, 3.5, 4.25])


def test_error_with_and_without_its_mean():
    error = measure_error(np.array([3.0, 5.0]))
    assert (error.rms, error.scatter) == (pytest.approx(np.sqrt(17.0)), 1.0)


def test_the_list_is_whole_and_its_short_form_small():
    entries = list_entries()
    assert len(entries) >= FEWEST_RECORDS
    assert len({entry.name for entry in entries}) == len(entries)
    assert 0 < sum(entry.short for entry in entries) < 5
    for entry in entries:
        assert not Path(entry.log).is_absolute()
        assert {"source", "temperature", "measured", "unit", "period_s"} <= set(entry.settings)
        assert ("time" in entry.settings) != ("log_period_s" in entry.settings)


def lay_out(record, folder, name):
    """Write a record as the list's own load cell."""
    (entry,) = (entry for entry in list_entries() if entry.name == name)
    step = entry.settings["period_s"]
    lines = ["time_s,temperature_degC,weight_kg,static_load_nominal_kg"]
    for place, t, drift in zip(record.place, record.temperature_degC, record.drift, strict=True):
        lines.append(f"{step * place},{t:.4f},{drift + 22.0:.4f},22")
    (folder / entry.log).write_text("\n".join(lines) + "\n")


def test_results_are_kept_and_gone_on_with(record, tmp_path, capsys, monkeypatch):
    lay_out(record, tmp_path, "load cell")
    kept = tmp_path / "results.jsonl"
    words = ("--data", str(tmp_path), "--only", "load cell", "--results", str(kept))
    assert bench_real.run(words) == 0
    told = capsys.readouterr()
    assert "1 of 1: load cell" in told.err
    assert "loop over chosen: median" in told.out
    (line,) = kept.read_text().splitlines()
    result = json.loads(line)
    assert result["rows"] == ROWS
    assert [fold["rows"] for fold in result["folds"]] == [48] * FOLDS
    assert bench_real.pool(result, "loop") < 0.2 * bench_real.pool(result, "constant")

    def fail(*_):
        raise AssertionError("was run again")

    monkeypatch.setattr(bench_real, "judge", fail)
    assert bench_real.run(words) == 0
    assert capsys.readouterr().out == told.out
    kept.write_text(line.replace(result["mark"], "another"))
    with pytest.raises(SystemExit, match="expected"):
        bench_real.run(words)


def test_a_record_that_is_missing_is_named(tmp_path, capsys):
    words = ("--data", str(tmp_path), "--only", "oscillator")
    assert bench_real.run(words) == 1
    assert "missing: oscillator" in capsys.readouterr().out
    assert bench_real.run((*words, "--allow-missing")) == 0
