"""All that is known about a sensor and its model in one file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.calibration_config import name_unit, require_complete
from zerodrift.base.config import load_config, locate_key
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all, write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.report.browser import find_browser, print_page, write_pictures
from zerodrift.report.datasheet import DatasheetRow, measure_datasheet
from zerodrift.report.dcc import describe_sensor, render_certificate
from zerodrift.report.findings import Findings
from zerodrift.report.report import list_annex, list_pictures, render_report
from zerodrift.report.results import CompareResult, HistoryResult, ReportResult
from zerodrift.report.tables import tabulate_datasheet
from zerodrift.tasks.diagnose import summarise_diagnosis
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.survey import SurveyRequest, survey
from zerodrift.tasks.trust import require_trust

FORMATS = ("html", "pdf", "svg", "png")
FOLDERS = ("svg", "png")
"""Formats of which each picture is a file of its own."""
NAMES = {
    "html": "report.html",
    "pdf": "report.pdf",
    "svg": "report_figures",
    "png": "report_figures",
}


@dataclass(frozen=True)
class ReportRequest:
    """Which report is wanted, and where."""

    project: ProjectFolder
    kind: str = "html"
    """One of `FORMATS`."""
    out: Path | None = None
    """None: one of `NAMES` in the project's folder."""
    datasheet: bool = False
    """Whether it has TK0, TKC, creep, hysteresis and repeatability."""
    annex: Path | None = None
    """Folder for the tables as CSV."""
    dcc: Path | None = None
    """Where the digital calibration certificate goes."""
    diagnose: bool = True
    """Whether to diagnose where no diagnosis of these logs is kept."""

    @property
    def target(self) -> Path:
        """Where it is written."""
        return self.out or self.project.directory / NAMES[self.kind]


@dataclass(frozen=True)
class ReportOutcome:
    """The report."""

    result: ReportResult
    files: tuple[Path, ...]
    """The report's own first."""


def report(request: ReportRequest, progress: Progress = SILENT) -> ReportOutcome:
    """Write a report: verdict, errors, causes, staircase, effects, firmware, provenance.

    Raises:
        InputError: a place cannot be written, [calibration] lacks something, or a log is wrong.
    """
    project, kind, target = request.project, request.kind, request.target
    directory, annex, dcc = project.directory, request.annex, request.dcc
    config = load_config(directory)
    require_trust(config.plugin_files, directory, progress)
    calibration = None
    if dcc is not None:
        calibration = name_unit(config.calibration, project.sensor)
        require_complete(calibration, locate_key(config.path, "calibration"))
        _check_target(dcc, "dcc", "--dcc")
    _check_target(target, kind)
    if kind in ("pdf", "png"):
        find_browser()
    wanted = SurveyRequest(project, request.diagnose, wants_contribution=True)
    findings = survey(wanted, progress)
    rows, certificate = None, None
    if request.datasheet or calibration is not None:
        progress("measuring the datasheet's figures")
        rows = measure_datasheet(findings.traces, findings.comparison, findings.uncertainty)
    if rows is not None and calibration is not None:
        certificate = render_certificate(rows, describe_sensor(findings), calibration)
    if not request.datasheet:
        rows = None
    progress("drawing")
    files = _write(findings, rows, target, kind, directory)
    if annex is not None:
        files += _write_annex(findings, rows, annex, directory)
    if certificate is not None and dcc is not None:
        files.append(_write_certificate(certificate, dcc, directory))
    return ReportOutcome(summarise_survey(findings, files, rows), tuple(files))


def _check_target(target: Path, kind: str, option: str = "--out") -> None:
    """Refuse a path that cannot be written, before anything is computed.

    Raises:
        InputError: the folder is missing, or the path is not an ordinary file.
    """
    if not target.parent.is_dir():
        raise InputError(
            f"{target.parent}: is no directory; expected one for the report. Make it, or name "
            f"another place by {option}."
        )
    if kind in FOLDERS and target.exists() and not target.is_dir():
        raise InputError(f"{target}: is a file; expected a directory for the figures (--out).")
    if kind not in FOLDERS and target.is_dir():
        raise InputError(f"{target}: is a directory; expected the name of a file ({option}).")


def _write(
    findings: Findings,
    rows: Sequence[DatasheetRow] | None,
    target: Path,
    kind: str,
    directory: Path,
) -> list[Path]:
    """Write the report, or its figures; return the files.

    Raises:
        InputError: a file cannot be written; none is left behind.
    """
    try:
        if kind in FOLDERS:
            return write_pictures(list_pictures(findings), target, directory, (kind,))
        text = render_report(findings, rows)
        if kind == "pdf":
            print_page(text, target, directory)
        else:
            write_text(target, text, directory)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); nothing of it was kept. Make room, "
            "or name another place by --out."
        ) from error
    return [target]


def _write_certificate(text: str, target: Path, directory: Path) -> Path:
    """Write the certificate as one change.

    Raises:
        InputError: it cannot be written; nothing of it is left behind.
    """
    try:
        write_text(target, text, directory)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); nothing of it was kept. Make room, "
            "or name another place by --dcc."
        ) from error
    return target


def _write_annex(
    findings: Findings, rows: Sequence[DatasheetRow] | None, annex: Path, directory: Path
) -> list[Path]:
    """Write the report's tables as CSV files, all as one change; return the files."""
    further = {"datasheet": tabulate_datasheet(rows)} if rows is not None else None
    files = {annex / one.name: one.text.encode() for one in list_annex(findings, further)}
    write_all(directory, dict(files))
    return list(files)


def summarise_survey(
    findings: Findings, files: Sequence[Path], datasheet: Sequence[DatasheetRow] | None
) -> ReportResult:
    """Return the record that `report --json` prints.

    Args:
        findings: the results for the project.
        files: the files that were written.
        datasheet: its figures, where they were asked for.
    """
    explained, advice = findings.diagnosed, findings.advice
    diagnose = None
    if explained is not None:
        diagnose = summarise_diagnosis(
            explained.diagnosis, explained.command, explained.thermometers, None, Path()
        )
    return ReportResult(
        sensor=findings.sensor,
        simulated=findings.simulated,
        compare=CompareResult(
            **vars(findings.comparison),
            model=findings.predictor,
            notes=findings.reviewed,
            advice=advice.summarise() if advice is not None else None,
            uncertainty=findings.uncertainty,
        ),
        compare_sentences=findings.comparison_sentences,
        patterns=findings.patterns,
        diagnose=diagnose,
        diagnose_sentences=tuple(s.text for s in explained.sentences) if explained else (),
        history=HistoryResult(tuple(step.summarise() for step in findings.steps)),
        model=findings.model,
        firmware=findings.firmware,
        certificate=findings.certificate,
        firmware_note=findings.firmware_note,
        titles=findings.titles,
        catalogue=findings.catalogue,
        provenance=findings.provenance,
        notes=findings.notes,
        skip_invalid=findings.skip_invalid,
        files=tuple(str(path) for path in files),
        datasheet=None if datasheet is None else tuple(datasheet),
    )
