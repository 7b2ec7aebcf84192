"""Plans by precision: widths against answers worked by hand, and what is asked of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.plan.projects import EXPERIMENT, HEAD, read, write_blank
from zerodrift.base.config import parse_config
from zerodrift.base.errors import InputError
from zerodrift.diagnosis.noise import Noise
from zerodrift.discovery.contenders import Scene, Truth, spread_typical
from zerodrift.discovery.criterion import Judge
from zerodrift.discovery.limits import resolve_limits
from zerodrift.discovery.plan import Question
from zerodrift.discovery.precise import COVERED, measure_cover, measure_precision, plan_precisely
from zerodrift.discovery.programme import Log, Setting
from zerodrift.discovery.summary import explain_plan, summarise_precise
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.signals import SignalPlan
from zerodrift.physics.terms import start_term

CATALOGUE = load_catalogue()
CONFIG = read()
LIMITS = resolve_limits(CONFIG, (), 2.0)
WHITE = Noise(np.array([[4.0]]), np.array([0.0]), "assumed")
LOG = Log((Setting(0.0, 23.0, 0.0), Setting(60.0, 48.0, 4.0), Setting(1800.0, 23.0, 2.0)), 3600.0)


def open_scene(*effects):
    plan = SignalPlan(("Fz",), (2000.0,), 1.0, ("Fz",), (), ("supply",), 23.0, 0.0)
    terms = tuple(start_term(CATALOGUE, effect) for effect in effects)
    return Scene(plan, tuple(CATALOGUE), terms, WHITE, (), 0)


def test_a_straight_shift_is_known_as_the_textbook_says():
    scene = open_scene(CONFIG.effects[0])
    judge = Judge(scene, LIMITS, (), (0,))
    stage = judge.stage([LOG], np.ones(1))
    truth = Truth(scene.base, np.array([[0.5]]), True)
    (precision,) = [measure_precision(judge, [stage], stage, truth, known=False)]
    away = stage.signals.temperature_degC[0] - stage.signals.temperature_degC[0].mean()
    samples = 3600.0 / away.size
    # Standard error of a slope: sigma over the root of the sum of squares, with its mean off.
    expected = 2.0 / np.sqrt(samples * (away**2).sum())
    assert precision.relative[0, 0] == pytest.approx(expected / 0.5, rel=0.01)
    # What it leaves in the same log: sigma over the root of the samples, one value being fitted.
    assert precision.error[0] == pytest.approx(2.0 / np.sqrt(3600.0), rel=0.01)


def test_widths_are_those_of_many_fits():
    """A doubling temperature's error against the scatter of least-squares fits to drawn noise."""
    scene = open_scene(CONFIG.effects[1])
    judge = Judge(scene, LIMITS, (), (0,))
    stage = judge.stage([LOG], np.ones(1))
    truth = Truth(scene.base, np.array([[30.0]]), True)
    precision = measure_precision(judge, [stage], stage, truth, known=False)
    away = stage.signals.temperature_degC[0] - 23.0
    doubling = truth.terms[0].values["doubling_K"]
    samples = 3600.0 / away.size
    rng = np.random.default_rng(0)
    clean = 30.0 * np.exp2(away / doubling)
    grid = np.exp(np.linspace(np.log(doubling) - 0.1, np.log(doubling) + 0.1, 4001))
    columns = np.exp2(away[:, None] / grid)
    columns = columns - columns.mean(axis=0)
    norms = (columns**2).sum(axis=0)
    found = []
    for _ in range(400):
        y = clean + 2.0 / np.sqrt(samples) * rng.standard_normal(away.size)
        found.append(np.log(grid[np.argmax((columns.T @ (y - y.mean())) ** 2 / norms)]))
    assert precision.widths[0] == pytest.approx(np.std(found), rel=0.12)


def test_what_is_known_of_the_design_saves_time():
    scene = open_scene(*CONFIG.effects)
    judge = Judge(scene, LIMITS, (), (0,))
    stage = judge.stage([LOG], np.ones(1))
    truth = Truth(scene.base, np.array([[0.5, 30.0]]), True)
    fresh = measure_precision(judge, [stage], stage, truth, known=False)
    known = measure_precision(judge, [stage], stage, truth, known=True)
    assert known.widths.size == 0 and fresh.widths.size == 1
    assert known.error[0] < fresh.error[0]


@pytest.mark.long
def test_further_units_take_the_fewest_hours_that_do():
    question = Question(2.0, target=0.001, budget_s=3.0, units=10)
    found = plan_precisely(
        replace(CONFIG, experiment=replace(CONFIG.experiment, units=4)), None, CATALOGUE, question
    )
    # From 23 to -10 degC at 2 K/min and back at 4 K/min takes 25 min of a log, and 5 min of rest.
    hours = found.programme.hours
    assert 1.0 < hours <= 3.0
    assert found.errors["Fz"] <= 0.001 * 2000.0
    assert found.found.covered >= COVERED
    assert any(f"10 units, 4 at once: 3 times {hours:g} h" in note for note in found.notes)
    with pytest.raises(InputError, match="reaches the error aimed at"):
        plan_precisely(CONFIG, None, CATALOGUE, replace(question, target=1e-9, budget_s=1.0))


def test_a_programme_covers_what_the_model_is_used_for():
    """An error that is small by least squares alone says nothing beyond the logs."""
    judge = Judge(open_scene(CONFIG.effects[0]), LIMITS, (), (0,))
    warm = judge.stage([LOG], np.ones(1))
    both = Log(
        (Setting(0.0, 23.0, 0.0), Setting(60.0, -2.0, 4.0), Setting(1800.0, 48.0, 4.0)), 5400.0
    )
    used = judge.stage([both], np.ones(1))
    below = float((used.signals.temperature_degC < 22.0).mean())
    assert measure_cover([used], used, ("Fz",)) == 1.0
    assert measure_cover([warm], used, ("Fz",)) == pytest.approx(1.0 - below, abs=0.01)
    assert measure_cover([used], warm, ("Fz",)) == 1.0
    loaded = Log((Setting(0.0, 23.0, 0.0, {"Fz": 100.0}, {}), *both.settings[1:]), 5400.0)
    assert measure_cover([used], judge.stage([loaded], np.ones(1)), ("Fz",)) < 0.99


@pytest.mark.long
def test_an_error_promised_beyond_the_logs_is_not_reached():
    question = Question(0.5, target=0.001, budget_s=1.0, criterion="error")
    found = plan_precisely(CONFIG, None, CATALOGUE, question)
    assert found.errors["Fz"] < found.aimed["Fz"] and found.found.covered < COVERED
    told = explain_plan(summarise_precise(found, {"Fz": "N"}), Path())
    assert any(line.startswith("NOT reached: the programme reaches only") for line in told)


def test_a_model_without_effects_and_a_run_that_is_not_there_are_refused():
    empty = parse_config(HEAD.split("\n[[effect]]")[0] + EXPERIMENT, CONFIG.path)
    with pytest.raises(InputError, match=r"no \[\[effect\]\]"):
        plan_precisely(empty, None, CATALOGUE, Question(2.0, criterion="precision"))
    question = Question(2.0, criterion="error", profile="walk_1")
    with pytest.raises(InputError, match="--profile walk_1: there is no such run"):
        plan_precisely(CONFIG, None, CATALOGUE, question)


@pytest.mark.long
def test_the_command_says_what_is_known_then(tmp_path, zerodrift):
    write_blank(tmp_path)
    options = ("--hours", "1", "--budget", "2", "--criterion", "precision")
    plan = json.loads(zerodrift("plan", "-C", tmp_path, *options, "--json").out)
    assert plan["probability"] is None and plan["criterion"] == "precision"
    assert plan["widths"][0]["parameter"] == "doubling_K" and plan["widths"][0]["half_width"] > 0.0
    assert plan["errors"]["Fz"] > 0.0
    told = zerodrift("plan", "-C", tmp_path, *options)
    assert "Known then" in told.out and "Error of the model" in told.out


@pytest.mark.long
def test_before_any_log_several_models_are_planned_for_and_the_target_is_judged():
    question = Question(2.0, target=0.001, budget_s=2.0, criterion="error")
    found = plan_precisely(CONFIG, None, CATALOGUE, question)
    assert len(found.found.precisions) == 4
    assert len({float(p.widths[0]) for p in found.found.precisions}) == 4
    assert found.aimed == {"Fz": pytest.approx(2.0)}
    assert any("3 times drawn from it" in note for note in found.notes)
    units = {"Fz": "N"}
    easy = explain_plan(summarise_precise(found, units), Path())
    assert "Reached: Fz 2 N. `zerodrift plan --units 1` looks for the fewest hours that do." in easy
    further = replace(found, question=replace(question, units=3))
    told = explain_plan(summarise_precise(further, units), Path())
    assert "Reached: Fz 2 N. No fewer hours of those that were tried do." in told
    hard = replace(found, aimed={"Fz": found.errors["Fz"] / 3.0})
    assert any(
        line.startswith("NOT reached: Fz by 3 times")
        for line in explain_plan(summarise_precise(hard, units), Path())
    )
    free = plan_precisely(CONFIG, None, CATALOGUE, replace(question, target=None))
    assert not any(
        "eached" in line for line in explain_plan(summarise_precise(free, units), Path())
    )


def test_values_are_drawn_from_their_typical_range():
    terms = open_scene(*CONFIG.effects).base
    models = spread_typical(terms, 30, 7)
    low, high = next(p for p in terms[1].effect.parameters if p.name == "doubling_K").typical
    drawn = [model[1].values["doubling_K"] for model in models[1:]]
    assert models[0] == terms and len(set(drawn)) == 29
    assert low <= min(drawn) < low + 0.2 * (high - low) and high >= max(drawn)
    assert spread_typical(terms[:1], 5, 7) == [tuple(terms[:1])]
