"""`zerodrift apply`: the finished model over any log, as the chip would."""

from pathlib import Path

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
from zerodrift.cli.console import (
    open_console,
    open_table,
    print_uncertainty,
    show_progress,
)
from zerodrift.report.results import ApplyResult
from zerodrift.tasks.apply import INTEGER, KINDS, ApplyRequest, apply_to_logs
from zerodrift.tasks.project import ProjectFolder


@click.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@directory_option
@sensor_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    metavar="FILE",
    help="File, .csv or .parquet, or a directory for several logs (default: LOG_compensated in "
    "the current directory, Parquet where the log is, else CSV).",
)
@click.option(
    "--model",
    "kind",
    type=click.Choice(KINDS),
    default=INTEGER,
    show_default=True,
    help="The chip's integers, or the float model they were made from.",
)
@click.option(
    "--block",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    metavar="FILE",
    help="The block on the unit, where coefficients lie in a block (default: as the registry says, "
    "else the one written last).",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    logs: tuple[Path, ...],
    directory: Path,
    sensor: str | None,
    out: Path | None,
    kind: str,
    block: Path | None,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Run the model of the last `firmware` over LOG... and write what it gives for every row.

    Each output gains OUTPUT_drift, OUTPUT_compensated (measured less drift) and OUTPUT_uncertainty
    (expanded, k = 2), in N or the like; `flags` are the chip's. A log needs no reference. Rows
    without a reading are given to the chip as such.
    """
    request = ApplyRequest(ProjectFolder(directory, sensor, skip_invalid), logs, out, kind, block)
    with show_progress() as progress:
        told = apply_to_logs(request, progress)
    if as_json:
        print_result(told)
        return
    print_notes((*told.notes, *(note for log in told.logs for note in log.notes)))
    _print(told)


def _print(told: ApplyResult) -> None:
    console = open_console()
    for log in told.logs:
        table = open_table(
            f"{log.log}: {log.rows} rows, {log.steps} steps",
            ("output", "unit"),
            ("RMS drift", "largest drift", "uncertainty (k = 2)"),
        )
        for name, output in log.outputs.items():
            expanded = "-" if output.uncertainty is None else f"{output.uncertainty:.2g}"
            table.add_row(
                name,
                output.unit,
                f"{output.rms_drift:.4g}",
                f"{output.largest_drift:.4g}",
                expanded,
            )
        console.print(table)
        for text, count in log.flags.items():
            console.print(f"flag at {count} of {log.steps} steps: {text}")
        console.print(f"wrote {log.file}")
    print_uncertainty(told.uncertainty, console)
