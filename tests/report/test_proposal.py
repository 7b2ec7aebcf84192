"""A formula in the report: in words, against what is left, and only while it is of these logs."""

from dataclasses import replace

import numpy as np
import pytest

from zerodrift.base.records import render_sealed, to_dict
from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.report.findings import ProposedFormula
from zerodrift.report.pictures import MOST_OUTPUTS, draw_remainder
from zerodrift.report.report import render_report
from zerodrift.report.svg import render_svg
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.survey import PROPOSAL, read_proposal, trace_provenance

LINE = FormulaCurve((-1.0, 0.0, 2.0), (-1.1, 0.1, 2.0))
TOLD = ProposedFormula("k * |T|", ("FORMULA: drift = k * |T|.",), {"Fz": LINE}, {"Fz": "N"})


def test_every_output_has_a_panel_up_to_six():
    names = [f"Y{n}" for n in range(9)]
    picture = draw_remainder(dict.fromkeys(names, LINE), dict.fromkeys(names, "N"))
    assert [panel.title for panel in picture.panels] == [
        f"{name}: remainder, N" for name in names[:MOST_OUTPUTS]
    ]
    assert len({(panel.left, panel.top) for panel in picture.panels}) == MOST_OUTPUTS
    for panel in picture.panels:
        (line,), (dots,) = panel.curves, panel.clouds
        assert np.array_equal(line.x, line.y) and line.x[0] < -1.0 and line.x[1] > 2.0
        assert panel.y.low < -1.1 and dots.y.tolist() == [-1.1, 0.1, 2.0]
        assert panel.left + panel.width <= picture.width
    assert "remainder" in render_svg(picture)


def test_the_report_shows_what_is_left_against_the_formula(surveyed):
    findings = surveyed[1]
    text = render_report(replace(findings, proposal=TOLD))
    assert 'id="formula"' in text and "FORMULA: drift = k * |T|." in text
    assert "against what the formula" in text
    none = ProposedFormula(None, ("NO FORMULA: none helps.",), {}, {"Fz": "N"})
    text = render_report(replace(findings, proposal=none))
    assert "NO FORMULA: none helps." in text and "against what the formula" not in text
    assert 'id="formula"' not in render_report(findings)


@pytest.mark.parametrize("change", [None, "logs/run_0.csv", "zerodrift.toml"])
def test_a_formula_of_other_logs_or_another_model_is_not_shown(project, change):
    config, dataset = open_project(ProjectFolder(project.directory))
    mark = trace_provenance(config, dataset).mark
    config.build_directory.mkdir(exist_ok=True)
    sealed = render_sealed({"format": 1, "mark": mark, "proposal": to_dict(TOLD)})
    (config.build_directory / PROPOSAL).write_bytes(sealed)
    if change is not None:
        path = project.directory / change
        path.write_text(path.read_text() + ("\n" if change.endswith("toml") else ""))
        if change.endswith("csv"):
            path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    mark = trace_provenance(*open_project(ProjectFolder(project.directory))).mark
    assert read_proposal(config, mark) == (TOLD if change is None else None)
