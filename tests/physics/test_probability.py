"""The probabilities of a diagnosis: maps, their data, their words."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.study_probability import Entry, fit_map

from zerodrift.diagnosis.diagnosis import CandidateReport, Diagnosis
from zerodrift.diagnosis.diagnosis_report import (
    CANDIDATE,
    ELSE,
    NOTHING,
    list_candidate_figures,
    list_case_figures,
    load_maps,
    tell_probabilities,
)
from zerodrift.diagnosis.remainder import RemainderPattern


def rate(effect, nats, explained):
    return CandidateReport(effect, 0.5, 0.004, 0.4, {}, nats=nats, explained=explained)


def told(verdict, effect, before, after, *candidates):
    return tell_probabilities(
        Diagnosis(
            verdict=verdict,
            effect=effect,
            parameters={},
            lookalikes=(),
            also=(),
            nearest=None,
            candidates=candidates,
            not_testable=(),
            floor_ratio_before=before,
            floor_ratio_after=after,
            noise_floor_source="dwell",
            outputs={},
            remainder=(),
            next_experiment="",
            evidence="8 runs",
        )
    )


CLEAR = told("missing", "creep", 5.0, 1.0, rate("creep", 900.0, 0.99), rate("ageing", 3.0, 0.02))
HALF = told("missing", "creep", 5.0, 3.0, rate("creep", 400.0, 0.6), rate("ageing", 3.0, 0.02))
COMPLETE = told("complete", None, 1.0, 1.0, rate("creep", 0.0, 0.0))
UNKNOWN = told("unknown", None, 4.0, 4.0, rate("creep", 2.0, 0.1))


def test_stored_maps_have_a_weight_for_each_figure():
    maps = load_maps()
    assert set(maps) == {CANDIDATE, NOTHING, ELSE}
    assert len(maps[CANDIDATE].weights) == len(list_candidate_figures(CLEAR, CLEAR.candidates[0]))
    assert len(maps[NOTHING].weights) == len(maps[ELSE].weights) == len(list_case_figures(CLEAR))


def test_a_clear_name_is_likely_and_its_rival_is_not():
    creep, ageing = CLEAR.candidates
    assert creep.probability > 0.8 > 0.2 > ageing.probability
    assert CLEAR.probability == creep.probability
    assert CLEAR.nothing_missing < 0.1


def test_an_error_off_the_floor_makes_something_else_likelier():
    assert HALF.something_else > CLEAR.something_else + 0.2


def test_without_a_name_something_else_is_anything_at_all():
    assert COMPLETE.nothing_missing > 0.7 > 0.3 > UNKNOWN.nothing_missing
    for one in (COMPLETE, UNKNOWN):
        assert one.something_else == pytest.approx(1.0 - one.nothing_missing)


def test_odds_are_told_in_words():
    alone = replace(CLEAR, something_else=0.1)
    assert alone.tell_odds() == f", {100 * CLEAR.probability:.0f} %"
    pattern = RemainderPattern("the supply", 0.8)
    more = replace(CLEAR, something_else=0.9, remainder=(pattern,))
    assert more.tell_odds().endswith(" %; and something else, which follows the supply")


def test_a_fitted_map_is_calibrated_on_what_it_was_fitted_to():
    rng = np.random.default_rng(4)
    entries = []
    for _ in range(4000):
        x = float(rng.normal())
        entries.append(
            Entry("x", (1.0, x), bool(rng.uniform() < 1.0 / (1.0 + np.exp(1.0 - 2.0 * x))))
        )
    found = fit_map("x", entries)
    assert found.weights == pytest.approx((-1.0, 2.0), abs=0.2)
    assert 0.0 < found.apply((1.0, -50.0)) < found.apply((1.0, 50.0)) < 1.0
