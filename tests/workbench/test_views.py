"""What the page offers, and what it leaves alone."""

import json
from types import SimpleNamespace

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

import numpy as np
from dash import no_update
from tests.report.conftest import make_comparison, make_findings, make_trace

from zerodrift.diagnosis.summary import WorstSegment
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.description import describe_effect
from zerodrift.physics.summary import EffectSummary, ModelSummary
from zerodrift.workbench.app import TOP
from zerodrift.workbench.early import READING, TILES, WAITING
from zerodrift.workbench.state import JobState, PageState
from zerodrift.workbench.views import list_choices, poll, show_chart, show_frame, show_top
from zerodrift.workbench.watch import UnitsSeen


@pytest.fixture
def place():
    """Return a project of two runs and an output, with one preview and one effect."""
    flat = np.zeros(10)
    traces = tuple(
        make_trace(flat, flat, temperature=flat, load=flat, name=name) for name in ("one", "two")
    )
    known = load_catalogue()
    findings = make_findings(
        comparison=make_comparison((WorstSegment("two", "Fz", 0.0, 1.0, 1.0, "cooling", 0.5),)),
        model=ModelSummary((EffectSummary("creep", "creep", "", "", {}, ()),), 25.0, ()),
        catalogue={kind: describe_effect(known[kind]) for kind in ("creep", "ageing")},
        traces=traces,
    )
    return SimpleNamespace(
        findings=findings, is_practice=False, revision=None, previews=("ageing",), shown=1
    )


def test_first_choice_is_the_worst_segment(place):
    output, run, *others = (json.loads(told) for told in list_choices(place, None))
    assert output == {"choices": [["Fz", "Fz"]], "first": "Fz"}
    assert run == {"choices": [["one", "one"], ["two", "two"]], "first": "two"}
    assert [told["first"] for told in others] == ["", "", ""]


def test_nothing_is_drawn_over_before_the_guess(place):
    place.is_practice = True
    assert json.loads(list_choices(place, None)[2])["choices"] == [["none", "none"]]
    assert json.loads(list_choices(place, True)[2])["choices"] == [
        ["ageing", "ageing"],
        ["none", "none"],
    ]


@pytest.mark.parametrize("busy", [True, False])
def test_project_of_which_nothing_is_known_yet_is_no_empty_page(project, busy):
    place = SimpleNamespace(
        has_project=True,
        findings=None,
        revision=None,
        directory=project.directory,
        message=None,
        busy=busy,
        job=None,
        sensor=None,
        refused={},
        done=set(),
    )
    start, start_hidden, bench_hidden, layout, *_ = show_frame(place)
    assert (start_hidden, bench_hidden) == (busy, False)
    assert ("alone" in layout) is not busy  # the registry's units are all that is shown of it
    if busy:
        head = dict(zip((name for name, _ in TOP), show_top(place, None, None), strict=False))
        assert head["sensor"] == "cell" and READING in str(head["verdict"])
        assert len(head["tiles"]) == TILES
        assert show_chart(place, None)[0] == WAITING
    else:
        assert "says why" in str(start[0].to_plotly_json())


def test_progress_is_told_while_something_runs():
    job = JobState("Adding creep", "fitting", 3)
    place = SimpleNamespace(
        poll=lambda: None,
        describe=lambda: PageState(7, job),
        recordings=SimpleNamespace(look=lambda: ()),
        units=SimpleNamespace(mark=lambda: "none", look=lambda: UnitsSeen(is_there=False)),
        sensor=None,
    )
    nothing, units = (no_update,) * 3, (no_update,) * 4
    began = (no_update, "Adding creep: fitting (3 s)", False, *nothing, *units)
    assert poll(place, 7, "", "none") == began
    place.describe = lambda: PageState(8, None)
    assert poll(place, 7, "", "none") == (8, "", True, *nothing, *units)
    assert poll(place, 7, "gone since", "none") == (8, "", True, [], True, "", *units)
    assert poll(place, 7, "", "changed")[6:] != units


def test_worst_segments_tell_no_pattern_before_the_guess(place):
    place.is_practice = True
    assert "cooling" not in str(show_chart(place, None)[1])
    assert "cooling" in str(show_chart(place, True)[1])
