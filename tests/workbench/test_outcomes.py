"""What the page shows of a programme and of a formula."""

import json

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

from tests.plan.projects import write_blank
from tests.report.conftest import make_findings
from tests.verify.test_manifest import make_summary

from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.report.results import (
    PlanResult,
    ProposedBlackBox,
    ProposedError,
    ProposeResult,
    read_result,
)
from zerodrift.verify.summary import LogsRefused, Statement
from zerodrift.workbench.views import show_firmware, show_outcome

BOX = ProposedBlackBox("lag bank", "T", {"Fz": 0.2}, {"Fz": 0.1}, 2.0, 1.0, False, "falls")
FORMULA = {
    "found": True,
    "kind": "t_power",
    "formula": "k * |T|",
    "parameters": {},
    "coefficients": (),
    "rmse_left_out": {"Fz": ProposedError("N", 0.5, 0.1, 0.1)},
    "floor_ratio_before": 5.0,
    "floor_ratio_after": 1.0,
    "p_value": 0.01,
    "probability": 0.99,
    "forms_tried": 10,
    "columns_tried": 20,
    "lookalikes": (),
    "suffices": None,
    "nearest": None,
    "reason": "it helps",
    "physics": "a bend",
    "next_experiment": "heat it",
    "remainder": (),
    "black_boxes": (BOX,),
    "black_box_note": "",
    "curves": {"Fz": FormulaCurve((0.0, 1.0), (0.1, 1.0))},
    "instructions": {},
    "flash_bytes": {},
    "rounding": {},
    "cost_note": "",
    "written": None,
}


def write(parts):
    return "".join(json.dumps(part.to_plotly_json(), default=str) for part in parts)


@pytest.mark.long
def test_a_programme_is_drawn_and_told(tmp_path, zerodrift):
    write_blank(tmp_path)
    options = ("--hours", "1", "--budget", "1", "--between", "creep", "load_hysteresis", "--json")
    plan = read_result(zerodrift("plan", "-C", tmp_path, *options).out)
    assert isinstance(plan, PlanResult)
    shown = write(show_outcome(plan))
    assert "<svg" in shown and "chamber, degC" in shown and "Fz, N" in shown
    assert "PLAN: " in shown


def test_a_formula_is_drawn_against_what_is_left():
    shown = write(show_outcome(ProposeResult(**FORMULA)))
    assert "Fz: remainder, N" in shown and "learns no more than the formula" in shown
    none = {"found": False, "formula": None, "curves": {}, "black_boxes": ()}
    shown = write(show_outcome(ProposeResult(**{**FORMULA, **none})))
    assert "No formula was found: it helps." in shown and "<svg" not in shown


def test_what_the_gate_says_stands_beside_the_firmware():
    shown = write(show_firmware(make_findings(firmware=make_summary("0"))))
    assert "Warning: a run." in shown and "Built by force, though refused: why." in shown


def test_why_no_firmware_was_written_is_told_once():
    findings = make_findings(firmware=None)
    refused = LogsRefused(refused=(Statement(kind="sign", run="a", text="why"),))
    assert "Refused, nothing was written: why." in write(show_outcome(refused))
    assert not show_firmware(findings, refused) and show_firmware(findings)
