"""The sentence on top, for every verdict there is."""

from dataclasses import replace

import pytest

from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.diagnosis import STEP, CandidateReport, Diagnosis
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.report.sentences import (
    explain_candidate,
    explain_standing,
    explain_verdict,
    write_headline,
)
from zerodrift.report.tables import tabulate_candidates

TITLES = {"creep": "creep and creep recovery"}


def rate(effect, ratio, p=0.004):
    return CandidateReport(effect, ratio, p, 0.4, {})


def wrong(run, kind):
    return DataNote(run, "Fz", (0, 9), kind, "")


def told(verdict, effect=None, **changes):
    return Diagnosis(
        **{
            "verdict": verdict,
            "effect": effect,
            "parameters": {},
            "lookalikes": (),
            "also": (),
            "nearest": None,
            "candidates": (rate("drift", 0.9),),
            "not_testable": (),
            "floor_ratio_before": 5.0,
            "floor_ratio_after": 1.03,
            "noise_floor_source": "dwell",
            "outputs": {},
            "remainder": (),
            "next_experiment": "",
            "evidence": "8 runs",
            **changes,
        }
    )


@pytest.mark.parametrize(
    ("diagnosed", "kind", "words"),
    [
        (told("missing", "creep"), "missing", "lacks creep, creep and creep recovery"),
        (told("missing", "creep", also=("ageing",)), "missing", "beside it: ageing"),
        (
            told("missing", "creep", lookalikes=("ageing",)),
            "lookalikes",
            "creep or ageing: these logs cannot tell which",
        ),
        (
            told("complete"),
            "complete",
            "Nothing is missing; the error in runs left out is 5.00 times",
        ),
        (
            told("complete", not_testable=(Untested("a", "b"),) * 2),
            "complete",
            "2 cannot be tested",
        ),
        (told("complete", candidates=()), "not testable", "can test no further effect"),
        (told("unknown", nearest="creep"), "unknown", "Nearest, and not all of it: creep"),
        (
            told("unknown", nearest="creep", notes=(wrong("run_3", "fahrenheit"),)),
            "wrong data",
            "The data of run_3 look wrong",
        ),
        (told("complete", noise_floor_source="estimated"), "complete", "which is estimated"),
        (None, "none", "Not diagnosed"),
    ],
)
def test_headline_says_the_verdict(diagnosed, kind, words):
    headline = write_headline(diagnosed, TITLES)
    assert headline.kind == kind
    assert words in headline.sentence


def test_candidates_table_tells_their_probabilities():
    sure, some, hardly = (
        replace(rate(name, 0.5), probability=p)
        for name, p in (("creep", 0.998), ("ageing", 0.426), ("humidity", 0.004))
    )
    table = tabulate_candidates(told("missing", "creep", candidates=(sure, some, hardly)), TITLES)
    column = table.headings.index("probability")
    assert [row[column] for row in table.rows] == ["> 99 %", "43 %", "< 1 %"]
    assert all(len(row) == len(table.headings) for row in table.rows)


def test_what_comes_nearest_is_never_called_not_it():
    nearest = replace(rate("creep", 0.5), probability=0.97)
    diagnosed = told("unknown", nearest="creep", candidates=(nearest,))
    assert explain_standing(diagnosed, nearest) == "nearest, and not all of it"
    assert "97 % likely" in explain_candidate(diagnosed, nearest)


@pytest.mark.parametrize(
    ("notes", "first"),
    [
        ((), "To look for a formula of it: zerodrift propose"),
        ((wrong("run_3", "fahrenheit"), wrong("run_3", "sign")), "First look at run_3, whose data"),
        ((wrong("a", "sign"), wrong("b", "stuck")), "First look at a and b, whose data look wrong"),
        ((wrong("test_1", "too_short"),), "To look for a formula of it: zerodrift propose"),
        ([wrong(name, "sign") for name in "abcd"], "First look at a, b, c and others, whose"),
    ],
)
def test_wrong_data_come_before_a_formula(notes, first):
    sentences = explain_verdict(told("unknown", notes=tuple(notes)), "", load_catalogue())
    steps = [one.text for one in sentences if one.role == STEP]
    assert len(steps) == 1
    assert steps[0].startswith(first)
