"""Cadences that change, jitter and bursts become one period where the rows allow it."""

import numpy as np
import pytest

from zerodrift.dataset.sampling import look_at_sampling, plan_stretches


def make_times(*parts: tuple[int, float], jitter: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return times of rows, each part of so many at such an interval."""
    steps = np.concatenate([np.full(rows, period_s) for rows, period_s in parts])
    noise = np.random.default_rng(seed).uniform(-jitter, jitter, steps.size)
    return np.cumsum(steps * (1 + noise))


def write(project, time_s):
    rows = [
        [repr(float(t)), repr(20 + 1e-3 * float(t)), repr(2e-3 * float(t)), "0.0"] for t in time_s
    ]
    project.write_log(rows)


@pytest.mark.parametrize("jitter", [0.0, 0.05, 0.2])
def test_change_of_cadence_below_the_step_is_read_and_told(project, jitter):
    time_s = make_times((400, 28.0), (400, 43.0), jitter=jitter)
    write(project, time_s)
    dataset = project.load(sample_period_s=60.0)
    (run,) = dataset.train
    assert len(run) == pytest.approx(np.ptp(time_s) / 60, abs=1)
    # Rising lines: a mean over a period is at most a period and a row behind.
    behind = 20 + 1e-3 * run.time_s - run.temperature_degC
    assert behind.min() >= 0 and behind.max() < 1e-3 * (30 + 43 * (1 + jitter))
    notes = "\n".join(dataset.notes)
    assert "the sample period changes from 2" in notes
    assert "rows in a step, whose noise differs by up to 1." in notes


@pytest.mark.parametrize("second", [0.2, 2.0, 10.0])
def test_change_of_cadence_is_found_where_it_is(second):
    sampling = look_at_sampling(make_times((400, 1.0), (400, second), jitter=0.05), 10.0)
    (_, first_s), (row, second_s) = sampling.cadences
    assert abs(row - 400) <= 2
    assert (first_s, second_s) == pytest.approx((1.0, second), rel=0.02)


def test_slow_part_with_jitter_is_no_gap(project):
    write(project, make_times((2000, 1.0), (500, 10.0), jitter=0.05))
    assert len(project.load(sample_period_s=10.0).train) == 1


def test_gap_in_the_slow_part_is_one(project):
    time_s = make_times((2000, 1.0), (500, 10.0), jitter=0.05)
    time_s[2300:] += 35.0
    write(project, time_s)
    assert len(project.load(sample_period_s=10.0).train) == 2


def make_bursts(bursts: int, every_s: float, rows: int, within_s: float) -> np.ndarray:
    starts = every_s * np.arange(bursts)
    return (starts[:, None] + within_s * np.arange(rows)).ravel()


def test_bursts_are_taken_as_their_means(project):
    time_s = make_bursts(50, 60.0, 10, 0.1)
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.1, time_s.size)
    rows = [
        [f"{t:.2f}", repr(20 + 1e-3 * float(t)), repr(float(n)), "0"]
        for t, n in zip(time_s, noise, strict=True)
    ]
    project.write_log(rows)
    dataset = project.load(sample_period_s=60.0)
    (run,) = dataset.train
    assert len(run) == 50
    np.testing.assert_allclose(run.time_s, 0.45 + 60 * np.arange(50), atol=1e-9)
    np.testing.assert_allclose(run.measured[:, 0], noise.reshape(50, 10).mean(axis=1), atol=1e-12)
    assert "rows come in bursts of 10 every 60 s; each is taken as its mean" in dataset.notes[0]


def test_bursts_that_are_farther_apart_than_the_step_are_stretches():
    time_s = make_bursts(10, 600.0, 300, 1.0)
    stretches, gaps = plan_stretches(time_s, 0, time_s.size, 1.0)
    assert len(stretches) == 10 and len(gaps) == 9


def test_gap_between_bursts_ends_a_stretch():
    time_s = make_bursts(60, 60.0, 5, 0.5)
    time_s[100:] += 900.0
    stretches, gaps = plan_stretches(time_s, 0, time_s.size, 60.0)
    assert gaps == [99]
    assert [(each.start, each.stop) for each in stretches] == [(0, 100), (100, 300)]


@pytest.mark.parametrize("lost", [0.01, 0.2])
def test_lost_rows_are_neither_bursts_nor_a_change_of_cadence(lost):
    rng = np.random.default_rng(1)
    time_s = np.arange(20_000.0)[rng.random(20_000) > lost]
    sampling = look_at_sampling(time_s, 1.0)
    assert sampling.bursts is None and len(sampling.cadences) == 1
