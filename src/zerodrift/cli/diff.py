"""`zerodrift diff`: what changed from one model to another, and by how much the drift differs."""

from pathlib import Path

import click

from zerodrift.base.errors import CheckError
from zerodrift.cli.common import (
    json_option,
    print_notes,
    print_result,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.report.results import DiffResult
from zerodrift.tasks.diff import DiffRequest, diff


@click.command()
@click.argument("old", type=click.Path(path_type=Path, exists=True))
@click.argument("new", type=click.Path(path_type=Path, exists=True))
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option(
    "-C",
    "directory",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=None,
    metavar="DIR",
    help="The project whose zerodrift.toml says how LOG is read (default: NEW's, else OLD's).",
)
@click.option(
    "--limit",
    type=click.FloatRange(min=0.0),
    default=None,
    metavar="PERCENT",
    help="Exit 1 where a drift differs by more than this share of full scale.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    old: Path,
    new: Path,
    logs: tuple[Path, ...],
    directory: Path | None,
    limit: float | None,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Say what changed from OLD to NEW, and by how much the drift differs, in N or the like.

    OLD and NEW are projects, firmware folders or model.json files. The drifts are compared over
    LOG..., or else over the calibrated range that both have.
    """
    with show_progress("comparing") as progress:
        found = diff(DiffRequest(old, new, logs, directory, limit, skip_invalid), progress)
    if as_json:
        print_result(found)
    else:
        print_notes(found.notes)
        _print(found)
    if found.exceeds:
        worst = max(found.outputs.items(), key=lambda pair: pair[1].largest_pct_fs)
        raise CheckError(
            f"{worst[0]} differs by {worst[1].largest:.4g} {worst[1].unit}, "
            f"{worst[1].largest_pct_fs:.3g} % of full scale; the limit is {limit:g} %."
        )


def _print(found: DiffResult) -> None:
    console = open_console()
    if found.same:
        console.print("The same model, bit for bit.")
    if found.changes:
        table = open_table("What changed", ("", "old", "new"), ())
        for change in found.changes:
            table.add_row(change.what, change.old or "-", change.new or "-")
        console.print(table)
    elif not found.same:
        console.print("Effects, ranges and formats are the same; coefficients differ.")
    table = open_table(
        f"Difference of the drift over {found.over}",
        ("output", "unit"),
        ("largest", "RMS", "largest, % FS"),
    )
    for name, output in found.outputs.items():
        table.add_row(
            name,
            output.unit,
            f"{output.largest:.4g}",
            f"{output.rms:.4g}",
            f"{output.largest_pct_fs:.3g}",
        )
    console.print(table)
