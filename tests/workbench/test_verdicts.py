"""Every verdict has its words and its buttons; nobody needs colour to read it."""

import json
from dataclasses import replace

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

import numpy as np
from tests.report.conftest import make_findings, make_trace
from tests.report.test_verdict import rate, told

from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.diagnosis import HEADLINE, ExplainedDiagnosis, Sentence
from zerodrift.report.window import Window
from zerodrift.workbench.chart import MOVES, choose_window, move_window
from zerodrift.workbench.panels import show_candidates, show_verdict
from zerodrift.workbench.state import PictureWish


def find(diagnosis, thermometers=()):
    """Return findings that hold this diagnosis and nothing else."""
    sentences = (Sentence("headline", HEADLINE), Sentence("Evidence: 8 runs."))
    explained = ExplainedDiagnosis(diagnosis, None, thermometers, sentences) if diagnosis else None
    return make_findings(diagnosed=explained, notes=("rows were set aside",))


def read(parts):
    """Return everything that components say, their ids included, as one text."""
    from dash import html

    return json.dumps(html.Div(parts).to_plotly_json(), default=lambda c: c.to_plotly_json())


@pytest.mark.parametrize(
    ("diagnosed", "label"),
    [
        (told("missing", "creep"), "An effect is missing"),
        (told("missing", "creep", lookalikes=("ageing",)), "look-alikes"),
        (told("complete"), "Nothing is missing"),
        (told("unknown", nearest="creep"), "the catalogue does not know"),
        (told("complete", candidates=()), "Not testable"),
        (None, "No verdict"),
    ],
)
def test_verdict_says_its_kind_in_words(diagnosed, label):
    _, parts = show_verdict(find(diagnosed), diagnosing=False, hides=False)
    assert label in read(parts[:1])


def test_notes_of_logs_and_diagnosis_are_shown():
    diagnosed = told("unknown", remarks=("one run holds 80 % of the error",))
    text = read(show_verdict(find(diagnosed), diagnosing=False, hides=False)[1])
    assert "Note: rows were set aside" in text
    assert "Note: one run holds 80 % of the error" in text


def test_wrong_data_stand_below_the_verdict_and_limits_of_test_logs_do_not():
    wrong, limit = DataNote("run_3", "t", (0, 9), "fahrenheit", "looks like degF"), "too_short"
    findings = replace(
        find(told("unknown")),
        reviewed=(wrong, DataNote("test_1", "t", (0, 9), limit, "has 9 rows")),
    )
    _, parts = show_verdict(findings, diagnosing=False, hides=False)
    shown = read(parts[:-1])  # without what is folded
    assert "run run_3, column t, rows 0 to 9: looks like degF." in shown
    assert "has 9 rows" not in shown


def test_guess_comes_before_the_verdict():
    _, parts = show_verdict(find(told("missing", "creep")), diagnosing=False, hides=True)
    assert "creep" not in read(parts)


def test_candidates_say_why_and_why_not():
    candidates = (rate("creep", 0.1), rate("ageing", 0.5, 0.3), rate("warm_up", 1.01, 1.0))
    diagnosed = told("missing", "creep", candidates=candidates)
    text = read(show_candidates(find(diagnosed), ("creep",)))
    assert "It is what is missing: with it 10.0 % of the held-out RMSE is left" in text
    assert "helps too few runs to rule out chance (< 1 % likely, p = 0.3); with it 50.0 %" in text
    assert "does not lower the held-out error; with it 101.0 %" in text
    assert text.count("Draw it over what is left") == 1


@pytest.fixture
def trace():
    flat = np.zeros(1000)
    return make_trace(flat, flat, temperature=flat, load=flat)


def test_buttons_move_what_is_shown_and_stay_inside_the_run(trace):
    window = Window("run")
    for move in ("closer", "closer"):
        window = move_window(trace, window, move)
    assert (window.from_s, window.to_s) == pytest.approx((374.625, 624.375))
    for _ in range(9):
        window = move_window(trace, window, "later")
    assert window.to_s == pytest.approx(999.0)
    assert window.to_s - window.from_s == pytest.approx(249.75)
    for _ in range(9):
        window = move_window(trace, window, "wider")
    assert window == Window("run")
    assert set(MOVES) == {"earlier", "later", "closer", "wider", "whole"}


def test_part_that_is_asked_for_stays_inside_the_run_and_is_no_point(trace):
    wish = PictureWish(from_s=900.0, to_s=5000.0)
    assert choose_window(trace, wish) == Window("run", 900.0, 999.0)
    assert choose_window(trace, PictureWish(from_s=500.0, to_s=500.5)) == Window("run")
    assert choose_window(trace, PictureWish(from_s=-5.0, to_s=2000.0)) == Window("run")
