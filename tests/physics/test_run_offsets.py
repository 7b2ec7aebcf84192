"""Offsets of runs that follow the clock are ageing; offsets at random, steps and a tare are not."""

from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import linear, make_dataset
from tests.physics.test_offsets import DAY_S, shifted

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.physics.fit import TREND_BY_CHANCE, fit, weigh_trend

DAYS = np.array([0.0, 2.1, 3.0, 5.5, 6.2, 9.0, 11.3, 12.0])


def on_days(dataset: Dataset, days: np.ndarray) -> Dataset:
    """Return the dataset, its runs on these days."""
    train = tuple(
        replace(run, inputs={**run.inputs, "clock": run.time_s + DAY_S * day})
        for run, day in zip(dataset.train, days, strict=True)
    )
    dwell = tuple(replace(d, inputs={**d.inputs, "clock": d.time_s}) for d in dataset.dwell)
    return replace(dataset, train=train, dwell=dwell)


@pytest.mark.parametrize("runs", [4, 5, 8])
@pytest.mark.parametrize("law", [lambda t: t, lambda t: np.log(t + 1.5)])
def test_offsets_by_a_law_of_the_clock_are_a_trend_in_their_order_alone(runs, law):
    days = DAYS[:runs]
    trend = weigh_trend(law(days)[:, None], days)
    assert trend.is_real
    assert trend.share < 0.01
    mixed = np.roll(np.arange(runs), 2)
    assert not weigh_trend(law(days)[mixed][:, None], days).is_real


@pytest.mark.long
def test_chance_is_as_often_as_it_is_said():
    """Offsets at random, normal or heavy-tailed, are a trend no more often than TREND_BY_CHANCE."""
    rng = np.random.default_rng(11)
    draws = 200
    for sample in (rng.normal, lambda size: rng.standard_t(2.0, size=size)):
        found = 0
        for _ in range(draws):
            runs = int(rng.integers(4, 13))
            days = np.cumsum(rng.uniform(0.3, 3.0, runs))
            found += weigh_trend(sample(size=(runs, 2)), days).is_real
        # Were TREND_BY_CHANCE true, five or more of 200 would come in fewer than 1 of 250 trials.
        assert found <= 4, (found, draws * TREND_BY_CHANCE)


def test_one_run_that_is_off_and_a_step_are_no_trend():
    off = np.zeros((8, 1))
    off[0] = 9.0
    assert not weigh_trend(off, DAYS).is_real
    step = (np.arange(8.0) >= 4.0)[:, None]
    assert not weigh_trend(step, DAYS).is_real


def test_two_runs_and_runs_at_one_time_tell_nothing():
    assert not weigh_trend(np.array([[0.0], [5.0]]), DAYS[:2]).is_real
    assert not weigh_trend(np.arange(4.0)[:, None], np.full(4, 7.0)).is_real


@pytest.mark.spread(0, "runs", [5, 8])
def test_ageing_by_a_logarithm_is_named_and_kept(tempco, runs):
    """No line and no power leaves the noise: the runs would still have offsets of their own."""
    days = DAYS[:runs]
    age = 60.0 * np.log(days + 0.5)
    dataset = on_days(make_dataset(linear, length=300, runs=runs, tared=False), days)
    dataset = shifted(dataset, age)
    diagnosis = diagnose(tempco, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "ageing")
    assert any("offsets follow the clock" in remark for remark in diagnosis.remarks)

    def fit_with(*kinds: EffectConfig):
        return fit(
            [*tempco, *kinds],
            dataset.train,
            outputs=dataset.outputs,
            units=dataset.units,
            full_scale=dataset.full_scale,
        )

    assert fit_with().tared
    assert not fit_with(EffectConfig("ageing")).tared


def test_a_tare_that_the_project_states_is_no_trend(tempco):
    dataset = on_days(make_dataset(linear, length=300, tared=False), DAYS)
    dataset = shifted(dataset, 60.0 * np.log(DAYS + 0.5))
    told = replace(dataset, train=tuple(replace(run, tared=True) for run in dataset.train))
    diagnosis = diagnose(tempco, told)
    assert diagnosis.effect != "ageing"
    assert not any("offsets follow the clock" in remark for remark in diagnosis.remarks)


def test_offsets_of_a_model_with_ageing_that_follow_no_clock_stay_a_tare(tempco):
    dataset = on_days(make_dataset(linear, length=300, tared=False), DAYS)
    dataset = shifted(dataset, [3, -9, 7, -2, -8, 9, 1, -5])
    model = fit(
        [*tempco, EffectConfig("ageing")],
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
    )
    assert model.tared
