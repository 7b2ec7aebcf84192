"""The report's tables as CSV files: all of them, also those that a page of ten leaves out."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.base.csv_text import render_rows
from zerodrift.report import tables
from zerodrift.report.conversions import tabulate_conversions
from zerodrift.report.findings import Findings
from zerodrift.report.parts import list_parts
from zerodrift.report.tables import Table


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
