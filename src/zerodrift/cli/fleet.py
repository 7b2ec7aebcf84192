"""`zerodrift fleet`: hundreds of sensors of one design, each to checked C, and the yield."""

import sys
from pathlib import Path

import click

from zerodrift.base.errors import CheckError
from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    out_option,
    print_result,
    skip_invalid_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.fleet.blocks import FleetBlocks
from zerodrift.fleet.report import ERROR, FAIL, FORCED, PASS, FleetReport, tell_forced
from zerodrift.tasks.fleet import DEVICES, FleetRequest, calibrate_fleet

SHOWN = 10
"""Sensors of each kind that the terminal shows; the report has all."""


@click.command("fleet")
@directory_option
@json_option
@skip_invalid_option
@click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    default=None,
    help="Processes on this machine (default: one per core; 1 with a GPU).",
)
@click.option(
    "--batch",
    type=click.IntRange(1, 100_000),
    default=None,
    help="Sensors that are compiled, and trained, together (default: 16; 32 with a network).",
)
@click.option(
    "--firmware/--no-firmware",
    "with_firmware",
    default=True,
    help="Generate and check each sensor's C (default), or only fit, train and report.",
)
@click.option(
    "--force",
    is_flag=True,
    help="Write what the gate refuses; header, manifest and report say so.",
)
@click.option("--fresh", is_flag=True, help="Compute every sensor anew, kept results too.")
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default="auto",
    show_default=True,
    help="What trains the networks: a GPU if PyTorch has one, or what is named.",
)
@click.option("--ray", "over_ray", is_flag=True, help="Work over Ray instead of --jobs alone.")
@click.option(
    "--ray-address",
    metavar="ADDRESS",
    default=None,
    help="Of a running cluster, such as auto or 10.0.0.5:6379; implies --ray.",
)
@click.option(
    "--uncertainty/--no-uncertainty",
    default=True,
    help="Fit, or train, each sensor again without some of its runs, for the uncertainty of a"
    " compensated value (default), or state none.",
)
@out_option
@as_request(FleetRequest)
def command(request: FleetRequest, as_json: bool) -> None:
    """Calibrate all sensors of one design: fit, train, generate, check, and report the yield.

    The design is zerodrift.toml; {sensor} in [fleet] folder or in the selectors of [logs] stands
    for a sensor's name. Writes firmware/SENSOR/ with header, source, parameters and certificate,
    the shared firmware/runtime/, and build/fleet/report.json, .csv and .md. With [firmware]
    coefficients = "block" one firmware/program/ in their place, and firmware/blocks/SENSOR.*.

    A second call works only on sensors whose logs or design have changed, or that failed. A bad log
    spoils its own sensor only. Exit code 1: a sensor has no result, is refused by the gate and not
    forced, or exceeds a limit.
    """
    with show_progress() as progress:
        found = calibrate_fleet(request, progress)
    if as_json:
        print_result(found.result)
    else:
        directory = request.project.config.directory
        _print(found.report, [str(path) for path in found.files], directory)
        if found.blocks is not None:
            _print_blocks(found.blocks)
    if found.no_program is not None:
        raise found.no_program
    if found.fails:
        sys.exit(CheckError.exit_code)


def _print_blocks(blocks: FleetBlocks) -> None:
    """Print the one program and the units that have a block for it."""
    for sensor, why in blocks.refused.items():
        click.echo(f"no block for {sensor}: {why}", err=True)
    click.echo(
        f"one program (design {blocks.program[:16]}) and {len(blocks.units)} blocks of"
        f" {blocks.bytes} bytes; {blocks.vectors} steps on reference = host, 0 LSB"
    )


def _print(report: FleetReport, paths: list[str], directory: Path) -> None:
    """Print yield, spread, and the first sensors of each kind that need a look."""
    console = open_console()
    total = len(report.verdicts)
    kept = sum(v.kept for v in report.verdicts)
    if report.results:
        table = open_table(
            "Held-out RMSE over the fleet",
            ("output", "unit"),
            ("uncompensated", "median", "95 %", "worst", "floor", "x floor", "worst", "limit"),
        )
        for name, row in report.spread().items():
            errors = (row.rmse_uncompensated_median, row.rmse_median, row.rmse_p95, row.rmse_worst)
            numbers = [f"{value:.4g}" for value in (*errors, row.noise_floor_median)]
            numbers += [f"{row.ratio_median:.3g}", f"{row.ratio_worst:.3g}"]
            limit = "-" if row.limit is None else f"{row.limit:g}"
            table.add_row(name, row.unit, *numbers, limit)
        console.print(table)
    for title, lines in (
        ("could not be worked on", _explain(report, ERROR)),
        ("fail", _explain(report, FAIL)),
        ("forced", _explain(report, FORCED)),
        ("outliers", [f"{v.sensor}: {v.outliers[0]}" for v in report.outliers]),
    ):
        if lines:
            console.print(f"{title}:")
            for line in lines[:SHOWN]:
                console.print(f"  {line}")
            if len(lines) > SHOWN:
                console.print(f"  ... and {len(lines) - SHOWN} more, in the report")
    passed = report.count(PASS)
    console.print(
        f"{passed} of {total} sensors pass ({100.0 * passed / total:.1f} %),{tell_forced(report)}"
        f" {report.count(FAIL)} fail, {report.count(ERROR)} without result,"
        f" {len(report.outliers)} outliers" + (f"; {kept} kept from earlier runs" if kept else "")
    )
    console.print(_tell_check(report))
    console.print("wrote " + ", ".join(_relative(path, directory) for path in paths))


def _tell_check(report: FleetReport) -> str:
    """Return in a sentence how much was compared bit for bit."""
    checked = [r.vectors for r in report.results if r.vectors]
    if not checked:
        return "no firmware was generated"
    return (
        f"bit-exact: {len(checked)} models on reference = host, {sum(checked)} steps, drift, flags"
        " and states, 0 LSB"
    )


def _explain(report: FleetReport, status: str) -> list[str]:
    """Return a line per sensor of a status, with the first reason."""
    lines = []
    for v in report.verdicts:
        if v.status == status:
            more = f" (and {len(v.reasons) - 1} more)" if len(v.reasons) > 1 else ""
            lines.append(f"{v.sensor}: {v.reasons[0]}{more}")
    return lines


def _relative(path: str, directory: Path) -> str:
    return str(Path(path).relative_to(directory)) if Path(path).is_relative_to(directory) else path
