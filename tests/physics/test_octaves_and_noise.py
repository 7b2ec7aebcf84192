import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zerodrift.diagnosis.noise import measure_noise
from zerodrift.physics.reduction import MEANS, cut_octaves


@given(st.lists(st.integers(1, 60), min_size=1, max_size=4))
def test_octaves_are_an_orthonormal_change_of_basis(lengths):
    octaves = cut_octaves(np.array(lengths), 1)
    matrix = np.stack([octaves.transform(row) for row in np.eye(sum(lengths))], axis=1)
    assert np.abs(matrix @ matrix.T - np.eye(sum(lengths))).max() < 1e-12


def test_octaves_keep_pieces_apart_and_end_each_with_its_mean():
    octaves = cut_octaves(np.array([8, 4]), 1)
    x = np.concatenate([np.full(8, 2.0), np.full(4, 5.0)])
    means = octaves.transform(x)[octaves.octave == MEANS]
    assert means == pytest.approx([2.0 * np.sqrt(8), 5.0 * np.sqrt(4)])
    assert np.abs(octaves.transform(x)[octaves.octave != MEANS]).max() < 1e-12


def make_ar(rng, length, memory):
    kick, y = rng.normal(size=length), np.zeros(length)
    ratio = np.exp(-1.0 / memory)
    y[0] = kick[0]
    for n in range(1, length):
        y[n] = ratio * y[n - 1] + np.sqrt(1 - ratio**2) * kick[n]
    return y


def test_noise_of_a_long_record_has_its_rms_and_spectrum():
    rng = np.random.default_rng(4)
    record = np.stack(
        [2.0 * rng.normal(size=40_000), rng.normal(size=40_000) + make_ar(rng, 40_000, 32.0)],
        axis=1,
    )
    noise = measure_noise([record], "dwell")
    assert noise.rms(40_000) == pytest.approx([2.0, np.sqrt(2.0)], rel=0.05)
    white, coloured = noise.variance(np.array([0, 8]), 40_000).T
    assert white == pytest.approx([4.0, 4.0], rel=0.2)
    assert coloured[1] > 10.0 * coloured[0]


def test_noise_is_carried_on_to_octaves_that_the_record_lacks():
    rng = np.random.default_rng(5)
    noise = measure_noise([rng.normal(size=(1000, 1))], "dwell")
    assert noise.variance(np.array([12]), 10_000)[0, 0] == pytest.approx(1.0, rel=0.6)


def test_coarse_octave_that_is_nothing_by_chance_does_not_count_for_all():
    rng = np.random.default_rng(6)
    record = np.round(make_ar(rng, 1024, 8.0))
    # The coarsest coefficient is the difference between the halves; here there is none.
    record[512:] = record[:512][::-1]
    noise = measure_noise([record[:, None]], "dwell")
    assert noise.rms(1024)[0] == pytest.approx(record.std(), rel=0.1)


def test_flicker_grows_slower_than_a_random_walk():
    rng = np.random.default_rng(7)
    frequency = np.fft.rfftfreq(8192)[:, None]
    frequency[0] = frequency[1]
    flicker = np.fft.irfft(
        np.fft.rfft(rng.normal(size=(8192, 6)), axis=0) / np.sqrt(frequency), axis=0
    )[:2048]
    walk = rng.normal(size=(2048, 6)).cumsum(axis=0)
    slow, slower = (measure_noise([x], "dwell").measure_growth(2048) for x in (flicker, walk))
    assert slow == pytest.approx(1.0, abs=0.3)
    assert slower == pytest.approx(1.7, abs=0.2)


def test_octaves_of_known_lengths_are_kept_and_cannot_be_written():
    from zerodrift.physics import reduction

    kept = reduction.cut_octaves(np.array([300, 301]), 2)
    assert reduction.cut_octaves(np.array([300, 301]), 2) is kept
    assert reduction.cut_octaves(np.array([300, 301]), 1) is not kept
    fresh = reduction._cut((300, 301), 2)
    for name in ("start", "middle", "stop", "left", "right", "octave", "piece"):
        assert np.array_equal(getattr(kept, name), getattr(fresh, name))
    with pytest.raises(ValueError, match="read-only"):
        kept.left[0] = 0.0


def test_octaves_of_long_runs_are_not_kept():
    from zerodrift.physics import reduction

    long = np.array([reduction.MOST_KEPT + 1])
    assert reduction.cut_octaves(long, 1) is not reduction.cut_octaves(long, 1)
