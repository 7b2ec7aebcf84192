"""The page proposes one thing at a time, says why, and never what was just refused."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from tests.report.conftest import make_findings
from tests.report.test_verdict import rate, told, wrong

from zerodrift.diagnosis.changes import AddCommand
from zerodrift.diagnosis.explained import ExplainedDiagnosis
from zerodrift.diagnosis.history import EffectSettings, Step
from zerodrift.diagnosis.thermometers import OtherThermometer
from zerodrift.diagnosis.timeline import Timeline, find_timeline
from zerodrift.workbench.path import ProjectStanding, find_path
from zerodrift.workbench.way import find_job


def stand(diagnosis=None, thermometers=(), firmware=None, **changes):
    explained = ExplainedDiagnosis(diagnosis, None, thermometers, ()) if diagnosis else None
    findings = make_findings(diagnosed=explained, firmware=firmware)
    return ProjectStanding(findings, **changes)


def missing(*lookalikes, ratio=0.3, p=0.004):
    candidates = (rate("creep", ratio, p),)
    return told("missing", "creep", lookalikes=lookalikes, candidates=candidates)


BUILT = SimpleNamespace(flash_bytes=1446)


@pytest.mark.parametrize(
    ("standing", "step", "button"),
    [
        (ProjectStanding(None), "compare", None),
        (stand(), "diagnose", "look"),
        (stand(missing()), "add", "add"),
        (stand(told("unknown")), "add", "propose"),
        (stand(told("unknown", notes=(wrong("a", "sign"),))), "diagnose", "look"),
        (stand(told("unknown"), proposed=True), "firmware", "firmware"),
        (stand(told("complete")), "firmware", "firmware"),
        (stand(told("complete"), firmware=BUILT), "verify", "verify"),
        (stand(told("complete"), firmware=BUILT, verified=True), "report", "report"),
        (stand(missing(), firmware=BUILT), "add", "add"),
    ],
)
def test_one_step_is_next_and_its_reason_is_said(standing, step, button):
    path = find_path(standing)
    assert [s.name for s in path.steps if s.state == "next"] == [step]
    assert (path.offer.button if path.offer else None) == button
    assert path.reason.endswith(".")


def test_when_all_is_done_the_firmware_is_offered():
    standing = stand(told("complete"), firmware=BUILT, verified=True, applied=True, reported=True)
    path = find_path(standing)
    assert path.offer.button == "download"
    assert all(step.state == "done" for step in path.steps)


def test_what_was_refused_is_not_offered_again():
    path = find_path(stand(missing(), refused={"creep": "+44.8 % in run_3"}))
    offered = [path.offer, *path.others]
    assert [o.button for o in offered if o.effect == "creep"] == []
    assert "refused: +44.8 % in run_3" in path.reason
    path = find_path(stand(missing("ageing"), refused={"creep": "it does not help"}))
    assert path.offer.effect == "ageing"


@pytest.mark.parametrize(
    ("diagnosis", "words"), [(missing(ratio=0.93), "only 7.0 %"), (missing(p=0.25), "p = 0.25")]
)
def test_weak_evidence_is_not_what_is_proposed_first(diagnosis, words):
    path = find_path(stand(diagnosis))
    assert words in path.weak
    assert path.offer.button == "firmware"
    assert [(o.button, o.effect) for o in path.others] == [("add", "creep"), ("plan", "")]


def test_look_alikes_and_another_thermometer_have_buttons_of_their_own():
    path = find_path(stand(missing("ageing", "warm_up")))
    assert [o.words for o in path.others[:2]] == ["Add look-alike ageing", "Add look-alike warm_up"]
    command = AddCommand("zero_tempco", ("--set", "signal=body_temperature"))
    other = OtherThermometer("body_temperature", 0.5, "it helps", command)
    path = find_path(stand(told("unknown"), (other,)))
    assert path.offer.words == "Add zero_tempco after body_temperature"


def test_nothing_is_offered_while_something_runs():
    path = find_path(stand(missing(), job="add"))
    assert path.offer is None
    assert [step.state for step in path.steps][2] == "busy"


@pytest.mark.parametrize(
    ("running", "diagnosed", "outdated", "expected"),
    [
        ("look", True, False, ""),
        ("look", False, False, "look"),
        ("look", True, True, "look"),
        ("firmware", True, False, "firmware"),
        (None, True, False, ""),
    ],
)
def test_curves_that_follow_a_verdict_are_not_waited_for(running, diagnosed, outdated, expected):
    place = SimpleNamespace(
        job=SimpleNamespace(name=running, running=True) if running else None,
        findings=SimpleNamespace(diagnosed=object() if diagnosed else None),
        outdated=outdated,
    )
    assert find_job(place) == expected


A, B, C = ((EffectSettings(name),) for name in "abc")


def walk(*states):
    """Return steps; a state of one sign is a change, one with `<` a return."""
    known = {"0": (), "a": A, "b": (*A, *B), "c": (*A, *C)}
    return [
        Step(
            state,
            {},
            {},
            {},
            tuple(e.kind for e in known[state[-1]]),
            "",
            "",
            known[state[-1]],
            state[0] == "<",
        )
        for state in states
    ]


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ((), Timeline(None, None, None)),
        (("0",), Timeline(0, None, None)),
        (("0", "a"), Timeline(1, 0, None)),
        (("0", "a", "b"), Timeline(2, 1, None)),
        (("0", "a", "b", "<a"), Timeline(1, 0, 2)),
        (("0", "a", "b", "<a", "<0"), Timeline(0, None, 1)),
        (("0", "a", "b", "<a", "<0", "<a"), Timeline(1, 0, 2)),
        (("0", "a", "b", "<a", "<b"), Timeline(2, 1, None)),
        (("0", "a", "b", "<a", "c"), Timeline(4, 1, None)),
        (("0", "a", "b", "<0"), Timeline(3, 2, None)),
    ],
)
def test_undo_and_redo_are_told_by_the_history(steps, expected):
    assert find_timeline(walk(*steps)) == expected


def test_step_that_kept_no_settings_is_not_gone_back_to():
    steps = walk("a", "b")
    steps[0] = replace(steps[0], settings=())
    assert find_timeline(steps).undo is None


@pytest.mark.parametrize(
    ("diagnosis", "offered"),
    [
        (missing("load_hysteresis"), True),
        (missing(), False),
        (told("unknown"), True),
        (told("complete"), False),
    ],
)
def test_a_plan_is_offered_where_something_is_open(diagnosis, offered):
    path = find_path(stand(diagnosis))
    assert ("plan" in [o.button for o in path.others]) is offered
    again = find_path(stand(diagnosis, planned=True))
    assert "plan" not in [o.button for o in again.others]
