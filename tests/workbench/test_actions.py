"""What a button asks of the command line."""

from types import SimpleNamespace

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

from tests.report.test_verdict import told

from zerodrift.base.errors import InputError
from zerodrift.diagnosis.changes import AddCommand
from zerodrift.diagnosis.diagnosis import ExplainedDiagnosis
from zerodrift.diagnosis.drivers import OtherThermometer
from zerodrift.workbench import server

SETTINGS = ("--set", "signal=body_temperature", "--set", "x=a b")
DIAGNOSED = ExplainedDiagnosis(
    told("missing", "zero_tempco"),
    AddCommand("zero_tempco", ("--hold", "order=2")),
    (OtherThermometer("body_temperature", 0.5, "it helps", AddCommand("thermal_lag", SETTINGS)),),
    (),
)


@pytest.fixture
def place(tmp_path):
    """Return a project that notes what is run."""
    ran = []
    return SimpleNamespace(
        directory=tmp_path,
        findings=SimpleNamespace(diagnosed=DIAGNOSED),
        run=lambda name, title, arguments: ran.append((name, title, arguments)),
        tell=lambda text, **_: ran.append(text),
        **dict.fromkeys(("undo", "redo", "look", "cancel", "dismiss", "load_chip")),
        ran=ran,
    )


def test_add_takes_the_form_that_the_diagnosis_found(place):
    server.press(place, "add", {"effect": "zero_tempco"})
    expected = ["add", "zero_tempco", "--json", "--hold", "order=2"]
    assert place.ran == [("add", "Adding zero_tempco", expected)]


def test_add_of_a_look_alike_takes_its_name_alone(place):
    server.press(place, "add", {"effect": "dark_current", "present": "creep", "force": True})
    assert place.ran == [
        ("add", "Adding dark_current", ["add", "dark_current", "--json", "--force"])
    ]


def test_add_after_another_thermometer(place):
    server.press(place, "add", {"effect": "thermal_lag"})
    assert place.ran[0][2] == ["add", "thermal_lag", "--json", *SETTINGS]


def test_button_that_is_none_is_refused(place):
    with pytest.raises(InputError, match="'format': is no button of the page; expected one of add"):
        server.press(place, "format", {})
    assert place.ran == []


@pytest.mark.parametrize("button", ["add-chosen", "remove"])
def test_nothing_chosen_is_told(place, button):
    server.press(place, button, {"effect": "", "present": None})
    assert place.ran[0].startswith("Choose")


def test_remove_of_an_effect_that_follows_another_thermometer(place):
    server.press(place, "remove", {"present": "zero_tempco[body_temperature]"})
    told = ["remove", "zero_tempco", "--json", "--set", "signal=body_temperature"]
    assert place.ran == [("remove", "Removing zero_tempco[body_temperature]", told)]


def test_logs_of_a_new_project_are_named_in_full(place):
    """A name that looks like an option is none, and no file of the same name elsewhere is taken."""
    (place.directory / "-x.csv").write_text("time_s\n0\n")
    server.press(place, "begin", {})
    assert place.ran[0][2] == ["init", str(place.directory / "-x.csv"), "--json"]


@pytest.mark.parametrize(
    ("step", "number"), [("3", 3), ("", -1), ("-1", -1), ("x", -1), ("9" * 20, -1)]
)
def test_step_of_the_history_is_gone_to_by_its_number(place, step, number):
    place.restore = place.ran.append
    server.press(place, "restore", {"step": step})
    assert place.ran == [number]


def test_model_is_applied_to_test_logs_or_else_to_those_it_learnt_from(place):
    def source(file, use):
        return SimpleNamespace(file=file, use=use)

    files = [source("a.csv", "train"), source("b.csv", "test"), source("zerodrift.toml", "x")]
    for left, log in ((files, "b.csv"), (files[:1], "a.csv")):
        place.findings.provenance = SimpleNamespace(files=left)
        server.press(place, "apply", {})
        assert place.ran.pop()[2][:2] == ["apply", str(place.directory / log)]


def test_plan_writes_its_programme_into_build(place):
    server.press(place, "plan", {})
    ((name, _, arguments),) = place.ran
    assert name == "plan" and arguments[:4] == ["plan", "--json", "--budget", "30"]
    assert arguments[4:] == ["--out", str(place.directory / "build" / "plan.csv")]
