"""Outliers: weighted where no signal explains them, and nothing else touched."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zerodrift.dataset.outliers import (
    LAGS,
    NORMAL_OF_MAD,
    ROUNDS,
    _follow,
    _prepare,
    _take_nearby,
    weigh_samples,
)
from zerodrift.dataset.runs import Run, share_resolution, tell_outliers


@pytest.fixture
def run():
    rng = np.random.default_rng(5)
    time_s = np.arange(3000.0)
    temperature = 25.0 + 15.0 * np.sin(time_s / 400.0)
    load = np.repeat(rng.uniform(-500.0, 500.0, 20), 150)[:, None] * [1.0, 0.0]
    noise = rng.normal(size=(3000, 2)) * [0.5, 0.01]
    drift = np.stack([0.8 * temperature + 0.02 * load[:, 0], 0.01 * temperature], axis=1)
    return Run("a", "a", 0, Path("a.csv"), 1.0, time_s, temperature, load + drift + noise, load)


def spoil(run, share, seed=1):
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(rng.uniform(size=len(run)) < share)
    far = rng.choice([-1, 1], rows.size) * rng.uniform(15.0, 60.0, rows.size)
    measured = run.measured.copy()
    measured[rows] += far[:, None] * [0.5, 0.01]
    return replace(run, measured=measured), rows


def test_noise_and_steps_of_the_load_are_no_outliers(run):
    assert run.outliers is None
    assert (run.weights == 1.0).all()
    assert (run.steady_drift == run.drift).all()


@pytest.mark.parametrize("share", [0.002, 0.02])
def test_rows_far_off_get_no_weight_and_their_neighbours_value(run, share):
    spoilt, rows = spoil(run, share)
    weights = spoilt.weights
    # A row next to a step of the load may be spared; hardly any is.
    assert (weights[rows] == 0.0).mean() > 0.98
    others = np.setdiff1d(np.arange(len(run)), rows)
    assert (weights[others] == 1.0).all()
    assert (spoilt.steady_drift[others] == run.drift[others]).all()
    off = (spoilt.steady_drift - run.drift)[rows] / [0.5, 0.01]
    assert np.sqrt(np.mean(off**2)) < 2.0
    assert tell_outliers([spoilt]).rows == pytest.approx(rows.size, abs=1)
    assert "outliers" in tell_outliers([spoilt]).explain()


def test_what_follows_a_signal_at_once_is_no_outlier(run):
    # A lamp that flashes for one sample every now and then, and the output sees it.
    rng = np.random.default_rng(2)
    light = (rng.uniform(size=len(run)) < 0.01).astype(float)
    lit = replace(run, measured=run.measured + 20.0 * light[:, None], inputs={"light": light})
    assert lit.outliers is None
    assert replace(lit, inputs={}).outliers is not None


def test_coarse_converter_and_rest_are_no_outliers(run):
    rng = np.random.default_rng(3)
    coarse = np.round(run.measured / [1.0, 0.02]) * [1.0, 0.02] - run.reference
    assert weigh_samples(coarse, run.temperature_degC, run.reference, {}) is None
    still = np.zeros((3000, 1))
    assert weigh_samples(still, run.temperature_degC, run.reference, {}) is None
    half = rng.normal(size=(3000, 1))
    half[:2000] = 0.0
    assert weigh_samples(half, run.temperature_degC, run.reference, {}) is None


def test_steep_ends_and_short_stretches_are_no_outliers():
    steep = np.random.default_rng(4).normal(size=(200, 1)) + 20.0 * np.arange(200.0)[:, None]
    warm, load = np.full(200, 25.0), np.zeros((200, 1))
    assert weigh_samples(steep, warm, load, {}) is None
    assert weigh_samples(steep[:10] * 1e3, warm[:10], load[:10], {}) is None


def test_explained_drift_uncovers_outliers_at_jumps(run):
    jumps = np.abs(np.diff(run.reference[:, 0], prepend=0.0)) > 0.0
    bumps = 30.0 * jumps[:, None] * np.random.default_rng(6).uniform(0.3, 1.0, (len(run), 1))
    bumpy = replace(run, measured=run.measured + bumps)
    hit = np.flatnonzero(jumps)[5]
    bumpy.measured[hit, 0] += 25.0
    spared = bumpy.weights[hit, 0]
    noise = np.random.default_rng(7).normal(size=bumps.shape) * 0.5
    beside = replace(bumpy, explained=run.drift + bumps + noise)
    assert spared == 1.0
    assert beside.weights[hit, 0] == 0.0


@pytest.mark.parametrize("samples", [24, 128, 129, 700])
def test_medians_around_few_rows_are_those_of_a_sliding_window(samples):
    distance = np.abs(np.random.default_rng(3).normal(size=samples))
    sliding = _take_nearby(distance, np.arange(samples))
    for row in (0, 1, 12, samples - 2, samples - 1):
        assert _take_nearby(distance, np.array([row])) == sliding[[row]]
    few = np.arange(0, samples, 60)
    assert (_take_nearby(distance, few) == sliding[few]).all()


def test_regression_of_steps_is_that_with_all_rows_weighted():
    """Light rows are taken off the sums of all rows; the sums anew are the same."""
    rng = np.random.default_rng(3)
    signals = np.cumsum(rng.normal(size=(800, 3)), axis=0)
    x = signals @ [0.5, -2.0, 0.1] + np.roll(signals[:, 0], 1) + 0.05 * rng.normal(size=800)
    x[rng.integers(20, 780, 30)] += 40.0
    regression = _prepare(signals)
    steps, target = regression.design, np.diff(x)[regression.rows]
    ridge = 1e-6 * np.eye(steps.shape[1]) * np.mean(steps**2) * regression.rows.size
    factors = np.zeros(steps.shape[1])
    for _ in range(ROUNDS):
        left = np.abs(target - steps @ factors)
        weight = np.minimum(1.0, 1.5 * NORMAL_OF_MAD * np.median(left) / left)
        weighted = steps * weight[:, None]
        factors = np.linalg.solve(weighted.T @ steps + ridge, weighted.T @ target)
    expected = sum(
        np.roll(signals @ part, lag)
        for lag, part in zip(LAGS, np.split(factors, len(LAGS)), strict=True)
    )
    found = _follow(x, signals, regression)
    assert np.abs(found - expected)[4:-4].max() < 1e-8 * np.ptp(x)


def read_coarsely(run):
    """Return the run by a converter of three times the noise, the reference as fine as it is."""
    steps = np.array([1.5, 0.03])
    fine = run.reference + np.random.default_rng(9).normal(size=run.reference.shape) * 1e-3
    return replace(run, measured=np.round(run.measured / steps) * steps, reference=fine)


def test_one_step_off_a_fine_reference_is_no_outlier(run):
    quiet = replace(run, measured=run.measured - run.drift + 0.12 * run.drift)
    coarse = read_coarsely(quiet)
    assert coarse.resolution == pytest.approx([1.5, 0.03])  # the second has three codes in all
    assert coarse.outliers is None
    far = coarse.measured.copy()
    far[1000] += [30.0, 0.6]
    spoilt = replace(coarse, measured=far)
    assert np.flatnonzero((spoilt.weights < 1.0).any(axis=1)).tolist() == [1000]


def test_a_run_that_hardly_moves_has_the_step_of_the_others(run):
    coarse = read_coarsely(run)
    still = replace(coarse, measured=coarse.measured * 0.0)
    assert still.resolution.tolist() == [0.0, 0.0]
    assert share_resolution([coarse, still]) == pytest.approx([1.5, 0.03])
    assert replace(still, output_steps=coarse.resolution).resolution is coarse.resolution
