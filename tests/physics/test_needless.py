"""The model's own effects: one that costs more than it brings on runs left out is told."""

import numpy as np
from tests.physics.conftest import SLOPE, follow, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.diagnosis.revision import list_needless
from zerodrift.physics.catalogue import load_catalogue

MODEL = (EffectConfig("zero_tempco"), EffectConfig("thermal_lag"))


def test_effects_that_help_are_needed():
    def lagging(bench):
        return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE

    dataset = make_dataset(lagging, runs=4, length=300)
    assert list_needless(MODEL, dataset, load_catalogue()) == ()


def test_effect_that_follows_nothing_is_needless():
    def wandering(bench):
        """A drift of its own in each run, which the few runs' temperatures imitate."""
        share = np.linspace(-1.0, 1.0, bench.time_s.size)
        return bench.rng.choice([-30.0, 30.0]) * share[:, None] * SLOPE

    dataset = make_dataset(wandering, runs=4, length=300)
    assert "zero_tempco" in list_needless(MODEL[:1], dataset, load_catalogue())
    needed = make_dataset(linear, runs=4, length=300)
    assert list_needless(MODEL[:1], needed, load_catalogue()) == ()
