"""Resampling: bit-exact where it can be, causal means where it must, never across a gap."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from zerodrift.dataset.sampling import MIN_STEPS, plan_average, plan_stretches


def average_slowly(time_s, values, last_width_s, edges_s):
    """Return the means by the definition: each sample counts until the next one."""
    ends_s = np.append(time_s[1:], time_s[-1] + last_width_s)
    means = []
    for begin_s, end_s in itertools.pairwise(edges_s):
        overlap_s = np.minimum(ends_s, end_s) - np.maximum(time_s, begin_s)
        weights = np.maximum(overlap_s, 0)
        means.append(float(weights @ values) / (end_s - begin_s))
    return np.array(means)


def make_log(rng, count, period_s, jitter):
    """Return rising times with jitter (a share of the period) and values without a pattern."""
    interval_s = period_s * (1 + jitter * rng.uniform(-1, 1, count))
    return 100 + np.cumsum(interval_s), rng.normal(20, 5, count)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(30, 300),
    ratio=st.floats(1.2, 12),
    jitter=st.floats(0, 0.9),
)
def test_average_equals_its_definition_for_any_jitter_and_ratio(seed, count, ratio, jitter):
    time_s, values = make_log(np.random.default_rng(seed), count, 1 / ratio, jitter)
    (stretch, *_), _ = plan_stretches(time_s, 0, count, 1.0)
    median_s = float(np.median(np.diff(time_s)))
    edges_s = time_s[0] + np.arange(stretch.steps + 1)
    # Strong jitter may lift the median interval of a short log to nearly a step.
    assume(stretch.method == "averaged")
    # The last sample counts a hair longer, by what the count of periods allows for rounding.
    expected = average_slowly(time_s, values, median_s + 2e-6, edges_s)
    np.testing.assert_allclose(stretch.resample(values), expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(stretch.time_s, edges_s[1:], rtol=0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    ratio=st.floats(1.2, 12),
    jitter=st.floats(0, 0.9),
    share=st.floats(0.1, 0.9),
)
def test_average_holds_nothing_recorded_after_its_step(seed, ratio, jitter, share):
    time_s, values = make_log(np.random.default_rng(seed), 200, 1 / ratio, jitter)
    (stretch, *_), _ = plan_stretches(time_s, 0, 200, 1.0)
    assume(stretch.method == "averaged")
    now_s = stretch.time_s[int(share * (stretch.steps - 1))]
    changed = values + 1e6 * (time_s > now_s)
    is_past = stretch.time_s <= now_s
    before, after = stretch.resample(values), stretch.resample(changed)
    assert np.array_equal(before[is_past], after[is_past])
    assert not np.array_equal(before, after)


@settings(max_examples=30, deadline=None)
@given(value=st.floats(-1e6, 1e6), ratio=st.floats(1.2, 12), jitter=st.floats(0, 0.9))
def test_average_of_a_constant_is_that_constant_to_the_bit(value, ratio, jitter):
    time_s, _ = make_log(np.random.default_rng(1), 200, 1 / ratio, jitter)
    (stretch, *_), _ = plan_stretches(time_s, 0, 200, 1.0)
    assert np.all(stretch.resample(np.full(200, value)) == value)


def test_average_of_ten_samples_is_their_mean():
    time_s = np.arange(1000) / 10
    values = np.random.default_rng(3).normal(25, 3, 1000)
    (stretch,), gaps = plan_stretches(time_s, 0, 1000, 1.0)
    assert (stretch.method, stretch.steps, gaps) == ("averaged", 100, [])
    np.testing.assert_allclose(
        stretch.resample(values), values.reshape(100, 10).mean(axis=1), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(stretch.time_s, np.arange(1, 101), rtol=0, atol=1e-9)


def test_average_keeps_the_last_period_despite_rounding():
    # 93 samples of 0.1 s are 31 periods of 0.3 s, though in floats 9.2 + 0.1 < 31 * 0.3.
    time_s = np.array([float(f"{k / 10:.1f}") for k in range(93)])
    (stretch,), _ = plan_stretches(time_s, 0, 93, 0.3)
    assert stretch.steps == 31


def test_average_worked_by_hand():
    # Samples at 0, 0.4, 0.8, ... counting 0.4 s each; the second period starts within the third.
    time_s = np.array([0.0, 0.4, 0.8, 1.2, 1.6])
    plan = plan_average(time_s, 0.4, np.array([1.0, 2.0]), 1.0)
    values = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    # 0.4*10 + 0.4*20 + 0.2*30 = 18; 0.2*30 + 0.4*40 + 0.4*50 = 42
    np.testing.assert_allclose(plan.average(values), [18.0, 42.0], rtol=1e-12)


def test_average_holds_one_sample_through_a_whole_period():
    # The sample at 0.8 counts until 2.9: nothing else falls into the second and third period.
    time_s = np.array([0.0, 0.4, 0.8, 2.9])
    plan = plan_average(time_s, 0.4, np.array([1.0, 2.0, 3.0]), 1.0)
    means = plan.average(np.array([10.0, 20.0, 30.0, 40.0]))
    # 0.4*10 + 0.4*20 + 0.2*30 = 18; 30; 0.9*30 + 0.1*40 = 31
    np.testing.assert_allclose(means, [18.0, 30.0, 31.0], rtol=1e-12)
    plan = plan_average(time_s[:3], 2.2, np.array([1.0, 2.0, 3.0]), 1.0)
    np.testing.assert_allclose(plan.average(np.array([10.0, 20.0, 30.0])), [18, 30, 30], rtol=1e-12)


def test_average_composes_in_two_stages():
    values = np.random.default_rng(4).normal(0, 1, 1200)
    (fine,), _ = plan_stretches(np.arange(1200) / 10, 0, 1200, 1.2)
    half_s = np.arange(300) * 0.4
    halves = values.reshape(300, 4).mean(axis=1)
    (coarse,), _ = plan_stretches(half_s, 0, 300, 1.2)
    np.testing.assert_allclose(fine.resample(values), coarse.resample(halves), rtol=0, atol=1e-9)


@pytest.mark.parametrize("period_s", [0.1, 1.0, 256.0])
def test_uniform_log_passes_bit_for_bit(period_s):
    # Times as a logger writes them: rounded to the millisecond, by text.
    time_s = np.array([float(f"{17.3 + k * period_s:.3f}") for k in range(500)])
    values = np.random.default_rng(5).normal(0, 1, 500)
    (stretch,), _ = plan_stretches(time_s, 0, 500, period_s)
    assert stretch.method == "kept"
    assert stretch.resample(values).tobytes() == values.tobytes()
    assert stretch.time_s[0] == time_s[0]
    np.testing.assert_allclose(stretch.time_s, time_s, rtol=0, atol=0.001)


def test_jitter_is_interpolated_on_the_actual_times():
    rng = np.random.default_rng(6)
    time_s = np.arange(400) + rng.uniform(-0.3, 0.3, 400)
    (stretch,), _ = plan_stretches(time_s, 0, 400, 1.0)
    assert stretch.method == "interpolated"
    # A ramp tells whether a value belongs to its time.
    np.testing.assert_allclose(stretch.resample(3 * time_s - 7), 3 * stretch.time_s - 7, atol=1e-9)
    assert np.ptp(np.diff(stretch.time_s)) < 1e-9


def test_up_to_two_lost_rows_are_bridged_and_three_are_a_gap():
    time_s = np.arange(100.0)
    lost_two = np.delete(time_s, [40, 41])
    stretches, gaps = plan_stretches(lost_two, 0, lost_two.size, 1.0)
    assert ([s.steps for s in stretches], gaps) == ([100], [])
    lost_three = np.delete(time_s, [40, 41, 42])
    stretches, gaps = plan_stretches(lost_three, 0, lost_three.size, 1.0)
    assert ([s.steps for s in stretches], gaps) == ([40, 57], [39])
    assert [(s.start, s.stop) for s in stretches] == [(0, 40), (40, 97)]


def test_a_gap_shorter_than_a_step_is_none():
    time_s = np.delete(np.arange(1000) / 10, slice(500, 508))
    stretches, gaps = plan_stretches(time_s, 0, time_s.size, 1.0)
    assert (len(stretches), gaps) == (1, [])
    assert plan_stretches(time_s, 0, time_s.size, 0.5)[1] == [499]


def test_stretches_of_a_log_are_cut_from_its_own_rows():
    time_s = np.concatenate([np.arange(50.0), 200 + np.arange(50.0)])
    values = np.arange(100.0)
    first, second = plan_stretches(time_s, 0, 100, 1.0)[0]
    assert np.array_equal(first.resample(values), np.arange(50.0))
    assert np.array_equal(second.resample(values), np.arange(50.0, 100.0))
    assert second.time_s[0] == 200
    assert first.steps >= MIN_STEPS
