"""The report: one self-contained page that says what is known about a sensor and its model."""

from collections.abc import Sequence
from dataclasses import dataclass

import plotly.graph_objects as go

from zerodrift.diagnosis.explained import HEADLINE
from zerodrift.report import tables
from zerodrift.report.datasheet import DatasheetRow
from zerodrift.report.figures import (
    draw_autocorrelation,
    draw_budget,
    draw_candidates,
    draw_staircase,
)
from zerodrift.report.figures_runs import draw_output, draw_residual, list_means
from zerodrift.report.findings import Findings, find_threshold
from zerodrift.report.page import render_template
from zerodrift.report.parts import list_parts
from zerodrift.report.verdict import write_headline

POINTS_OF_ALL_LINES = 60_000
"""Points of the lines of all runs and outputs together, which keeps the file small."""
FEWEST_POINTS, MOST_POINTS = 160, 900


def render_report(findings: Findings, datasheet: Sequence[DatasheetRow] | None = None) -> str:
    """Return the report as HTML: nothing in it is fetched from elsewhere, and it holds no date.

    Args:
        findings: what the commands found.
        datasheet: the datasheet's figures, where they were asked for.
    """
    steps, explained, compared = findings.steps, findings.diagnosed, findings.comparison
    diagnosis = explained.diagnosis if explained is not None else None
    firmware, certificate = findings.firmware, findings.certificate
    files, versions = tables.tabulate_provenance(findings.provenance)
    values: dict[str, object] = {
        "findings": findings,
        "title": f"{findings.sensor}: drift and its compensation",
        "headline": write_headline(diagnosis, findings.titles),
        "details": [s.text for s in explained.sentences if s.role != HEADLINE] if explained else [],
        "notes": list_notes(findings),
        "tiles": list_tiles(findings),
        "staircase": draw_staircase(steps) if steps else None,
        "steps": tables.tabulate_steps(steps),
        "outputs": tables.tabulate_outputs(compared),
        "runs": tables.tabulate_runs(compared),
        "worst": tables.tabulate_worst(compared),
        "candidates": draw_candidates(diagnosis) if diagnosis and diagnosis.candidates else None,
        "candidates_table": tables.tabulate_candidates(diagnosis, findings.titles)
        if diagnosis
        else None,
        "sections": list_sections(findings),
        "moving": find_threshold([t for t in findings.traces if t.held_out] or findings.traces),
        "parameters": tables.tabulate_parameters(findings.model),
        "coefficients": tables.tabulate_coefficients(findings.model),
        "budget": draw_budget(firmware, compared) if firmware else None,
        "budget_table": tables.tabulate_budget(firmware, compared) if firmware else None,
        "chip_error": tables.tabulate_chip_error(firmware) if firmware else None,
        "firmware": tables.tabulate_firmware(firmware) if firmware else None,
        "certificate": tables.tabulate_certificate(certificate) if certificate else None,
        "datasheet": tables.tabulate_datasheet(datasheet) if datasheet is not None else None,
        "files": files,
        "versions": versions,
    }
    return render_template("report.html.j2", values)


@dataclass(frozen=True)
class Section:
    """The figures and tables of one output."""

    name: str
    unit: str
    runs: go.Figure
    parts: tables.Table
    residual: go.Figure
    means: tables.Table
    correlation: go.Figure
    shares: tables.Table


def list_sections(findings: Findings) -> list[Section]:
    """Return the figures of each output."""
    lines = len(findings.traces) * len(findings.outputs) * 3
    most = min(max(POINTS_OF_ALL_LINES // max(lines, 1), FEWEST_POINTS), MOST_POINTS)
    compared = findings.comparison
    sections = []
    for k, name in enumerate(findings.outputs):
        unit = findings.units[k]
        residual = draw_residual(findings.traces, compared, name)
        correlation = draw_autocorrelation(findings.traces, compared, name)
        (bars,) = correlation.data
        sections.append(
            Section(
                name=name,
                unit=unit,
                runs=draw_output(findings.traces, compared, name, most=most),
                parts=tables.tabulate_parts(list_parts(findings.traces, k), unit),
                residual=residual,
                means=tables.tabulate_means(list_means(residual), unit),
                correlation=correlation,
                shares=tables.tabulate_autocorrelation(bars.x, bars.y),
            )
        )
    return sections


def list_figures(findings: Findings) -> dict[str, go.Figure]:
    """Return every figure of the report by a name for its file."""
    firmware, explained = findings.firmware, findings.diagnosed
    figures: dict[str, go.Figure] = {}
    if findings.steps:
        figures["staircase"] = draw_staircase(findings.steps)
    if explained is not None and explained.diagnosis.candidates:
        figures["candidates"] = draw_candidates(explained.diagnosis)
    for section in list_sections(findings):
        figures[f"{section.name}_runs"] = section.runs
        figures[f"{section.name}_residual"] = section.residual
        figures[f"{section.name}_correlation"] = section.correlation
    if firmware is not None:
        figures["error_budget"] = draw_budget(firmware, findings.comparison)
    return figures


def list_notes(findings: Findings) -> list[str]:
    """Return what the commands noted, each once."""
    of_diagnosis = findings.diagnosed.diagnosis.remarks if findings.diagnosed is not None else ()
    return list(dict.fromkeys((*findings.notes, *of_diagnosis)))


def list_tiles(findings: Findings) -> list[tuple[str, str]]:
    """Return the few figures that come first: value, and what it is."""
    outputs, explained = findings.comparison.outputs, findings.diagnosed
    name, worst = max(outputs.items(), key=lambda item: item[1].rmse_pct_fs)
    where = "held out" if worst.rmse_heldout is not None else "in sample"
    tiles = [
        (
            f"{worst.rmse_pct_fs:.2g} %FS",
            f"largest RMSE of an output ({name}, {where})",
        )
    ]
    least = min(output.explained for output in outputs.values())
    tiles.append((f"{100.0 * least:.1f} %", "of the drift's mean square taken away, or more"))
    if explained is not None:
        diagnosis = explained.diagnosis
        source = "measured on a dwell" if diagnosis.noise_floor_source == "dwell" else "estimated"
        tiles.append(
            (
                f"{diagnosis.floor_ratio_before:.2f} ×",
                f"held-out error of the effects over the noise floor, {source}",
            )
        )
    tiles.append((str(len(findings.traces)), "runs shown, dwell not among them"))
    firmware = findings.firmware
    if firmware is not None:
        tiles.append((f"{firmware.flash_bytes} B", f"of flash on {firmware.core}"))
    return tiles
