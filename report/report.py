"""The report: one self-contained page that says what is known about a sensor and its model."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from zerodrift.diagnosis.history import Step
from zerodrift.report import tables
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


def read_steps(history: Mapping[str, Any]) -> list[Step]:
    """Return the staircase from the JSON of `history`."""
    return [
        Step(
            label=step["step"],
            errors=step["rmse_heldout"],
            noise_floor=step["noise_floor"],
            units=step["units"],
            effects=tuple(step["effects"]),
            reason=step["reason"],
        )
        for step in history["steps"]
    ]


def render_report(findings: Findings, datasheet: Sequence[Mapping[str, Any]] | None = None) -> str:
    """Return the report as HTML: nothing in it is fetched from elsewhere, and it holds no date.

    Args:
        findings: what the commands found.
        datasheet: the datasheet's figures, where they were asked for.
    """
    told = findings.told
    steps = read_steps(told["history"])
    diagnosed, firmware, certificate = told["diagnose"], told["firmware"], told["certificate"]
    files, versions = tables.tabulate_provenance(told["provenance"])
    values: dict[str, Any] = {
        "findings": findings,
        "told": told,
        "title": f"{findings.sensor}: drift and its compensation",
        "headline": write_headline(diagnosed, told["titles"]),
        "details": list_details(told["diagnose_sentences"]),
        "notes": list(dict.fromkeys((*told["notes"], *(diagnosed or {}).get("notes", ())))),
        "tiles": list_tiles(findings),
        "staircase": draw_staircase(steps) if steps else None,
        "steps": tables.tabulate_steps(told["history"]),
        "outputs": tables.tabulate_outputs(told["compare"]),
        "runs": tables.tabulate_runs(told["compare"]),
        "worst": tables.tabulate_worst(told["compare"]),
        "candidates": draw_candidates(diagnosed) if diagnosed and diagnosed["candidates"] else None,
        "candidates_table": tables.tabulate_candidates(diagnosed, told["titles"])
        if diagnosed
        else None,
        "sections": list_sections(findings),
        "moving": find_threshold([t for t in findings.traces if t.held_out] or findings.traces),
        "parameters": tables.tabulate_parameters(told["model"]),
        "coefficients": tables.tabulate_coefficients(told["model"]),
        "budget": draw_budget(firmware, told["compare"]) if firmware else None,
        "budget_table": tables.tabulate_budget(firmware, told["compare"]) if firmware else None,
        "chip_error": tables.tabulate_chip_error(firmware) if firmware else None,
        "firmware": tables.tabulate_firmware(firmware) if firmware else None,
        "certificate": tables.tabulate_certificate(certificate) if certificate else None,
        "datasheet": tables.tabulate_datasheet(datasheet) if datasheet is not None else None,
        "files": files,
        "versions": versions,
    }
    return render_template("report.html.j2", values)


def list_sections(findings: Findings) -> list[dict[str, Any]]:
    """Return the figures of each output."""
    lines = len(findings.traces) * len(findings.outputs) * 3
    most = min(max(POINTS_OF_ALL_LINES // max(lines, 1), FEWEST_POINTS), MOST_POINTS)
    compared = findings.told["compare"]
    sections = []
    for k, name in enumerate(findings.outputs):
        unit = findings.units[k]
        residual = draw_residual(findings.traces, compared, name)
        correlation = draw_autocorrelation(findings.traces, compared, name)
        (bars,) = correlation.data
        sections.append(
            {
                "name": name,
                "unit": unit,
                "runs": draw_output(findings.traces, compared, name, most=most),
                "parts": tables.tabulate_parts(list_parts(findings.traces, k), unit),
                "residual": residual,
                "means": tables.tabulate_means(list_means(residual), unit),
                "correlation": correlation,
                "shares": tables.tabulate_autocorrelation(bars.x, bars.y),
            }
        )
    return sections


def list_figures(findings: Findings) -> dict[str, go.Figure]:
    """Return every figure of the report by a name for its file."""
    told = findings.told
    figures: dict[str, go.Figure] = {}
    if told["history"]["steps"]:
        figures["staircase"] = draw_staircase(read_steps(told["history"]))
    if told["diagnose"] and told["diagnose"]["candidates"]:
        figures["candidates"] = draw_candidates(told["diagnose"])
    for section in list_sections(findings):
        for kind in ("runs", "residual", "correlation"):
            figures[f"{section['name']}_{kind}"] = section[kind]
    if told["firmware"]:
        figures["error_budget"] = draw_budget(told["firmware"], told["compare"])
    return figures


def list_details(sentences: Sequence[str]) -> list[str]:
    """Return the verdict's sentences without those that the headline says already."""
    said = (
        "Held-out error:",
        "Missing beside it:",
        "These logs cannot tell",
        "Nearest, and not it",
    )
    return [sentence for sentence in sentences[1:] if not sentence.startswith(said)]


def list_tiles(findings: Findings) -> list[tuple[str, str]]:
    """Return the few figures that come first: value, and what it is."""
    compared, diagnosed = findings.told["compare"], findings.told["diagnose"]
    worst = max(compared["outputs"].items(), key=lambda item: item[1]["rmse_pct_fs"])
    where = "held out" if worst[1]["rmse_heldout"] is not None else "in sample"
    tiles = [
        (
            f"{worst[1]['rmse_pct_fs']:.2g} %FS",
            f"largest RMSE of an output ({worst[0]}, {where})",
        )
    ]
    explained = min(told["explained"] for told in compared["outputs"].values())
    tiles.append((f"{100.0 * explained:.1f} %", "of the drift's mean square taken away, or more"))
    if diagnosed is not None:
        source = "measured on a dwell" if diagnosed["floor"] == "dwell" else "estimated"
        tiles.append(
            (
                f"{diagnosed['floor_ratio_before']:.2f} ×",
                f"held-out error of the effects over the noise floor, {source}",
            )
        )
    tiles.append((str(len(findings.traces)), "runs shown, dwell not among them"))
    firmware = findings.told["firmware"]
    if firmware is not None:
        tiles.append((f"{firmware['flash_bytes']} B", f"of flash on {firmware['core']}"))
    return tiles
