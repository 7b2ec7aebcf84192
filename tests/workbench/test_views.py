"""What the page offers, and what it leaves alone."""

from types import SimpleNamespace

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

import numpy as np
from dash import no_update
from tests.report.conftest import make_trace

from zerodrift.report.findings import Findings
from zerodrift.workbench.views import list_choices, poll, show_frame


@pytest.fixture
def place():
    """Return a project of two runs and an output, with one preview and one effect."""
    flat = np.zeros(10)
    traces = tuple(
        make_trace(flat, flat, temperature=flat, load=flat, name=name) for name in ("one", "two")
    )
    told = {
        "compare": {"worst": [{"output": "Fz", "run": "two"}]},
        "model": {"terms": [{"name": "creep"}]},
        "catalogue": {"creep": {}, "ageing": {}},
    }
    findings = Findings("cell", ("Fz",), ("N",), (200.0,), False, told, traces)
    return SimpleNamespace(
        findings=findings, is_practice=False, undo_stack=[], revision=None, previews=("ageing",)
    )


def test_first_choice_is_the_worst_segment(place):
    told = list_choices(place, None, None, None, None, None, None)
    assert (told[1], told[3]) == ("Fz", "two")
    assert (told[5], told[7], told[9]) == (no_update, no_update, no_update)


def test_what_is_chosen_and_still_there_is_not_sent_back(place):
    """An answer under way must not undo what the user chooses meanwhile."""
    told = list_choices(place, None, "Fz", "one", "ageing", "ageing", "creep")
    assert [told[i] for i in (1, 3, 5, 7, 9)] == [no_update] * 5


def test_what_is_gone_is_not_chosen_any_more(place):
    told = list_choices(place, None, "Mx", "three", "warm_up", "warm_up", "warm_up")
    assert [told[i] for i in (1, 3, 5, 7, 9)] == ["Fz", "two", None, None, None]


def test_nothing_is_drawn_over_before_the_guess(place):
    place.is_practice = True
    assert list_choices(place, None, None, None, None, None, None)[4] == []
    assert list_choices(place, True, None, None, None, None, None)[4] == ["ageing"]


@pytest.mark.parametrize(("busy", "words"), [(True, "Reading the logs"), (False, "says why")])
def test_project_of_which_nothing_is_known_yet_is_no_empty_page(tmp_path, busy, words):
    place = SimpleNamespace(
        has_project=True, findings=None, directory=tmp_path, message=None, busy=busy
    )
    start, start_hidden, bench_hidden, *_ = show_frame(place)
    assert words in str(start[0].to_plotly_json())
    assert (start_hidden, bench_hidden) == (False, True)


def test_progress_is_told_while_something_runs():
    job = {"name": "add", "title": "Adding creep", "progress": "fitting", "seconds": 3}
    place = SimpleNamespace(poll=lambda: None, describe=lambda: {"version": 7, "job": job})
    assert poll(place, 7) == (no_update, "Adding creep: fitting (3 s)", False)
    place.describe = lambda: {"version": 8, "job": None}
    assert poll(place, 7) == (8, "", True)
