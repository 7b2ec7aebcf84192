import numpy as np
import pytest

from zerodrift.physics.rails import bridge, find_rails


def draw_signal(noise=0.05):
    rng = np.random.default_rng(3)
    load = 10.0 * np.sin(np.arange(2000) / 60.0)
    return load, load + noise * rng.normal(size=load.size)


def test_clipped_peaks_are_found_and_nothing_else():
    load, measured = draw_signal()
    clipped = np.clip(measured, -8.0, 9.0)
    flags = find_rails(clipped, load)
    assert (flags == (np.abs(clipped - 0.5) >= 8.5 - 1e-9)).all()


def test_unclipped_signal_has_no_rails():
    load, measured = draw_signal()
    assert not find_rails(measured, load).any()


def test_coarse_steps_are_no_rails():
    load, measured = draw_signal()
    assert not find_rails(np.round(measured / 2.0) * 2.0, load).any()


def test_signal_that_never_moves_has_no_rails():
    assert not find_rails(np.full(100, 3.0), np.linspace(0.0, 1.0, 100)).any()


def test_walking_peaks_that_are_cut_are_found():
    rng = np.random.default_rng(4)
    stride = np.clip(np.sin(np.arange(3000) * 2.0 * np.pi / 7.0), 0.0, None)
    load = stride * (1.0 + 0.2 * rng.uniform(size=3000))
    measured = np.minimum(load + 0.01 * rng.normal(size=3000), 0.9)
    assert find_rails(measured, load).sum() == pytest.approx((measured == 0.9).sum())


def test_bridge_draws_straight_lines():
    x = np.array([0.0, 1.0, 9.0, 9.0, 4.0])
    assert bridge(x, np.array([0.0, 0.0, 1.0, 1.0, 0.0])).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert bridge(x, np.ones(5)) is x


def test_drift_alone_can_meet_a_rail():
    rng = np.random.default_rng(5)
    drift = 3.0 * np.sin(np.arange(2000) / 200.0) + 0.05 * rng.normal(size=2000)
    clipped = np.round(np.minimum(drift, 2.9) / 0.02) * 0.02
    flags = find_rails(clipped, np.zeros(2000))
    assert (flags == (clipped >= 2.9 - 0.01)).all()


def test_plateau_of_an_unloaded_log_is_no_rail():
    rng = np.random.default_rng(6)
    drift = np.clip(3.0 * np.sin(np.arange(2000) / 200.0), -2.0, 2.0)
    fine = np.round((drift + 0.05 * rng.normal(size=2000)) / 0.02) * 0.02
    coarse = np.round((drift + 0.001 * rng.normal(size=2000)) / 0.02) * 0.02
    assert not find_rails(fine, np.zeros(2000)).any()
    assert not find_rails(coarse, np.zeros(2000)).any()


def resample(codes, rng):
    """Return samples between two neighbours each, as a log of an uneven clock has them."""
    at = np.arange(codes.size) + rng.uniform(-0.4, 0.4, size=codes.size)
    return np.interp(np.arange(codes.size), at, codes)


@pytest.mark.parametrize("levels", [1.0, 4.0])
def test_mixtures_of_a_coarse_converters_codes_make_no_rail(levels):
    rng = np.random.default_rng(7)
    drift = (levels + 0.4) * np.sin(np.arange(2000) / 300.0)
    for _ in range(10):
        coarse = np.round(drift + 0.35 * rng.normal(size=2000))
        assert not find_rails(resample(coarse, rng), np.zeros(2000)).any()


def test_a_coarse_converter_of_an_uneven_clock_has_rails_too():
    rng = np.random.default_rng(8)
    drift = 6.0 * np.sin(np.arange(2000) / 300.0) + 0.35 * rng.normal(size=2000)
    clipped = resample(np.minimum(np.round(drift), 3.0), rng)
    assert (find_rails(clipped, np.zeros(2000)) == (clipped >= 3.0 - 1e-9)).all()


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_two_codes_are_no_rails_where_the_load_moves_by_less_than_one(noise):
    rng = np.random.default_rng(9)
    coarse = np.round(0.5 + 0.3 * rng.normal(size=600)).clip(0.0, 1.0)
    load = noise * rng.normal(size=600)
    assert not find_rails(resample(coarse, rng), load).any()
