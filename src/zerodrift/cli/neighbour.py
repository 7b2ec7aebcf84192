"""`zerodrift neighbour`: the model in the forms that PX4, ArduPilot and chrony take."""

from pathlib import Path

import click

from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.field.neighbours import KINDS
from zerodrift.tasks.neighbour import NeighbourRequest, write_neighbour


@click.command()
@click.argument("kind", type=click.Choice(tuple(KINDS)))
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path, exists=True))
@directory_option
@sensor_option
@click.option(
    "--output",
    "outputs",
    multiple=True,
    metavar="NAME",
    help="An output, in the order of the axes X, Y, Z (default: all).",
)
@click.option(
    "--device",
    type=click.IntRange(0, 9),
    default=None,
    help="Number of the sensor in the parameters' names (default: PX4 0, ArduPilot 1).",
)
@click.option(
    "--order",
    type=click.IntRange(0, 9),
    default=3,
    show_default=True,
    help="Of `polynomial`.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    metavar="FILE",
    help="The file to be written (default: a name for each kind, in the current directory).",
)
@json_option
@as_request(NeighbourRequest)
def command(request: NeighbourRequest, as_json: bool) -> None:
    """Write the model of the last `firmware` as another program takes it, and what it loses.

    They take a polynomial in the temperature and nothing else: memory, load and other inputs are
    lost. The loss is stated in N or the like, against the full model, over LOG... (default:
    those of [logs]) and over the calibrated range.
    """
    with show_progress("reading") as progress:
        found = write_neighbour(request, progress)
    told = found.result
    if as_json:
        print_result(told)
        return
    print_notes(found.notes)
    table = open_table(
        f"{told.kind}: lost against the full model",
        ("output", "unit"),
        ("RMS, logs", "worst, logs", "RMS, range", "worst, range", "RMS drift, range"),
    )
    for name, one in told.lost.items():
        values = (one.rms_logs, one.worst_logs, one.rms_range, one.worst_range, one.rms_drift)
        table.add_row(name, one.unit, *("-" if v is None else f"{v:.3g}" for v in values))
    console = open_console()
    console.print(table)
    console.print(f"wrote {told.file}")
