import numpy as np
import pytest

from zerodrift.diagnosis.evidence import compare_runs, flip_signs


def test_gain_in_every_run_has_the_smallest_p_value_there_is():
    assert flip_signs(np.array([[1.0, 2.0, 1.5, 1.2, 0.9]]))[0] == 2.0**-5


def test_gain_in_half_of_the_runs_is_chance():
    assert flip_signs(np.array([[1.0, -1.0, 1.0, -1.0]]))[0] > 0.5


def test_failure_of_one_candidate_does_not_speak_against_another():
    gains = np.array([[1.0, 2.0, 1.5, 1.2, 0.9], [0.1, -500.0, 0.2, 0.0, 0.1]])
    assert flip_signs(gains)[0] == 2.0**-5


def test_best_of_many_by_chance_is_no_evidence():
    rng = np.random.default_rng(0)
    found = [flip_signs(rng.normal(size=(30, 8))).min() for _ in range(60)]
    # The best of thirty without any effect: below 5 % about as rarely as 5 % says.
    assert np.mean(np.array(found) <= 0.05) <= 0.15


def test_many_runs_are_sampled_and_stay_reproducible():
    gains = np.random.default_rng(1).normal(0.4, 1.0, size=(3, 20))
    assert (flip_signs(gains) == flip_signs(gains)).all()


def test_comparison_of_equals_decides_nothing():
    gains = np.array([1.0, 2.0, 3.0])
    assert compare_runs(gains, gains) == 0.5
    assert compare_runs(gains + 5.0, gains + 0.1 * np.array([1.0, -1.0, 0.5])) < 0.01
    assert compare_runs(np.array([1.0]), np.array([0.0])) == pytest.approx(0.5)
