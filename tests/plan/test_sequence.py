"""Plans after logs: what is open is taken up, what is settled is said, a plan meets its outcome."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import OutlierCount
from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.diagnosis import CandidateReport, Diagnosis
from zerodrift.diagnosis.rules import ENOUGH_RUNS
from zerodrift.discovery.plan import NothingLeftError, find_open
from zerodrift_lab.commands import loop
from zerodrift_lab.commands.loop import describe_loop, run_loop
from zerodrift_lab.twin.recipe import EffectChoice, Recipe

RECIPE = Recipe(
    seed=3,
    train=("chamber", "chamber"),
    test=(),
    hidden=(EffectChoice("thermal_lag", 0.5),),
    sample_period_s=2.0,
    duration_s=1200.0,
)


def find(verdict, effect=None, lookalikes=(), untested=(), candidates=()):
    return Diagnosis(
        verdict=verdict,
        effect=effect,
        parameters={},
        lookalikes=lookalikes,
        also=(),
        nearest=None,
        candidates=tuple(CandidateReport(k, r, 0.01, 0.5, {}) for k, r in candidates),
        not_testable=untested,
        floor_ratio_before=2.0,
        floor_ratio_after=1.0,
        noise_floor_source="dwell",
        outputs={},
        remainder=(),
        next_experiment="",
        evidence="8 runs",
        outliers=OutlierCount(0, {}),
    )


def test_lookalikes_are_open():
    kinds, untold, said = find_open(find("missing", "creep", ("load_hysteresis",)), 8)
    assert kinds == ("creep", "load_hysteresis") and not untold
    assert "look-alikes" in said


def test_what_was_not_excited_is_open_and_what_has_no_channel_is_not():
    untested = (Untested("creep", "hardly excited", 0.01), Untested("humidity", "no input", None))
    kinds, untold, _ = find_open(find("complete", untested=untested), 8)
    assert kinds == ("creep",) and untold == {"creep": "hardly excited"}


def test_with_an_unknown_what_explains_a_part_is_open():
    near = (("creep", 0.7), ("thermal_lag", 0.9), ("crosstalk", 0.999))
    kinds, _, _ = find_open(find("unknown", candidates=near), 8)
    assert kinds == ("creep", "thermal_lag")


def test_complete_on_few_runs_leaves_open_what_gains_a_little():
    gaining = (("creep", 0.98), ("crosstalk", 1.01))
    kinds, untold, said = find_open(find("complete", candidates=gaining), 2)
    assert kinds == ("creep",) and not untold
    assert "2 runs are thin evidence" in said
    for candidates, runs in ((gaining, 6), (gaining[1:], 2)):
        with pytest.raises(NothingLeftError):
            find_open(find("complete", candidates=candidates), runs)


@pytest.mark.parametrize("verdict", ["missing", "complete"])
def test_nothing_left_is_said_plainly(verdict):
    with pytest.raises(NothingLeftError) as refused:
        find_open(find(verdict, "creep" if verdict == "missing" else None), 8)
    told = str(refused.value)
    assert "nothing is left to tell apart" in told and "Expected" in told and "--between" in told


def test_the_loop_takes_no_other_refusal_for_its_end(monkeypatch):
    def refuse(*_):
        raise InputError("plan: nothing is left of the chamber")

    monkeypatch.setattr(loop, "plan_experiment", refuse)
    monkeypatch.setattr(loop, "find_open", lambda found, runs: None)
    monkeypatch.setattr(loop, "diagnose_config", lambda *_: find("unknown"))
    with pytest.raises(InputError, match="left of the chamber"):
        run_loop(RECIPE, 4.0)


@pytest.mark.long
def test_the_loop_ends_with_what_is_hidden():
    looped = run_loop(RECIPE, 4.0)
    first, *_, named, last = looped.rounds
    assert first.predicted is None and first.lookalikes
    assert (named.effect, named.lookalikes) == ("thermal_lag", ()) and named.predicted is not None
    assert looped.ended == "sure" and looped.added == ("thermal_lag",)
    assert last.verdict == "complete" and last.runs >= ENOUGH_RUNS and last.hours <= 4.0
    assert "Added: thermal_lag. Hidden in fact: thermal_lag." in describe_loop(looped)


def test_the_loop_does_not_end_with_complete_on_few_runs(monkeypatch):
    """Until there are runs enough it goes on, and what is named is added and asked beside."""
    told = iter(
        [
            find("complete", candidates=(("creep", 0.99),)),
            find("missing", "creep"),
            find("complete", candidates=(("crosstalk", 0.99),)),
            find("complete"),
        ]
    )
    asked = []
    planned = SimpleNamespace(told=None, programme=SimpleNamespace(hours=1.0))

    def diagnose(config, dataset):
        asked.append((tuple(e.kind for e in config.effects)[-1], len(dataset.train)))
        return next(told)

    def extend(simulation, dataset, planned, number):
        return replace(
            dataset, train=(*dataset.train, replace(dataset.train[0], name=f"more {number}"))
        )

    monkeypatch.setattr(loop, "diagnose_config", diagnose)
    monkeypatch.setattr(loop, "plan_experiment", lambda *_: planned)
    monkeypatch.setattr(loop, "expect_verdicts", lambda told: np.array([0.5]))
    monkeypatch.setattr(loop, "extend", extend)
    looped = run_loop(RECIPE, 9.0)
    assert asked == [("dark_current", 2), ("dark_current", 3), ("creep", 3), ("creep", 4)]
    assert looped.ended == "sure" and looped.added == ("creep",)


@pytest.mark.long
def test_the_loop_stops_when_the_hours_are_spent():
    looped = run_loop(RECIPE, 1.0)
    assert looped.ended == "hours spent" and len(looped.rounds) == 1


@pytest.mark.slow
def test_a_plan_meets_its_outcome(tmp_path, zerodrift):
    """Logs of a project, a plan, its logs beside them, and the next plan."""
    made = zerodrift(
        *("twin", "-C", tmp_path, "--runs", "2", "--period", "2", "--duration", "1200"),
        *("--hidden", "thermal_lag=0.5", "--test", "none", "--seed", "3"),
    )
    assert made.code == 0
    plan = zerodrift("plan", "-C", tmp_path, "--hours", "2", "--budget", "3", "--json")
    told = json.loads(plan.out)
    assert {"thermal_lag", "thermal_gradient"} <= {one["effect"] for one in told["outlooks"]}
    assert "before" not in told
    # A log of another day, since a copy of one that is there would not count.
    other = tmp_path / "other"
    made = zerodrift(
        *("twin", "-C", other, "--runs", "1", "--period", "2", "--duration", "900"),
        *("--hidden", "thermal_lag=0.5", "--test", "none", "--seed", "4"),
    )
    assert made.code == 0
    (other / "logs" / "chamber_1.csv").rename(tmp_path / "logs" / "chamber_7.csv")
    again = zerodrift(
        *("plan", "-C", tmp_path, "--hours", "2", "--budget", "3", "--json"),
        *("--between", "thermal_lag", "thermal_gradient"),
    )
    assert again.code == 0, again.err
    past = json.loads(again.out)["before"]
    assert past["probability"] == told["probability"]
    assert isinstance(past["told_apart"], bool)
