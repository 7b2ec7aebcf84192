"""One long run without a dwell: slow memory is named, wandering is not."""

import numpy as np
import pytest
from benchmarks.bench_slow import THERMAL, draw_record

from zerodrift.base.config import EffectConfig
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.evidence import Errors, compare_likelihoods
from zerodrift.physics.reduction import MEANS

TEMPCO = [EffectConfig("zero_tempco")]


@pytest.mark.spread(1, "seed", [900, 901, 902, 903])
def test_slow_memory_of_one_run_is_named_with_its_time_constant(seed):
    dataset, tau_s, length_s = draw_record("memory", seed, 5.0)
    found = diagnose(TEMPCO, dataset)
    assert (found.verdict, found.effect) == ("missing", "thermal_lag")
    assert length_s / 70.0 < tau_s < length_s / 5.0
    told = found.parameters
    assert told.get("time_constants", 1) == 2 or abs(told["tau_s"] / tau_s - 1.0) < 0.1


@pytest.mark.parametrize("kind", ["random_walk", "flicker", "ageing", "complete"])
@pytest.mark.spread(1, "seed", [900, 901, 902])
def test_slow_noise_of_one_run_is_no_thermal_effect(kind, seed):
    found = diagnose(TEMPCO, draw_record(kind, seed, 5.0)[0])
    assert not {found.effect, *found.lookalikes} & THERMAL


def make_errors(slow, fast):
    """One piece, one output: 8 slow coefficients and a mean, 64 fast ones."""
    squares = np.array([[[slow], [fast], [slow]]])
    return Errors(squares, np.array([[8.0, 64.0, 1.0]]))


def test_likelihood_counts_by_how_much_each_band_falls():
    levels = np.array([5, 1, MEANS])
    none = np.zeros(3, dtype=np.bool_)
    before, after = make_errors(90.0, 64.0), make_errors(9.0, 64.0)
    # The mean is too few and joins the slowest octave: 9 coefficients fall by a factor of 10.
    gain = compare_likelihoods(before, after, levels, none)
    assert gain == pytest.approx(0.5 * 9.0 * np.log(10.0))
    assert compare_likelihoods(after, before, levels, none) == pytest.approx(-gain)
    without_means = np.array([False, False, True])
    gain = compare_likelihoods(before, after, levels, without_means)
    assert gain == pytest.approx(0.5 * 8.0 * np.log(10.0))
