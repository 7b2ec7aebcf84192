"""`zerodrift calibrate`: the calibration matrix from converter codes and test weights."""

from pathlib import Path

import click

from zerodrift.calibration.files import split_output, summarise_calibration
from zerodrift.calibration.matrix import CalibrationMatrix
from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    print_notes,
    print_result,
    skip_invalid_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.tasks.calibrate import CalibrateRequest, calibrate


@click.command()
@click.argument("logs", nargs=-1, required=True)
@directory_option
@click.option(
    "--adc",
    "channels",
    multiple=True,
    help="Column of converter codes; repeat it [default: adc_1 to adc_6].",
)
@click.option(
    "--reference",
    "references",
    multiple=True,
    help="Column of a reference load; repeat it [default: all that begin with ref_].",
)
@click.option("--squares", is_flag=True, help="Use the squares of the codes too (6 x 12).")
@click.option(
    "--offset-per-log", is_flag=True, help="Give every log an offset of its own: zeros that moved."
)
@click.option(
    "--write",
    "files",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the calibration to FILE.toml, FILE.json or FILE.h; repeat it.",
)
@click.option("--name", default="sensor", show_default=True, help="Prefix of the names in FILE.h.")
@click.option(
    "--apply",
    "targets",
    multiple=True,
    metavar="LOG|DIR",
    help="Turn the codes of further logs into loads; repeat it.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    help="Directory for the logs of --apply.",
)
@click.option("--force", is_flag=True, help="Overwrite logs in the directory of --out.")
@skip_invalid_option
@json_option
@as_request(CalibrateRequest)
def command(request: CalibrateRequest, as_json: bool) -> None:
    """Find the matrix that turns converter codes into loads, by least squares.

    LOGS hold converter codes (adc_1 to adc_6) and the loads of test weights (ref_Fx_N and so on).
    A set of weights that leaves a direction out is refused, and the direction named.
    """
    with show_progress("reading ...") as progress:
        found = calibrate(request, progress)
    print_notes(found.result.notes)
    if as_json:
        print_result(found.result)
        return
    print_calibration(found.fitted)
    for label in found.result.files:
        click.echo(f"wrote {label}")
    if not request.files:
        click.echo("Keep it with --write calibration.toml (or .json, .h).")


def print_calibration(fitted: CalibrationMatrix) -> None:
    """Print matrix, residuals and condition number as tables."""
    console = open_console()
    told = summarise_calibration(fitted)
    table = open_table("Matrix, unit per code", ["output", "unit"], [*told.features, "offset"])
    for k, name in enumerate(fitted.outputs):
        entries = [f"{value:.4e}" for value in fitted.matrix[k].tolist()]
        table.add_row(*split_output(name), *entries, f"{fitted.offset[k]:.4g}")
    console.print(table)
    console.print("The offset belongs to codes at " + ", ".join(f"{c:g}" for c in told.center))
    columns = ["RMSE", "% of span", "largest", "span"]
    columns += ["RMSE held out"] if fitted.held_out is not None else []
    table = open_table("Residuals", ["output", "unit"], columns)
    for k, name in enumerate(fitted.outputs):
        row = [
            f"{fitted.rmse[k]:.4g}",
            f"{100.0 * fitted.rmse[k] / fitted.span[k]:.3f}",
            f"{fitted.largest[k]:.4g}",
            f"{fitted.span[k]:.4g}",
        ]
        if fitted.held_out is not None:
            row.append(f"{fitted.held_out[k]:.4g}")
        table.add_row(*split_output(name), *row)
    console.print(table)
    console.print(
        f"Condition number of the matrix {fitted.condition:.1f}, of the loads "
        f"{fitted.load_condition:.1f}; {fitted.rows} rows."
    )
