"""`zerodrift report`: all that is known about a sensor and its model in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.cli.common import (
    directory_option,
    json_option,
    packed,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import show_progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zerodrift.report.datasheet import DatasheetRow
    from zerodrift.report.findings import Findings


@dataclass(frozen=True)
class ReportOptions:
    """The options of `report`."""

    kind: str
    """One of `FORMATS`."""
    out: Path | None
    datasheet: bool
    annex: Path | None
    """Folder for the tables as CSV."""
    no_diagnose: bool
    dcc: Path | None = None
    """Where the digital calibration certificate goes."""


FORMATS = ("html", "pdf", "svg", "png")
FOLDERS = ("svg", "png")
"""Formats of which each picture is a file of its own."""


@click.command()
@directory_option
@sensor_option
@click.option(
    "--format",
    "kind",
    type=click.Choice(FORMATS),
    default="html",
    show_default=True,
    help="One HTML file; the same printed to PDF; or a folder of pictures as SVG or PNG. PDF and "
    "PNG need Chromium or Chrome on this machine.",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    help="Where to write (default: report.html, report.pdf or report_figures/ in DIR).",
)
@click.option(
    "--datasheet",
    is_flag=True,
    help="Add TK0, TKC, creep, hysteresis and repeatability before and after compensation.",
)
@click.option(
    "--annex",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    help="Write the report's tables as CSV files into this folder, too.",
)
@click.option(
    "--dcc",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Write the datasheet's figures as a digital calibration certificate (DCC, XML), too. "
    "Laboratory, persons, standards and item come from [calibration] in zerodrift.toml.",
)
@click.option(
    "--no-diagnose",
    is_flag=True,
    help="Do not diagnose; a diagnosis of these very logs that is kept in build/ is shown.",
)
@trust_option
@json_option
@skip_invalid_option
@packed(ReportOptions)
def command(
    directory: Path,
    sensor: str | None,
    options: ReportOptions,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Write a report: verdict, errors, causes, staircase, effects, firmware, provenance.

    The HTML file holds everything it needs, so it opens without a network, and prints. The same
    files give the same bytes.
    """
    from zerodrift.base.calibration_config import name_unit, require_complete
    from zerodrift.base.config import load_config, locate_key
    from zerodrift.report.browser import find_browser
    from zerodrift.report.datasheet import measure_datasheet
    from zerodrift.report.dcc import describe_sensor, render_certificate
    from zerodrift.tasks.survey import summarise_survey, survey_project
    from zerodrift.tasks.trust import require_trust

    config = load_config(directory)
    with show_progress() as progress:
        require_trust(config.plugin_files, directory, progress)
    calibration = None
    if options.dcc is not None:
        calibration = name_unit(config.calibration, sensor)
        require_complete(calibration, locate_key(config.path, "calibration"))
        _check_target(options.dcc, "dcc", "--dcc")
    kind, annex = options.kind, options.annex
    target = options.out or directory / {"html": "report.html", "pdf": "report.pdf"}.get(
        kind, "report_figures"
    )
    _check_target(target, kind)
    if kind in ("pdf", "png"):
        find_browser()
    with show_progress("reading logs") as say:
        findings = survey_project(
            directory,
            sensor=sensor,
            skip_invalid=skip_invalid,
            wants_diagnosis=not options.no_diagnose,
            wants_contribution=True,
            say=say,
        )
        rows, certificate = None, None
        if options.datasheet or calibration is not None:
            say("measuring the datasheet's figures")
            rows = measure_datasheet(findings.traces, findings.comparison, findings.uncertainty)
        if rows is not None and calibration is not None:
            certificate = render_certificate(rows, describe_sensor(findings), calibration)
        if not options.datasheet:
            rows = None
        say("drawing")
        files = _write(findings, rows, target, kind, directory)
        if annex is not None:
            files += _write_annex(findings, rows, annex, directory)
        if certificate is not None and options.dcc is not None:
            files.append(_write_certificate(certificate, options.dcc, directory))
    print_notes(findings.notes)
    if as_json:
        print_result(summarise_survey(findings, files, rows))
        return
    if findings.diagnosed is None:
        click.echo("Not diagnosed.")
    if kind in FOLDERS:
        click.echo(f"Wrote pictures: {target}")
    else:
        click.echo(f"Wrote {files[0]}")
    if annex is not None:
        click.echo(f"Wrote tables: {annex}")
    if options.dcc is not None:
        click.echo(f"Wrote {options.dcc}")


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
    findings: "Findings",
    rows: "Sequence[DatasheetRow] | None",
    target: Path,
    kind: str,
    directory: Path,
) -> list[Path]:
    """Write the report, or its figures; return the files.

    Raises:
        InputError: a file cannot be written; none is left behind.
    """
    from zerodrift.report.browser import print_page, write_pictures
    from zerodrift.report.report import list_pictures, render_report

    try:
        if kind in FOLDERS:
            return write_pictures(list_pictures(findings), target, directory, kind)
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
    findings: "Findings", rows: "Sequence[DatasheetRow] | None", annex: Path, directory: Path
) -> list[Path]:
    """Write the report's tables as CSV files, all as one change; return the files."""
    from zerodrift.base.journal import write_all
    from zerodrift.report.annex import list_annex
    from zerodrift.report.tables import tabulate_datasheet

    further = {"datasheet": tabulate_datasheet(rows)} if rows is not None else None
    files = {annex / one.name: one.text.encode() for one in list_annex(findings, further)}
    write_all(directory, dict(files))
    return list(files)
