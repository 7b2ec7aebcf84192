"""Columns of a campaign: what is kept is what would be computed anew."""

import pytest
from tests.physics.conftest import linear, make_dataset

from zerodrift.physics.campaign import Campaign
from zerodrift.physics.signals import plan_signals


@pytest.fixture
def campaign():
    dataset = make_dataset(linear, runs=3)
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    return Campaign(dataset.train, plan, (), most_rows=200)


def test_columns_of_fast_signals_are_computed_once_in_both_searches(campaign):
    stepped = campaign.ops.lowpass(campaign.ops.input("load:Fz"), 60.0)
    exact = campaign.column(stepped)
    with campaign.rates.search_roughly():
        assert campaign.column(stepped) is exact


def test_columns_on_block_means_are_not_taken_for_those_on_all_samples(campaign):
    slow = campaign.ops.lowpass(campaign.ops.input("temperature_degC"), 60.0)
    with campaign.rates.search_roughly():
        rough = campaign.column(slow)
        assert campaign.rates.find_fast(slow) == ()
    assert campaign.rates.find_fast(slow) == (0, 1, 2)
    assert (campaign.column(slow).octaves != rough.octaves).any()
