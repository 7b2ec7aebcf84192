"""`zerodrift monitor`: the deployed model against new logs, and whether it still holds."""

from pathlib import Path

import click

from zerodrift.base.errors import CheckError
from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.field.summary import MonitorResult
from zerodrift.tasks.monitor import MonitorRequest, list_texts, monitor_unit


@click.command()
@click.argument("sources", nargs=-1, metavar="LOG|SOURCE...")
@directory_option
@sensor_option
@click.option(
    "--block",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    metavar="FILE",
    help="The block on the unit (default: as the registry says, else the one written last).",
)
@click.option(
    "--load",
    "loads",
    multiple=True,
    metavar="OUTPUT=VALUE",
    help="True value of an output in these logs, such as Fz=0 for an unloaded sensor.",
)
@click.option(
    "--when",
    default=None,
    metavar="COLUMN=VALUE",
    help="Only rows with this number in this column have the known load (zero checks).",
)
@click.option(
    "--false-alarms",
    "alarms_per_unit_month",
    type=click.FloatRange(1e-6, 0.5),
    default=0.01,
    show_default=True,
    metavar="RATE",
    help="False alarms per unit and month of 30 days, all outputs together.",
)
@click.option(
    "--learn-days",
    type=click.FloatRange(1.0, 3650.0),
    default=14.0,
    show_default=True,
    help="The first days, which the noise in use is learnt from.",
)
@click.option(
    "--block-hours",
    type=click.FloatRange(0.02, 240.0),
    default=4.0,
    show_default=True,
    help="Samples are averaged over so long before they are tested.",
)
@click.option(
    "--state",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    metavar="FILE",
    help="What is kept from call to call (default: build/monitor.json, of a fleet's unit its own).",
)
@click.option(
    "--metrics",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    metavar="FILE",
    help="Also write Prometheus' text, for node_exporter's textfile collector.",
)
@click.option("--reset", is_flag=True, help="Forget what was seen: the unit was mended or moved.")
@click.option(
    "--every-s",
    type=click.FloatRange(1.0),
    default=3600.0,
    show_default=True,
    help="Of a live source: time of the log between two looks.",
)
@json_option
@skip_invalid_option
@as_request(MonitorRequest)
def command(request: MonitorRequest, as_json: bool) -> None:
    """Hold the model of the last `firmware`, with the unit's block, against new logs of its unit.

    LOG is a file as [logs] names them; SOURCE is - (CSV on standard input) or "command:CMD" (CSV
    that a command prints). Reports flags, the range in use and, where the true value is known,
    whether the zero ages, has stepped, or another model or unit is in use.

    Exit code 1: an alarm stands. The state goes on from call to call; another model begins anew.
    """
    with show_progress() as progress:
        told = monitor_unit(request, progress)
    if as_json:
        print_result(told)
    else:
        print_notes(told.notes)
        _print(told)
    if told.alarm:
        texts = [o.text for o in told.outputs.values() if o.verdict.cause]
        if told.other_unit is not None:
            texts.append(told.other_unit.text)
        raise CheckError("; ".join(texts) + ".")


def _print(told: MonitorResult) -> None:
    console = open_console()
    table = open_table(
        f"{told.sensor}: {told.steps} steps read, {told.steps_in_all} in all",
        ("output", "state"),
        ("RMS residual", "calibrated", "zero moved", "blocks"),
    )
    for name, o in told.outputs.items():
        shown = [
            "-" if value is None else f"{value:.3g} {o.unit}"
            for value in (o.rms_residual, o.uncertainty, o.zero_moved)
        ]
        table.add_row(name, o.state, *shown, str(o.blocks))
    console.print(table)
    for name, used in told.ranges.items():
        console.print(
            f"{name}: {used.low:.4g} .. {used.high:.4g} {used.unit} of"
            f" {used.calibrated_low:.4g} .. {used.calibrated_high:.4g} calibrated"
            + (f"; outside for {100.0 * used.outside:.2g} % of the steps" if used.outside else "")
        )
    for text, count in told.flags.items():
        console.print(f"flag at {count} of {told.steps} steps: {text}")
    for text in list_texts(told):
        console.print(text)
    if told.other_unit is not None:
        console.print(f"{told.sensor}: {told.other_unit.text}")
