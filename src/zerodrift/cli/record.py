"""`zerodrift record`: a log from a live source, and what it still has to cover."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import click

from zerodrift.base.progress import is_watched
from zerodrift.base.terminal import open_terminal
from zerodrift.cli.common import directory_option, json_option, print_result
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.recording.coverage import Covered, CoveredRange
from zerodrift.recording.recorder import Show
from zerodrift.recording.status import explain_missing
from zerodrift.report.results import RecordResult
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.recording import RecordRequest, finish, record, use_log

if TYPE_CHECKING:
    from rich.table import Table

SHOWN_S = 0.5
"""Between two pictures on the terminal."""


class RecordOptions(TypedDict):
    """Those that the request takes as they are."""

    columns: str | None
    dbc: Path | None
    period: float | None
    hold: float | None
    seconds: float | None
    log: int | None
    until_enough: bool


@click.command()
@click.argument("source", required=False)
@directory_option
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="The log: a new file, .parquet.",
)
@click.option(
    "--columns",
    metavar="NAMES",
    help="Names of the columns, with commas between, where the source sends numbers alone.",
)
@click.option(
    "--dbc",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="What the frames of a CAN bus mean.",
)
@click.option(
    "--period",
    type=click.FloatRange(0.001, 86_400.0),
    help="Seconds between rows of CAN, MQTT and MCAP (default: the project's period, or 1).",
)
@click.option(
    "--hold",
    type=click.FloatRange(0.001, 864_000.0),
    help="How long a CAN, MQTT or MCAP value counts without a newer one (default: 5 periods).",
)
@click.option("--seconds", type=click.FloatRange(0.1), help="End after so long.")
@click.option(
    "--log", type=click.IntRange(1), help="Which log of the last plan this is (default: the first)."
)
@click.option("--until-enough", is_flag=True, help="End once everything wanted is covered.")
@click.option(
    "--recover",
    "recover_file",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Finish the file of a recording that was cut off.",
)
@click.option(
    "--use",
    "used_file",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Name a recorded log under [logs] train of the project.",
)
@json_option
def command(
    source: str | None,
    directory: Path,
    out: Path | None,
    recover_file: Path | None,
    used_file: Path | None,
    as_json: bool,
    **options: Unpack[RecordOptions],
) -> None:
    """Record a log from SOURCE, showing what it covers and what is still missing.

    \b
    SOURCE  serial:/dev/ttyUSB0@115200       lines of a serial port
            can:socketcan:can0 --dbc FILE    signals of a CAN bus
            mqtt:localhost/chamber/#         topics of an MQTT broker
            mcap:bag/bag_0.mcap#/ft/wrench   topics of an MCAP file that is being written
            'command:PROGRAM ARGUMENTS'      lines that a program prints
            -                                lines of standard input

    A line is a row: columns below a header, a JSON object, or NAME=VALUE pairs. Beside the values
    stand time_s, since the first row, and clock_s, Unix time, unless the source sends a time. What
    should be covered comes from the last `zerodrift plan`, or from [experiment]. Ctrl-C ends it.
    """
    if recover_file is not None:
        click.echo(f"{recover_file}: {finish(directory, recover_file)} rows, whole again")
        return
    if used_file is not None:
        name = use_log(directory, used_file)
        click.echo(f"zerodrift.toml: [logs] train names {name} now")
        return
    if source is None or out is None:
        raise click.UsageError("expected SOURCE --out FILE, --recover FILE, or --use FILE")
    request = RecordRequest(ProjectFolder(directory), source, out, **options)
    with open_picture(quiet=as_json) as show:
        result = record(request, show)
    if as_json:
        print_result(result)
    else:
        print_record(result)


@contextmanager
def open_picture(*, quiet: bool) -> Iterator[Show]:
    """Yield a function that shows a recording: a table on a terminal, else progress."""
    shown_s = 0.0

    def at_times(draw: Callable[[Covered, str], None]) -> Show:
        def show(covered: Covered, silent: str) -> None:
            nonlocal shown_s
            if time.monotonic() - shown_s >= SHOWN_S:
                shown_s = time.monotonic()
                draw(covered, silent)

        return show

    if is_watched() and not quiet:
        from rich.live import Live

        with Live(console=open_terminal(stderr=True), transient=True, auto_refresh=False) as live:
            yield at_times(
                lambda covered, silent: live.update(draw_covered(covered, silent), refresh=True)
            )
        return
    with show_progress() as say:
        yield at_times(lambda covered, silent: say(tell_covered(covered, silent)))


def tell_covered(covered: Covered, silent: str) -> str:
    """Return a recording so far in one line."""
    missing = explain_missing(covered)
    parts = [f"{covered.rows} rows, {covered.seconds:.0f} s", silent, *missing[:2]]
    return "; ".join(part for part in parts if part)


def draw_covered(covered: Covered, silent: str) -> "Table":
    """Return a recording so far as a table of wanted and covered ranges."""
    title = f"{covered.rows} rows, {covered.seconds:.0f} s" + (f"; {silent}" if silent else "")
    if covered.enough:
        title += "; enough: Ctrl-C ends it"
    table = open_table(
        title, ("column",), ("now", "lowest", "highest", "wanted", "covered", "no reading")
    )
    wanted = {one.what: one for one in covered.wanted}
    for column in covered.columns:
        table.add_row(
            column.name,
            *(write_number(value) for value in (column.last, column.low, column.high)),
            *write_wanted(wanted.pop(column.name, None)),
            str(column.missing or ""),
        )
    for one in wanted.values():
        table.add_row(
            f"{one.what} {one.unit}", "", "", write_number(one.high), *write_wanted(one), ""
        )
    return table


def write_wanted(one: CoveredRange | None) -> tuple[str, str]:
    """Return the wanted range and the share of it that is covered, as text."""
    if one is None:
        return "", ""
    span = f"{one.wanted_low:.6g} .. {one.wanted_high:.6g}"
    return span, f"{100.0 * one.share:.0f} %" + ("" if one.enough else " *")


def write_number(value: float | None) -> str:
    """Return a number as a table shows it."""
    return "-" if value is None else f"{value:.7g}"


def print_record(result: RecordResult) -> None:
    """Print what was recorded, what is still missing, and what can now be learnt from the logs."""
    console = open_console()
    for note in result.notes:
        click.echo(f"note: {note}", err=True)
    console.print(draw_covered(result, ""))
    console.print(
        f"Wrote {result.file}: {result.rows} rows, {result.seconds:.0f} s", soft_wrap=True
    )
    missing = explain_missing(result)
    if missing:
        console.print(f"\nStill to record, by {result.why}:")
        for sentence in missing:
            console.print(f"  {sentence}")
    elif result.wanted:
        console.print(f"All that {result.why} asks for is covered.")
    if result.taught:
        console.print("\nWhat the logs can teach now:")
        for sentence in result.taught:
            console.print(f"  {sentence}")
