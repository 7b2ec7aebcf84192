"""What a recipe accepts, and what it says to what it refuses."""

import json

import pytest

from zerodrift.base.config import NETWORK_KINDS
from zerodrift.base.errors import InputError
from zerodrift_lab.twin import EffectChoice, Recipe, parse_choice, simulate
from zerodrift_lab.twin.recipe import (
    LISTED_EFFECTS,
    NETWORKS,
    check_recipe,
    draw_mystery,
    expand_channels,
    recipe_from_dict,
    recipe_to_dict,
)

CATALOGUE = {
    "zero_tempco",
    "dark_current",
    "span_tempco",
    "thermal_lag",
    "thermal_gradient",
    "warm_up",
    "thermal_hysteresis",
    "creep",
    "load_hysteresis",
    "load_nonlinearity",
    "crosstalk",
    "supply_sensitivity",
    "humidity",
    "ambient_light",
    "inertial_load",
    "ageing",
    "clock_delay",
    "adc_saturation",
}


def test_listed_effects_are_those_of_the_catalogue():
    assert set(LISTED_EFFECTS) == CATALOGUE


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("creep", EffectChoice("creep")),
        ("creep=1.5", EffectChoice("creep", 1.5)),
        ("creep=tau_s:300", EffectChoice("creep", None, {"tau_s": 300.0})),
        ("creep=2,tau_s:300", EffectChoice("creep", 2.0, {"tau_s": 300.0})),
    ],
)
def test_choice_is_parsed(text, expected):
    assert parse_choice(text) == expected


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (Recipe(hidden=(EffectChoice("thermal_lagg"),)), "did you mean 'thermal_lag'"),
        (Recipe(hidden=(EffectChoice("dark_current"),)), "either told or hidden"),
        (Recipe(told=(EffectChoice("beat"),)), "no effect to tell the model 'beat'"),
        (Recipe(hidden=(EffectChoice("creep", None, {"tau": 3.0}),)), "did you mean 'tau_s'"),
        (Recipe(hidden=(EffectChoice("creep", None, {"tau_s": -3.0}),)), "tau_s is -3; expected"),
        (Recipe(hidden=(EffectChoice("creep", -1.0),)), "size is -1; expected above 0"),
        (
            Recipe(hidden=(EffectChoice("thermal_lag", None, {"slow_tau_s": 300.0}),)),
            "slow_tau_s and slow_share belong together",
        ),
        (Recipe(train=("chambre",)), "did you mean 'chamber'"),
        (Recipe(train=()), "no run to train on"),
        (Recipe(channels=("suply",)), "did you mean 'supply'"),
        (Recipe(tare="begin"), "Known: start, none"),
        (Recipe(sample_period_s=0.0), "sample period in s is 0; expected 0.001 to 60"),
        (Recipe(duration_s=10.0), "duration in s is 10; expected 300"),
        (Recipe(network="rnn"), "no kind of network 'rnn'"),
    ],
)
def test_unusable_recipe_is_refused_with_what_was_expected(recipe, message):
    with pytest.raises(InputError) as caught:
        check_recipe(recipe)
    assert message in str(caught.value)


@pytest.mark.parametrize("text", ["creep=big", "creep=tau_s:long", "creep=2,,3"])
def test_malformed_choice_is_refused_with_the_forms(text):
    with pytest.raises(InputError, match="NAME=tau_s:60"):
        parse_choice(text)


def test_told_base_drift_with_a_size_is_refused():
    recipe = Recipe(train=("heating",), dwell=False, told=(EffectChoice("zero_tempco", 3.0),))
    with pytest.raises(InputError, match="told zero_tempco takes no size"):
        simulate(recipe)


def test_effect_without_what_it_depends_on_is_refused():
    recipe = Recipe(train=("heating",), dwell=False, hidden=(EffectChoice("creep"),))
    with pytest.raises(InputError, match="creep does nothing in these runs"):
        simulate(recipe)


def test_unreachable_size_is_refused_with_what_is_reached():
    recipe = Recipe(train=("heating",), dwell=False, hidden=(EffectChoice("adc_saturation", 5e3),))
    with pytest.raises(InputError, match="cannot reach size 5000"):
        simulate(recipe)


def test_recipe_survives_json():
    recipe = Recipe(
        seed=7,
        train=("chamber", "walking"),
        hidden=(EffectChoice("creep", 2.0, {"tau_s": 300.0}), EffectChoice("beat")),
        channels=("supply",),
    )
    assert recipe_from_dict(json.loads(json.dumps(recipe_to_dict(recipe))), "x.json") == recipe


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({"sead": 1}, "x.json: unknown key 'sead'; did you mean 'seed'"),
        ({"train": "chamber"}, "x.json: 'train' is 'chamber'"),
        ({"seed": "one"}, "x.json: 'seed' is 'one'"),
        ({"hidden": [{"effect": "creep"}]}, "x.json: 'hidden' holds"),
        ({"hidden": [{"size": 2.0}]}, "x.json: 'hidden' holds"),
        ({"hidden": [{"name": "creep", "size": "big"}]}, "x.json: 'hidden' holds"),
    ],
)
def test_unusable_json_is_refused_with_its_place(plain, message):
    with pytest.raises(InputError) as caught:
        recipe_from_dict(plain, "x.json")
    assert message in str(caught.value)


def test_acceleration_stands_for_three_channels():
    assert expand_channels(["acceleration", "clock"]) == (
        "acceleration_x",
        "acceleration_y",
        "acceleration_z",
        "clock",
    )


def test_mystery_repeats_by_seed_and_spares_what_is_taken():
    told = Recipe().told
    drawn = [draw_mystery(seed, 2, told) for seed in range(60)]
    assert drawn == [draw_mystery(seed, 2, told) for seed in range(60)]
    names = [choice.name for choices in drawn for choice in choices]
    assert len(set(names)) > 10
    assert not {"zero_tempco", "dark_current"} & set(names)
    assert all(first.name != second.name for first, second in drawn)


def test_twin_can_write_every_kind_of_network():
    assert {*NETWORKS, "auto"} == set(NETWORK_KINDS)  # auto is a choice among them
