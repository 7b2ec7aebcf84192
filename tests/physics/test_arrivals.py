"""What a run begins with: a hysteresis remembers temperatures before the log."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import FULL_SCALE, OUTPUTS, SLOPE, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.base.records import from_json, to_dict
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit_terms, flat_weights
from zerodrift.physics.model import ModelRecord, PhysicalModel
from zerodrift.physics.search import search
from zerodrift.physics.signals import build_stretches, plan_signals
from zerodrift.physics.terms import start_term

HALF_WIDTH_K = 6.0
SIDES = (1, -1, 0, 1, 1, -1, -1, 1)
WEIGHT = 0.6 * SLOPE


def slack_from(temperature, side, half_width=HALF_WIDTH_K):
    """Play less temperature, sample by sample, with the memory at one wall of its slack."""
    now, slack = temperature[0] + side * half_width, []
    for value in temperature.tolist():
        now = min(max(now, value - half_width), value + half_width)
        slack.append(now - value)
    return np.array(slack)


def remembering(sides):
    """A zero shift with hysteresis whose runs begin on these sides; the dwell at rest."""
    left = list(sides)

    def disturb(bench):
        side = left.pop(0) if left else 0
        return linear(bench) + slack_from(bench.temperature, side)[:, None] * WEIGHT

    return disturb


def make_plan(data):
    return plan_signals(data.train, OUTPUTS, FULL_SCALE)


def list_terms(values):
    catalogue = load_catalogue()
    return [
        start_term(catalogue, EffectConfig("zero_tempco")),
        start_term(catalogue, EffectConfig("thermal_hysteresis"), {"own_terms": 1, **values}),
    ]


def find(data, most_rows):
    catalogue = load_catalogue()
    campaign = Campaign(
        data.train, make_plan(data), list(catalogue), tared=False, most_rows=most_rows
    )
    return search(campaign, list_terms({}), flat_weights(campaign))


@pytest.mark.parametrize("most_rows", [60_000, 1_500])
def test_the_side_that_each_run_came_from_is_found(most_rows):
    data = make_dataset(remembering(SIDES), runs=8, tared=False, dwell=False)
    found = find(data, most_rows)
    sides = dict(found.terms[1].arrivals)
    assert [sides.get(run.group, 0) for run in data.train] == list(SIDES)
    assert found.terms[1].values["half_width_K"] == pytest.approx(HALF_WIDTH_K, rel=0.02)


def test_runs_that_begin_at_rest_are_left_at_rest():
    data = make_dataset(remembering([0] * 8), runs=8, tared=False, dwell=False)
    found = find(data, 60_000)
    assert found.terms[1].arrivals == ()
    assert found.terms[1].values["half_width_K"] == pytest.approx(HALF_WIDTH_K, rel=0.02)


def test_the_columns_are_those_of_a_play_from_that_side():
    data = make_dataset(linear, runs=3, length=300, tared=False, dwell=False)
    flat, played = list_terms({"half_width_K": HALF_WIDTH_K})
    arrivals = (("run_0", 1), ("run_2", -1))
    terms = [flat, replace(played, arrivals=arrivals)]
    built = build_stretches(data.train, make_plan(data), terms, list(load_catalogue()))
    for run, columns, side in zip(data.train, built, (1, 0, -1), strict=True):
        wanted = slack_from(run.temperature_degC, side)
        # The first sample is where the spike stands; what was before shows from the second on.
        np.testing.assert_array_equal(columns[2].signal[1:], wanted[1:])


def test_the_model_predicts_from_rest_and_says_which_runs_were_not():
    data = make_dataset(remembering(SIDES), runs=8, tared=False, dwell=False)
    plan = make_plan(data)
    catalogue = load_catalogue()
    model = fit_terms(list_terms({}), data.train, plan, ("N", "Nm"), list(catalogue))
    (note,) = [note for note in model.notes if "before the log" in note]
    assert "7 of 8 training runs" in note
    assert "from warmer: run_0, run_3, run_4 and 1 more" in note
    assert "from colder: run_1, run_5, run_6)" in note
    again = PhysicalModel.from_record(
        from_json(ModelRecord, json.loads(json.dumps(to_dict(model.to_record()))))
    )
    assert [one.term for one in again.terms] == [one.term for one in model.terms]
    slack = model.coefficients[-1]
    assert (np.abs(slack / WEIGHT - 1.0) < 0.03).all()
    run = data.train[0]
    rise = run.temperature_degC - plan.reference_temperature_degC
    wanted = model.coefficients[0] + rise[:, None] * model.coefficients[1]
    wanted = (
        wanted
        + slack_from(run.temperature_degC, 0, model.terms[1].term.values["half_width_K"])[:, None]
        * slack
    )
    np.testing.assert_allclose(model.predict(run), wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.long
def test_a_hysteresis_that_remembers_is_named_and_then_nothing_is_missing():
    data = make_dataset(remembering(SIDES), runs=8, tared=False)
    catalogue = load_catalogue()
    effects = [EffectConfig("zero_tempco")]
    found = diagnose(effects, data, catalogue)
    assert (found.verdict, found.effect) == ("missing", "thermal_hysteresis")
    whole = [*effects, EffectConfig("thermal_hysteresis", {"own_terms": 1.0})]
    assert diagnose(whole, data, catalogue).verdict == "complete"
