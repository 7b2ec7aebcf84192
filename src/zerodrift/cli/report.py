"""`zerodrift report`: all that is known about a sensor and its model in one file."""

from pathlib import Path
from typing import TypedDict, Unpack

import click

from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import show_progress
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.report import FOLDERS, FORMATS, ReportRequest, report


class ReportOptions(TypedDict):
    """Those that the request takes as they are."""

    kind: str
    out: Path | None
    datasheet: bool
    annex: Path | None
    dcc: Path | None


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
def command(
    directory: Path,
    sensor: str | None,
    no_diagnose: bool,
    as_json: bool,
    skip_invalid: bool,
    **options: Unpack[ReportOptions],
) -> None:
    """Write a report: verdict, errors, causes, staircase, effects, firmware, provenance.

    The HTML file holds everything it needs, so it opens without a network, and prints. The same
    files give the same bytes.
    """
    project = ProjectFolder(directory, sensor, skip_invalid)
    request = ReportRequest(project, diagnose=not no_diagnose, **options)
    with show_progress() as progress:
        found = report(request, progress)
    print_notes(found.result.notes)
    if as_json:
        print_result(found.result)
        return
    if found.result.diagnose is None:
        click.echo("Not diagnosed.")
    if request.kind in FOLDERS:
        click.echo(f"Wrote pictures: {request.target}")
    else:
        click.echo(f"Wrote {found.files[0]}")
    if request.annex is not None:
        click.echo(f"Wrote tables: {request.annex}")
    if request.dcc is not None:
        click.echo(f"Wrote {request.dcc}")
