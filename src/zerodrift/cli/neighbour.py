"""`zerodrift neighbour`: the model in the forms that PX4, ArduPilot and chrony take."""

from dataclasses import dataclass
from pathlib import Path

import click

from zerodrift.cli.common import (
    directory_option,
    json_option,
    packed,
    print_notes,
    print_result,
    sensor_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress

NAMES = (
    *("px4-accel", "px4-gyro", "px4-baro", "ardupilot-accel", "ardupilot-gyro"),
    *("chrony", "chrony-points", "polynomial"),
)


@dataclass(frozen=True)
class NeighbourOptions:
    """The options of `neighbour`."""

    outputs: tuple[str, ...]
    device: int | None
    order: int
    out: Path | None


@click.command()
@click.argument("kind", type=click.Choice(NAMES))
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
@packed(NeighbourOptions)
def command(
    kind: str,
    logs: tuple[Path, ...],
    directory: Path,
    sensor: str | None,
    as_json: bool,
    options: NeighbourOptions,
) -> None:
    """Write the model of the last `firmware` as another program takes it, and what it loses.

    They take a polynomial in the temperature and nothing else: memory, load and other inputs are
    lost. The loss is stated in the sensor's unit against the full model, over LOG... (default:
    those of [logs]) and over the calibrated range.
    """
    from zerodrift.base.errors import InputError
    from zerodrift.base.files import write_whole
    from zerodrift.field.neighbours import KINDS
    from zerodrift.field.summary import NeighbourResult
    from zerodrift.fleet.sensors import load_unit
    from zerodrift.tasks.applied_model import open_applied
    from zerodrift.tasks.neighbours import render_neighbour
    from zerodrift.tasks.watched import load_nothing

    config = load_unit(directory, sensor)
    applied = open_applied(config, load_logs=load_nothing)
    place = options.out if options.out is not None else Path(KINDS[kind].file)
    if place.exists() and "written by zerodrift" not in place.read_text("utf-8", "replace")[:200]:
        raise InputError(
            f"{place}: is there and was not written by `zerodrift neighbour`; expected a new file."
            " Move it, or name another by --out."
        )
    with show_progress("reading") as say:
        told = render_neighbour(
            config,
            applied.model,
            kind,
            outputs=options.outputs,
            device=options.device,
            order=options.order,
            logs=logs,
            say=say,
        )
    write_whole(place, told.text.encode())
    if as_json:
        print_result(NeighbourResult(kind, applied.model.hash, str(place), told.lost, told.notes))
        return
    print_notes((*applied.notes, *told.notes))
    table = open_table(
        f"{kind}: lost against the full model",
        ("output", "unit"),
        ("RMS, logs", "worst, logs", "RMS, range", "worst, range", "RMS drift, range"),
    )
    for name, one in told.lost.items():
        values = (one.rms_logs, one.worst_logs, one.rms_range, one.worst_range, one.rms_drift)
        table.add_row(name, one.unit, *("-" if v is None else f"{v:.3g}" for v in values))
    console = open_console()
    console.print(table)
    console.print(f"wrote {place}")
