"""Starts of a search that are passed over, and products that are computed together."""

import numpy as np
import pytest
from tests.physics.conftest import FULL_SCALE, OUTPUTS, follow, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.physics import search as module
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import flat_weights
from zerodrift.physics.search import (
    assess,
    assess_all,
    find_promising,
    grid,
    list_coordinates,
    search,
    set_coordinates,
)
from zerodrift.physics.signals import plan_signals
from zerodrift.physics.terms import start_term

KINDS = ("zero_tempco", "dark_current", "thermal_lag")


def late_and_dark(bench):
    late = follow(bench.temperature, 70.0)
    return linear(bench) + (2.0 ** ((late - 25.0) / 9.3))[:, None] * np.array([-6.0, 0.05])


def pose(runs, tared, **named):
    dataset = make_dataset(late_and_dark, runs=runs)
    plan = plan_signals(dataset.train, OUTPUTS, FULL_SCALE)
    catalogue = load_catalogue()
    terms = [start_term(catalogue, EffectConfig(kind)) for kind in KINDS]
    campaign = Campaign(dataset.train, plan, tuple(catalogue), tared=tared, **named)
    coordinates = list_coordinates(terms)
    choices = [set_coordinates(terms, coordinates, np.array(u)) for u in grid(coordinates)]
    return campaign, [terms, *choices]


@pytest.mark.parametrize(("runs", "tared"), [(2, True), (2, False), (4, False)])
def test_the_best_starts_are_among_the_promising(runs, tared):
    campaign, choices = pose(runs, tared)
    weights = flat_weights(campaign)
    costs = [found.cost for found in assess_all(campaign, choices, weights)]
    promising = find_promising(campaign, choices, weights, 2)
    assert promising is not None and len(promising) < len(choices)
    assert set(np.argsort(costs, kind="stable")[:2]) <= set(promising)


@pytest.mark.parametrize("blocks", [{"most_rows": 200}, {}])
def test_where_it_cannot_be_told_all_starts_are_looked_at(blocks):
    campaign, choices = pose(4, True, **blocks)  # the means of so many runs have no weight
    assert find_promising(campaign, choices, flat_weights(campaign), 2) is None


def test_a_search_ends_where_it_does_without_a_shortlist(monkeypatch):
    found = []
    for shortlist in (find_promising, lambda *_: None):
        monkeypatch.setattr(module, "find_promising", shortlist)
        campaign, choices = pose(2, True)
        found.append(search(campaign, choices[0], flat_weights(campaign)))
    assert found[0].cost == found[1].cost
    assert [t.values for t in found[0].terms] == [t.values for t in found[1].terms]


def test_starts_that_are_solved_together_have_the_bits_of_each_alone():
    campaign, choices = pose(2, True)
    weights = flat_weights(campaign)
    for terms, together in zip(choices, assess_all(campaign, choices, weights), strict=True):
        alone = assess(Campaign(campaign.runs, campaign.plan, campaign.order), terms, weights)
        assert alone.cost == together.cost
        assert np.array_equal(alone.sums.products, together.sums.products)
        assert np.array_equal(alone.solution.coefficients, together.solution.coefficients)


def test_pieces_that_are_cut_alike_have_the_products_of_each_alone():
    reduction = pose(2, True)[0].reduction
    columns = np.random.default_rng(2).normal(size=(7, reduction.octaves.left.size))
    products = reduction.sum_products(columns, [None] * len(columns))
    for piece, level, rows in reduction.slices:
        part = columns[:, rows]
        assert np.array_equal(products[piece, level], part @ part.T)


def test_a_campaign_that_shares_columns_gives_what_one_of_its_own_gives():
    campaign, choices = pose(2, True)
    weights = flat_weights(campaign)
    assess_all(campaign, choices, weights)
    shared = campaign.share(tared=False)
    own = Campaign(campaign.runs, campaign.plan, campaign.order, tared=False)
    for one, other in zip(
        assess_all(shared, choices, weights), assess_all(own, choices, weights), strict=True
    ):
        assert one.cost == other.cost
        assert np.array_equal(one.sums.products, other.sums.products)


def test_a_second_start_ends_where_the_first_one_did(monkeypatch):
    found, looks = [], []
    count = module.assess
    monkeypatch.setattr(module, "assess", lambda *given: looks.append(len(found)) or count(*given))
    for near, same in ((module.NEAR, module.SAME), (0.0, -1.0)):
        monkeypatch.setattr(module, "NEAR", near)
        monkeypatch.setattr(module, "SAME", same)
        campaign, choices = pose(2, True)
        found.append(search(campaign, choices[0], flat_weights(campaign)))
    assert found[0].cost == pytest.approx(found[1].cost, abs=1e-6)
    for one, other in zip(found[0].terms, found[1].terms, strict=True):
        assert one.values == pytest.approx(other.values, rel=1e-5)
    assert looks.count(0) < looks.count(1)
