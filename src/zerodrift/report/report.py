"""The report: one self-contained page that says what is known about a sensor and its model.

Its pictures are drawn here, as SVG: no script, no browser. What does not fit ten pages is in the
tables that it carries as CSV.
"""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from zerodrift.base.arrays import Array
from zerodrift.base.csv_text import render_rows
from zerodrift.base.plugins import REPORT, load_parts
from zerodrift.base.terminal import tell
from zerodrift.diagnosis.diagnosis import HEADLINE
from zerodrift.diagnosis.drivers import DriftDriver
from zerodrift.diagnosis.run_spread import measure_spread
from zerodrift.report import cause, tables
from zerodrift.report.datasheet import DatasheetRow
from zerodrift.report.findings import Findings
from zerodrift.report.page import render_template
from zerodrift.report.pictures import draw_error_budget, draw_ranking, draw_remainder, draw_stairs
from zerodrift.report.sentences import explain_candidate, write_headline
from zerodrift.report.svg import Picture
from zerodrift.report.tables import Table, list_parts, tabulate_conversions
from zerodrift.report.window import Window

# The report's tables as CSV files: all of them, also those that a page of ten leaves out.


@dataclass(frozen=True)
class AnnexFile:
    """One table as a file."""

    name: str
    title: str
    rows: int
    text: str

    @property
    def link(self) -> str:
        """The file as an address that holds it whole."""
        data = base64.b64encode(self.text.encode()).decode()
        return f"data:text/csv;charset=utf-8;base64,{data}"


def list_annex(findings: Findings, further: Mapping[str, Table] | None = None) -> list[AnnexFile]:
    """Return every table of the findings as CSV.

    Args:
        findings: what the commands found.
        further: name -> table of what is not among them, such as the datasheet's figures.
    """
    compared, explained = findings.comparison, findings.diagnosed
    files, versions = tables.tabulate_provenance(findings.provenance)
    told: dict[str, Table] = {
        "errors": tables.tabulate_outputs(compared),
        "errors_per_run": tables.tabulate_runs(compared),
        "worst_segments": tables.tabulate_worst(compared),
        "parameters": tables.tabulate_parameters(findings.model),
        "coefficients": tables.tabulate_coefficients(findings.model),
        "files": files,
        "versions": versions,
    }
    if findings.steps:
        told["history"] = tables.tabulate_steps(findings.steps)
    if explained is not None:
        told["candidates"] = tables.tabulate_candidates(explained.diagnosis, findings.titles)
    if findings.firmware is not None:
        told["error_budget"] = tables.tabulate_budget(findings.firmware, compared)
        told["chip_error"] = tables.tabulate_chip_error(findings.firmware)
        if conversions := findings.firmware.conversions:
            told["conversions"] = tabulate_conversions(conversions, findings.firmware.error_bound)
    if findings.uncertainty:
        told["uncertainty"] = tables.tabulate_uncertainty(findings.uncertainty)
    if findings.certificate is not None:
        told["certificate"] = tables.tabulate_certificate(findings.certificate)
    for k, name in enumerate(findings.outputs):
        parts = list_parts(findings.traces, k)
        told[f"along_the_runs_{name}"] = tables.tabulate_parts(parts, findings.units[k])
    told |= further or {}
    return [
        AnnexFile(f"{_clean(name)}.csv", table.title, len(table.rows), write_csv(table))
        for name, table in told.items()
        if table.rows
    ]


def write_csv(table: Table) -> str:
    """Return a table as CSV, its numbers with a plain minus sign."""
    rows = ([cell.replace("−", "-") for cell in row] for row in table.rows)
    return render_rows(table.headings, rows)


def _clean(name: str) -> str:
    return "".join(c if c.isalnum() or c in "_-." else "_" for c in name)


# The report: one self-contained page that says what is known about a sensor and its model.

WIDTH = 900.0
"""Pixels of a picture, which a printed page shows at about three quarters."""
MOST_OUTPUTS = 6
"""Outputs that have a picture; the worst in %FS come first."""
MOST_RUNS = 20
"""Runs of a table in the report; more are in the annex alone."""
MOST_WORST = 6
MOST_WHY = 4
"""Candidates of which it is told why they are, or are not, what is missing."""
MOST_COEFFICIENTS = 24


@dataclass(frozen=True)
class ReportSection:
    """A section that an installed package adds to the report, before the provenance."""

    title: str
    build: Callable[[Findings], Table | Picture | None]
    """What the commands found -> a table, which the annex holds too, or a picture; None: no part.
    """


@dataclass(frozen=True)
class PartSection:
    """A further part as the report shows it."""

    title: str
    table: Table | None
    picture: Picture | None


def list_further(findings: Findings) -> list[PartSection]:
    """Return the parts that installed packages add; one that fails is missing alone."""
    found = []
    for part in load_parts(REPORT, ReportSection):
        try:
            built = part.build(findings)
        except Exception as error:  # noqa: BLE001 - whatever a stranger's code raises
            tell(f"the report's part '{part.title}' is left out: {type(error).__name__}: {error}")
            continue
        if built is not None:
            table, picture = (built, None) if isinstance(built, Table) else (None, built)
            found.append(PartSection(part.title, table, picture))
    return found


@dataclass(frozen=True)
class OutputSection:
    """The cause picture of one output."""

    name: str
    unit: str
    run: str
    held_out: bool
    picture: Picture


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
    told = tables.tabulate_datasheet(datasheet) if datasheet is not None else None
    runs = tables.tabulate_runs(compared)
    parts = list_further(findings)
    annexed = {part.title: part.table for part in parts if part.table is not None}
    annexed |= {"datasheet": told} if told is not None else {}
    values: dict[str, object] = {
        "findings": findings,
        "title": f"{findings.sensor}: drift and its compensation",
        "headline": write_headline(diagnosis, findings.titles),
        "details": [s.text for s in explained.sentences if s.role != HEADLINE] if explained else [],
        "notes": list_notes(findings),
        "tiles": list_tiles(findings),
        "outputs": tables.tabulate_errors(compared, measure_spread(compared)),
        "runs": runs if len(runs.rows) <= MOST_RUNS else None,
        "sections": list_sections(findings),
        "staircase": draw_stairs(steps, WIDTH) if steps else None,
        "steps": tables.tabulate_steps(steps),
        "worst": tables.take_rows(tables.tabulate_worst(compared), MOST_WORST),
        "ranking": draw_ranking(diagnosis, WIDTH) if diagnosis and diagnosis.candidates else None,
        "proposal": findings.proposal,
        "remainder": draw_remainder(findings.proposal.curves, findings.proposal.units, WIDTH)
        if findings.proposal is not None and findings.proposal.curves
        else None,
        "why": [
            (c.effect, findings.titles.get(c.effect, ""), explain_candidate(diagnosis, c))
            for c in diagnosis.candidates[:MOST_WHY]
        ]
        if diagnosis
        else [],
        "parameters": tables.tabulate_parameters(findings.model),
        "coefficients": tables.take_rows(
            tables.tabulate_coefficients(findings.model), MOST_COEFFICIENTS
        ),
        "budget": draw_error_budget(firmware, compared, WIDTH) if firmware else None,
        "budget_table": tables.tabulate_budget(firmware, compared) if firmware else None,
        "chip_error": tables.tabulate_chip_error(firmware) if firmware else None,
        "conversions": tabulate_conversions(firmware.conversions, firmware.error_bound)
        if firmware and firmware.conversions
        else None,
        "uncertainty": tables.tabulate_uncertainty(findings.uncertainty)
        if findings.uncertainty
        else None,
        "firmware": tables.tabulate_firmware(firmware) if firmware else None,
        "certificate": tables.tabulate_certificate(certificate) if certificate else None,
        "datasheet": told,
        "further": parts,
        "annex": list_annex(findings, annexed),
        "files": files,
        "versions": versions,
    }
    return render_template("report.html.j2", values)


def list_sections(findings: Findings) -> list[OutputSection]:
    """Return the cause pictures: of the worst output in full, of the others what tells most."""
    compared = findings.comparison
    ranked = sorted(findings.outputs, key=lambda name: -compared.outputs[name].rmse_pct_fs)
    channels = cause.list_channels(findings)
    sections = []
    for number, name in enumerate(ranked[:MOST_OUTPUTS]):
        k = findings.outputs.index(name)
        run = choose_run(findings, name)
        trace = findings.find_trace(run)
        effect = cause.name_effect(findings)
        suspects = cause.find_suspects(findings, effect, name)
        curves = findings.contribution.curves if findings.contribution is not None else {}
        panes = cause.choose_panes(suspects, channels)
        if number:
            panes = (cause.LEFT, *panes[3:4]) if len(panes) > 3 else (cause.LEFT, *panes[2:3])
        view = cause.CauseView(
            trace=trace,
            output=name,
            window=Window(run),
            panes=panes,
            against=cause.choose_against(suspects),
            effect=effect if run in curves else "",
            contribution=curves[run][k] if run in curves else None,
            width=WIDTH,
        )

        def read(driver: DriftDriver, of: str = run) -> Array:
            return cause.read_driven(findings, findings.find_trace(of), driver)

        drawn = cause.draw_cause(view, compared, channels, read)
        sections.append(OutputSection(name, findings.units[k], run, trace.held_out, drawn.picture))
    return sections


def choose_run(findings: Findings, output: str) -> str:
    """Return the run that shows an output's error best: that of its worst segment, or the worst."""
    compared = findings.comparison
    worst = next((s.run for s in compared.worst if s.output == output), None)
    if worst is not None:
        return worst
    names = [trace.run for trace in findings.traces]
    told = [name for name in names if output in compared.errors.get(name, {})]
    return max(told, key=lambda name: compared.errors[name][output].rmse, default=names[0])


def list_pictures(findings: Findings) -> dict[str, Picture]:
    """Return every picture of the report by a name for its file."""
    firmware, explained = findings.firmware, findings.diagnosed
    pictures: dict[str, Picture] = {}
    if findings.steps:
        pictures["staircase"] = draw_stairs(findings.steps, WIDTH)
    if explained is not None and explained.diagnosis.candidates:
        pictures["candidates"] = draw_ranking(explained.diagnosis, WIDTH)
    for section in list_sections(findings):
        pictures[f"{section.name}_cause"] = section.picture
    if firmware is not None:
        pictures["error_budget"] = draw_error_budget(firmware, findings.comparison, WIDTH)
    return pictures


def list_notes(findings: Findings) -> list[str]:
    """Return what the commands noted, each once."""
    of_diagnosis = findings.diagnosed.diagnosis.remarks if findings.diagnosed is not None else ()
    return list(dict.fromkeys((*findings.notes, *of_diagnosis)))


def list_tiles(findings: Findings) -> list[tuple[str, str]]:
    """Return the few figures that come first: value, and what it is."""
    outputs, explained = findings.comparison.outputs, findings.diagnosed
    name, worst = max(outputs.items(), key=lambda item: item[1].rmse_pct_fs)
    where = tables.describe_held_out(findings.comparison)
    tiles = [
        (
            f"{worst.rmse_pct_fs:.2g} %FS",
            f"largest RMSE of an output ({name}, {where})",
        )
    ]
    least = min(output.explained for output in outputs.values())
    tiles.append((f"{100.0 * least:.1f} %", "explained in the worst output, beyond a constant"))
    if explained is not None:
        diagnosis = explained.diagnosis
        source = "measured on a dwell" if diagnosis.noise_floor_source == "dwell" else "estimated"
        tiles.append(
            (
                f"{diagnosis.floor_ratio_before:.2f} ×",
                f"error of the effects on runs left out over the noise floor, {source}",
            )
        )
    tiles.append((str(len(findings.traces)), "runs shown, dwell not among them"))
    firmware = findings.firmware
    if firmware is not None:
        tiles.append((f"{firmware.flash_bytes} B", f"of flash on {firmware.core}"))
    return tiles
