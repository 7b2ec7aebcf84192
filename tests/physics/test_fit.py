import json
from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import (
    FULL_SCALE,
    OUTPUTS,
    SLOPE,
    STEP_S,
    UNITS,
    follow,
    linear,
    make_dataset,
)

from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict
from zerodrift.operations.backend import evaluate
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit, flat_weights
from zerodrift.physics.model import ModelRecord, PhysicalModel
from zerodrift.physics.search import search
from zerodrift.physics.signals import graph_inputs, plan_signals, read_signals
from zerodrift.physics.summary import describe_coefficients
from zerodrift.physics.terms import start_term


def fit_dataset(dataset, *effects, **kwargs):
    configs = [e if isinstance(e, EffectConfig) else EffectConfig(e) for e in effects]
    return fit(
        configs, dataset.train, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE, **kwargs
    )


def lagging(tau_s):
    def disturb(bench):
        return (follow(bench.temperature, tau_s) - 25.0)[:, None] * SLOPE

    return disturb


def darkening(bench):
    dark = 2.0 ** ((bench.temperature - 25.0) / 9.3)
    return linear(bench) + dark[:, None] * np.array([-6.0, 0.05])


def test_fit_finds_coefficients_within_their_errors():
    model = fit_dataset(make_dataset(linear), "zero_tempco")
    miss = np.abs(model.coefficients[1] - SLOPE) / model.std_errors[1]
    assert (miss < 5.0).all()
    assert (model.std_errors[1] < 0.01 * SLOPE).all()


def test_fit_finds_a_lag():
    model = fit_dataset(make_dataset(lagging(70.0)), "zero_tempco", "thermal_lag")
    (lag,) = [term for term in model.terms if term.kind == "thermal_lag"]
    assert lag.term.values["tau_s"] == pytest.approx(70.0, rel=0.02)
    assert lag.std_errors["tau_s"] < 2.0
    low, high = lag.intervals["tau_s"]
    assert low < lag.term.values["tau_s"] < high


def test_fit_finds_a_doubling_temperature():
    model = fit_dataset(make_dataset(darkening), "zero_tempco", "dark_current")
    assert model.terms[1].term.values["doubling_K"] == pytest.approx(9.3, rel=0.02)


def test_interval_covers_the_truth_about_as_often_as_it_says():
    inside = 0
    for seed in range(20):
        dataset = make_dataset(darkening, seed=seed + 1, length=300)
        model = fit_dataset(dataset, "zero_tempco", "dark_current")
        low, high = model.terms[1].intervals["doubling_K"]
        inside += low < 9.3 < high
    # 95 % of 20 is 19; fewer than 15 would happen once in ten thousand times.
    assert inside >= 15


def test_order_of_effects_does_not_change_the_prediction():
    dataset = make_dataset(lagging(50.0), runs=4, length=400)
    one = fit_dataset(dataset, "zero_tempco", "thermal_lag")
    other = fit_dataset(dataset, "thermal_lag", "zero_tempco")
    run = dataset.train[0]
    assert one.predict(run) == pytest.approx(other.predict(run), abs=1e-6)


def test_held_value_is_kept_and_has_no_error():
    held = EffectConfig("thermal_lag", {"tau_s": 33.0})
    model = fit_dataset(make_dataset(lagging(70.0), runs=4, length=400), "zero_tempco", held)
    lag = model.terms[1]
    assert lag.term.values["tau_s"] == 33.0
    assert "tau_s" not in lag.std_errors


def test_value_at_its_bound_is_told():
    model = fit_dataset(make_dataset(linear, runs=4, length=400), "zero_tempco", "thermal_lag")
    lag = model.terms[1]
    assert lag.at_bound == ("tau_s",)
    assert any("at the bound" in note for note in model.notes)


def test_collinear_features_are_told():
    def disturb(bench):
        return linear(bench)

    dataset = make_dataset(disturb, runs=4, length=400)
    half_degree = EffectConfig("dark_current", {"doubling_K": 25.0})
    model = fit_dataset(dataset, EffectConfig("zero_tempco", {"order": 3}), half_degree)
    assert any("differs from the other features" in note for note in model.notes)


def test_tared_logs_have_offsets_of_their_own():
    dataset = make_dataset(linear, tared=True)
    model = fit_dataset(dataset, "zero_tempco")
    assert model.tared
    spread = np.std([offset[0] for offset in model.offsets.values()])
    assert spread > 2.0
    for run in dataset.train:
        rest = run.drift - model.predict(run) - (model.offsets[run.group] - model.coefficients[0])
        assert np.abs(rest.mean(axis=0)).max() < 1e-9


def test_untared_logs_share_one_offset():
    dataset = make_dataset(linear, tared=False)
    model = fit_dataset(dataset, "zero_tempco")
    assert not model.tared
    rest = np.concatenate([run.drift - model.predict(run) for run in dataset.train])
    assert np.abs(rest.mean(axis=0)).max() < 1e-9


def test_model_without_effects_is_a_constant():
    dataset = make_dataset(linear, runs=4, length=200)
    model = fit_dataset(dataset)
    assert model.feature_names == ("offset",)
    assert (model.predict(dataset.train[0]) == model.coefficients[0]).all()


def test_prediction_is_features_times_coefficients_and_equals_the_graph():
    dataset = make_dataset(lagging(40.0), runs=4, length=300)
    model = fit_dataset(
        dataset, "zero_tempco", "thermal_lag", "creep", "load_hysteresis", "warm_up"
    )
    run = dataset.train[1]
    features = model.features(run)
    assert model.predict(run) == pytest.approx(features @ model.coefficients)
    nodes = model.graph().features
    values = evaluate(nodes, graph_inputs(read_signals(run, model.plan)), STEP_S)
    assert (np.stack(values, axis=1) == features).all()


def test_model_survives_json():
    dataset = make_dataset(darkening, runs=4, length=300)
    model = fit_dataset(dataset, "zero_tempco", "dark_current", "creep")
    again = PhysicalModel.from_record(
        from_json(ModelRecord, json.loads(json.dumps(to_dict(model.to_record()))))
    )
    assert (again.predict(dataset.train[0]) == model.predict(dataset.train[0])).all()
    assert to_dict(again.to_record()) == to_dict(model.to_record())


def test_fit_from_an_earlier_one_arrives_at_the_same():
    dataset = make_dataset(lagging(60.0), runs=4, length=400)
    first = fit_dataset(dataset, "zero_tempco", "thermal_lag")
    second = fit_dataset(dataset, "zero_tempco", "thermal_lag", start=first)
    tau = [m.terms[1].term.values["tau_s"] for m in (first, second)]
    assert tau[1] == pytest.approx(tau[0], rel=1e-4)


def test_creep_sees_the_true_load():
    def disturb(bench):
        crept = np.stack([follow(load, 200.0) for load in bench.load.T], axis=1)
        return linear(bench) + 0.01 * crept

    model = fit_dataset(make_dataset(disturb, length=700), "zero_tempco", "creep")
    assert model.terms[1].term.values["tau_s"] == pytest.approx(200.0, rel=0.05)
    names = model.feature_names
    own = model.coefficients[names.index("creep: creep Fz")]
    assert own[0] == pytest.approx(0.01, rel=0.02)
    assert own[1] == 0.0


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (EffectConfig("ambient_light", line=9), r"zerodrift.toml:9: .*no input 'ambient_light'"),
        (EffectConfig("zero_tempco", line=5), r"zerodrift.toml:5: .*stands here twice"),
        (
            EffectConfig("thermal_lag", options={"signal": "suply"}, line=4),
            r"zerodrift.toml:4: .*no input 'suply'.*supply",
        ),
    ],
)
def test_effect_that_cannot_be_fitted_is_refused(effect, message):
    dataset = make_dataset(linear, runs=4, length=100)
    with pytest.raises(InputError, match=message):
        fit_dataset(dataset, "zero_tempco", effect)


def test_load_effect_without_a_load_is_refused():
    dataset = make_dataset(linear, runs=4, length=100)
    still = [
        replace(run, reference=0.0 * run.reference, measured=run.drift) for run in dataset.train
    ]
    with pytest.raises(InputError, match="no output has a reference that varies"):
        fit([EffectConfig("creep")], still, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)


def test_long_logs_are_fitted_as_well_on_blocks():
    catalogue = load_catalogue()
    dataset = make_dataset(lagging(80.0), runs=4, length=1500)
    plan = plan_signals(dataset.train, OUTPUTS, FULL_SCALE)
    terms = [start_term(catalogue, EffectConfig(kind)) for kind in ("zero_tempco", "thermal_lag")]
    found = []
    for most_rows in (6000, 600):
        campaign = Campaign(dataset.train, plan, list(catalogue), most_rows=most_rows)
        found.append(search(campaign, terms, flat_weights(campaign)).terms[1].values["tau_s"])
    assert found[1] == pytest.approx(found[0], rel=0.01)


def test_a_rough_search_ends_near_the_optimum():
    """It is spared the last steps, and keeps nearly all of what the change gains."""
    dataset = make_dataset(lagging(70.0))
    plan = plan_signals(dataset.train, OUTPUTS, FULL_SCALE)
    catalogue = load_catalogue()
    campaign = Campaign(dataset.train, plan, tuple(catalogue))
    weights = flat_weights(campaign)
    zero = start_term(catalogue, EffectConfig("zero_tempco"))
    terms = (zero, start_term(catalogue, EffectConfig("thermal_lag")))
    without = search(campaign, (zero,), weights).cost
    best = search(campaign, terms, weights, vary=(1,))
    rough = search(campaign, terms, weights, vary=(1,), without=without)
    assert without - rough.cost > 0.99 * (without - best.cost)
    assert rough.terms[1].values["tau_s"] == pytest.approx(best.terms[1].values["tau_s"], rel=0.1)
    assert rough.cost > best.cost


def test_an_output_that_a_feature_does_not_act_on_has_no_coefficient_of_rounding():
    model = fit_dataset(make_dataset(linear, runs=3, length=300), "zero_tempco")
    fitted = model.terms[0]
    every = describe_coefficients(model, fitted)
    coefficients, errors = model.coefficients.copy(), model.std_errors.copy()
    coefficients[1, 0], errors[1, 0] = 1e-14 * coefficients[1, 1], 0.0
    rounded = replace(model, coefficients=coefficients, std_errors=errors)
    left = describe_coefficients(rounded, fitted)
    assert left == tuple(one for one in every if one.output != OUTPUTS[0])
    errors[1, 0] = 1e-9
    assert len(describe_coefficients(replace(rounded, std_errors=errors), fitted)) == len(every)
