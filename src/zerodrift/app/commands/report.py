"""`zerodrift report`: all that is known about a sensor and its model in one file."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.app.commands.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    skip_invalid_option,
    trust_option,
)
from zerodrift.app.commands.console import show_progress
from zerodrift.base.errors import InputError
from zerodrift.base.extras import PAGE, require
from zerodrift.base.journal import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zerodrift.report.datasheet import DatasheetRow
    from zerodrift.report.findings import Findings

FORMATS = ("html", "pdf", "png")


@click.command()
@directory_option
@click.option(
    "--format",
    "kind",
    type=click.Choice(FORMATS),
    default="html",
    show_default=True,
    help="One HTML file; the same printed to PDF; or a folder of figures as PNG. PDF and PNG need "
    "Chromium or Chrome on this machine.",
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
    help="Add TK0, TKC, creep and hysteresis before and after compensation.",
)
@click.option(
    "--no-diagnose",
    is_flag=True,
    help="Do not diagnose; a diagnosis of these very logs that is kept in build/ is shown.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    directory: Path,
    kind: str,
    out: Path | None,
    datasheet: bool,
    no_diagnose: bool,
    trust: bool,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Write a report: verdict, staircase, errors, residuals, effects, firmware, provenance.

    The HTML file holds everything it needs, so it opens without a network, and prints. The same
    files give the same bytes.
    """
    require(PAGE, "zerodrift report")
    from zerodrift.app.commands.survey import summarise_survey, survey_project
    from zerodrift.app.trust import require_trust
    from zerodrift.base.config import load_config
    from zerodrift.report.browser import find_browser
    from zerodrift.report.datasheet import measure_datasheet

    require_trust(load_config(directory).plugin_files, trusted=trust)
    target = out or directory / {"html": "report.html", "pdf": "report.pdf"}.get(
        kind, "report_figures"
    )
    _check_target(target, kind)
    if kind != "html":
        find_browser()
    with show_progress("reading logs") as say:
        findings = survey_project(
            directory, skip_invalid=skip_invalid, wants_diagnosis=not no_diagnose, say=say
        )
        rows = None
        if datasheet:
            say("measuring the datasheet's figures")
            rows = measure_datasheet(findings.traces, findings.comparison)
        say("drawing")
        files = _write(findings, rows, target, kind, directory)
    print_notes(findings.notes)
    if as_json:
        print_result(summarise_survey(findings, files, rows))
        return
    if findings.diagnosed is None:
        click.echo("Not diagnosed.")
    click.echo(f"Wrote {files[0]}" if len(files) == 1 else f"Wrote {len(files)} figures: {target}")


def _check_target(target: Path, kind: str) -> None:
    """Refuse a place that cannot be written, before anything is computed.

    Raises:
        InputError: the folder is missing, or something of the wrong kind stands there.
    """
    if not target.parent.is_dir():
        raise InputError(
            f"{target.parent}: is no directory; expected one for the report. Make it, or name "
            "another place by --out."
        )
    if kind == "png" and target.exists() and not target.is_dir():
        raise InputError(f"{target}: is a file; expected a directory for the figures (--out).")
    if kind != "png" and target.is_dir():
        raise InputError(f"{target}: is a directory; expected the name of a file (--out).")


def _write(
    findings: "Findings",
    rows: "Sequence[DatasheetRow] | None",
    target: Path,
    kind: str,
    directory: Path,
) -> list[Path]:
    """Write the report, or its figures; return the files.

    Raises:
        InputError: a file cannot be written; nothing of it is kept.
    """
    from zerodrift.report.browser import picture_pages, print_page
    from zerodrift.report.report import list_figures, render_report

    try:
        if kind == "png":
            return picture_pages(list_figures(findings), target, directory)
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
