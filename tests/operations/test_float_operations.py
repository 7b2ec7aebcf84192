import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zerodrift.operations.affine import affine
from zerodrift.operations.clip import clip
from zerodrift.operations.delay import delay, delay_taps
from zerodrift.operations.difference import difference
from zerodrift.operations.exp2 import exp2
from zerodrift.operations.lowpass import lowpass, lowpass_coefficients, lowpass_slope
from zerodrift.operations.play import play
from zerodrift.operations.power import power
from zerodrift.operations.product import product
from zerodrift.operations.total import total


def walk_play(x, half_width):
    """The play operator as its definition reads, sample by sample."""
    y = np.empty_like(x)
    y[0] = x[0]
    for n in range(1, x.size):
        y[n] = min(max(y[n - 1], x[n] - half_width), x[n] + half_width)
    return y


def test_lowpass_of_a_ramp_is_exact_at_any_step():
    # tau y' + y = t with y(0) = 0 has the answer y = t - tau (1 - exp(-t/tau)).
    tau_s = 7.0
    for step_s in (0.1, 1.0, 5.0, 20.0):
        t = np.arange(0.0, 100.0, step_s)
        expected = t - tau_s * (1.0 - np.exp(-t / tau_s))
        assert np.abs(lowpass(t, step_s, tau_s) - expected).max() < 1e-9


def test_lowpass_starts_at_rest():
    assert np.allclose(lowpass(np.full(50, 3.7), 1.0, 12.0), 3.7, rtol=0, atol=1e-12)


def test_lowpass_without_time_constant_passes_the_input():
    x = np.array([1.0, -2.0, 5.0])
    assert (lowpass(x, 1.0, 0.0) == x).all()


def test_lowpass_of_rows_is_that_of_each_row():
    x = np.random.default_rng(1).normal(size=(3, 40)).cumsum(axis=1)
    rows = np.stack([lowpass(row, 0.5, 9.0) for row in x])
    assert (lowpass(x, 0.5, 9.0) == rows).all()


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 1e6))
def test_lowpass_coefficients_sum_to_one(sample_period_s, tau_s):
    a, b0, b1 = lowpass_coefficients(sample_period_s, tau_s)
    assert math.isclose(a + b0 + b1, 1.0, abs_tol=1e-9)
    assert a >= 0.0
    assert b0 >= -1e-9


def test_lowpass_slope_is_the_derivative():
    t = np.arange(0.0, 400.0)
    x = np.sin(t / 40.0) + 0.01 * t
    tau_s, step_s = 30.0, 1e-3
    numeric = (lowpass(x, 1.0, tau_s + step_s) - lowpass(x, 1.0, tau_s - step_s)) / (2 * step_s)
    y = lowpass(x, 1.0, tau_s)
    assert np.abs(lowpass_slope(x, y, 1.0, tau_s) - numeric).max() < 1e-3 * np.abs(numeric).max()


def test_play_by_hand():
    x = np.array([0.0, 1.0, 3.0, 2.0, 0.0, -3.0, 0.0])
    assert play(x, 1.0).tolist() == [0.0, 0.0, 2.0, 2.0, 1.0, -2.0, -1.0]


@given(st.integers(1, 300), st.floats(0.01, 5.0), st.integers(0, 1000))
def test_play_equals_its_definition(length, half_width, seed):
    x = np.random.default_rng(seed).normal(size=length).cumsum()
    assert (play(x, half_width) == walk_play(x, half_width)).all()


@given(st.integers(1, 300), st.floats(0.01, 5.0), st.floats(0.0, 0.3), st.integers(0, 1000))
def test_play_of_plateaus_equals_its_definition(length, half_width, share, seed):
    random = np.random.default_rng(seed)
    moves = random.normal(size=(3, length)) * (random.random((3, length)) < share)
    x = moves.cumsum(axis=1)
    assert (play(x, half_width) == np.stack([walk_play(row, half_width) for row in x])).all()


def test_play_of_rows_is_that_of_each_row():
    x = np.random.default_rng(2).normal(size=(4, 101)).cumsum(axis=1)
    assert (play(x, 1.5) == np.stack([walk_play(row, 1.5) for row in x])).all()


def test_play_without_width_passes_the_input():
    x = np.array([1.0, -2.0, 5.0])
    assert (play(x, 0.0) == x).all()


def test_delay_by_whole_and_broken_steps():
    x = np.array([0.0, 10.0, 20.0, 30.0])
    assert delay(x, 0.5, 0.5).tolist() == [0.0, 0.0, 10.0, 20.0]
    assert delay(x, 1.0, 0.25).tolist() == [0.0, 7.5, 17.5, 27.5]
    assert delay(x, 1.0, 9.0).tolist() == [0.0, 0.0, 0.0, 0.0]


def test_delay_taps_split_steps_and_share():
    assert delay_taps(1.0, 3.0) == (3, 0.0)
    whole, share = delay_taps(0.1, 0.25)
    assert whole == 2
    assert share == pytest.approx(0.5)


def test_delay_keeps_rows_apart():
    x = np.array([[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]])
    assert delay(x, 1.0, 1.0).tolist() == [[1.0, 1.0, 2.0], [7.0, 7.0, 8.0]]


def test_exp2_doubles_and_is_limited():
    assert exp2(np.array([-1.0, 0.0, 3.0])).tolist() == [0.5, 1.0, 8.0]
    assert np.isfinite(exp2(np.array([1e9, -1e9]))).all()


def test_power_takes_negative_numbers_to_whole_powers_only():
    x = np.array([-2.0, 0.0, 2.0])
    assert power(x, 3.0).tolist() == [-8.0, 0.0, 8.0]
    assert power(x, 0.5).tolist() == [0.0, 0.0, math.sqrt(2.0)]


def test_plain_operations_by_hand():
    a, b = np.array([1.0, 2.0]), np.array([3.0, -4.0])
    assert total(a, b).tolist() == [4.0, -2.0]
    assert difference(a, b).tolist() == [-2.0, 6.0]
    assert product(a, b).tolist() == [3.0, -8.0]
    assert affine(a, 2.0, -1.0).tolist() == [1.0, 3.0]
    assert clip(b, -1.0, 1.0).tolist() == [1.0, -1.0]
