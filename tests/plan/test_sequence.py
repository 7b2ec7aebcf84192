"""Plans after logs: what is open is taken up, what is settled is said, a plan meets its outcome."""

import json

import pytest

from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import OutlierCount
from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.diagnosis import CandidateReport, Diagnosis
from zerodrift.discovery.plan import NothingLeftError, find_open
from zerodrift.lab.commands import loop
from zerodrift.lab.commands.loop import describe_loop, run_loop
from zerodrift.lab.twin.recipe import EffectChoice, Recipe

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
    kinds, untold, said = find_open(find("missing", "creep", ("load_hysteresis",)))
    assert kinds == ("creep", "load_hysteresis") and not untold
    assert "look-alikes" in said


def test_what_was_not_excited_is_open_and_what_has_no_channel_is_not():
    untested = (Untested("creep", "hardly excited", 0.01), Untested("humidity", "no input", None))
    kinds, untold, _ = find_open(find("complete", untested=untested))
    assert kinds == ("creep",) and untold == {"creep": "hardly excited"}


def test_with_an_unknown_what_explains_a_part_is_open():
    near = (("creep", 0.7), ("thermal_lag", 0.9), ("crosstalk", 0.999))
    kinds, _, _ = find_open(find("unknown", candidates=near))
    assert kinds == ("creep", "thermal_lag")


@pytest.mark.parametrize("verdict", ["missing", "complete"])
def test_nothing_left_is_said_plainly(verdict):
    with pytest.raises(NothingLeftError) as refused:
        find_open(find(verdict, "creep" if verdict == "missing" else None))
    told = str(refused.value)
    assert "nothing is left to tell apart" in told and "Expected" in told and "--between" in told


def test_the_loop_takes_no_other_refusal_for_its_end(monkeypatch):
    def refuse(*_):
        raise InputError("plan: nothing is left of the chamber")

    monkeypatch.setattr(loop, "plan_experiment", refuse)
    monkeypatch.setattr(loop, "find_open", lambda found: None)
    monkeypatch.setattr(loop, "diagnose_config", lambda *_: find("unknown"))
    with pytest.raises(InputError, match="left of the chamber"):
        run_loop(RECIPE, 4.0)


def test_the_loop_ends_with_what_is_hidden():
    looped = run_loop(RECIPE, 4.0)
    first, *_, last = looped.rounds
    assert first.predicted is None and first.lookalikes
    assert looped.ended == "sure" and (last.effect, last.lookalikes) == ("thermal_lag", ())
    assert last.predicted is not None and last.hours <= 4.0
    assert "Hidden in fact: thermal_lag" in describe_loop(looped)


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
