"""`zerodrift plan`: the next experiment, computed."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict, Unpack

import click
from rich.console import Console

from zerodrift.base.errors import InputError
from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.discovery.summary import explain_plan
from zerodrift.report.results import PlanResult
from zerodrift.tasks.plan import PlanRequest, plan
from zerodrift.tasks.project import ProjectFolder

MOST_LISTED = 40
"""Lines of the programme that are printed; the file has all."""


class PlanOptions(TypedDict):
    """Those that the request takes as they are."""

    hours: float | None
    within: str | None
    budget_s: float
    criterion: str
    profile: str | None
    file: Path | None
    picture: Path | None


@click.command()
@directory_option
@sensor_option
@click.option(
    "--hours",
    type=click.FloatRange(0.05, 2000.0),
    help="How long it may take, rests included (default: [experiment] hours, or 8).",
)
@click.option(
    "--within",
    metavar="LIMITS",
    help="Limits beside those of [experiment]: a .toml file, or 'KEY = VALUE; KEY = VALUE'.",
)
@click.option(
    "--between",
    nargs=2,
    multiple=True,
    metavar="EFFECT EFFECT",
    help="Two effects to tell apart; repeat it for more. Left out: those that are open.",
)
@click.option(
    "--target",
    metavar="PERCENT",
    help="Effects from this share of full scale on have to be named, such as 0.1%.",
)
@click.option(
    "--criterion",
    type=click.Choice(("discrimination", "precision", "error")),
    default="discrimination",
    show_default=True,
    help="The right verdict; narrow values of the model as it is; or its small error in use.",
)
@click.option(
    "--profile",
    metavar="RUN",
    help="With --criterion error: the run that the sensor is used as (default: all limits).",
)
@click.option(
    "--units",
    type=click.IntRange(1, 1_000_000),
    default=None,
    help="The fewest hours for so many further units, to an error of --target.",
)
@click.option(
    "--budget",
    "budget_s",
    type=click.FloatRange(1.0, 3600.0),
    default=60.0,
    show_default=True,
    help="Processor seconds of the search; Ctrl-C ends it with the best so far.",
)
@click.option(
    "--out",
    "file",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the programme as CSV and, beside it, a protocol of each log.",
)
@click.option(
    "--picture",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Draw the programme into an HTML page.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    directory: Path,
    sensor: str | None,
    between: tuple[tuple[str, str], ...],
    target: str | None,
    units: int | None,
    as_json: bool,
    skip_invalid: bool,
    **options: Unpack[PlanOptions],
) -> None:
    """Plan the next experiment: temperatures, loads and inputs over time.

    Each explanation that is still open is simulated through programmes within the limits, with
    values as the logs or the catalogue have them, and every other one is refitted to it. The
    programme is chosen that makes the right verdict of `diagnose` most probable. It works before
    the first log too.
    """
    project = ProjectFolder(directory, sensor, skip_invalid)
    request = PlanRequest(
        project,
        between=join_pairs(between),
        target=read_target(target),
        units=units or 0,
        **options,
    )
    with show_progress() as progress:
        found = plan(request, progress)
    print_notes(found.notes)
    if as_json:
        print_result(found.result)
    else:
        print_plan(found.result, directory)


def join_pairs(pairs: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Return the effects of all pairs, each once; a pair of one effect alone, to be refused."""
    twice = next((pair for pair in pairs if pair[0] == pair[1]), None)
    return twice or tuple(dict.fromkeys(kind for pair in pairs for kind in pair))


def read_target(text: str | None) -> float | None:
    """Return a share of full scale (0.001) from `0.1%` or `0.1`, both in percent.

    Raises:
        InputError: it is no such number.
    """
    if text is None:
        return None
    try:
        share = float(text.rstrip("% ")) / 100.0
    except ValueError:
        share = 0.0
    if not 0.0 < share <= 1.0:
        raise InputError(f"--target {text}: expected a share of full scale, such as 0.1%.")
    return share


def print_plan(plan: PlanResult, directory: Path) -> None:
    """Print the programme, what it is expected to decide, and both in sentences."""
    console = open_console()
    loads = list(dict.fromkeys(name for s in plan.programme for name in s.loads))
    inputs = list(dict.fromkeys(name for s in plan.programme for name in s.inputs))
    headings = (
        "log",
        "from min",
        "degC",
        "K/min",
        *(f"{name} {plan.units[name]}" for name in loads),
        *inputs,
    )
    table = open_table("Programme", (), headings)
    for s in plan.programme[:MOST_LISTED]:
        table.add_row(
            str(s.log),
            f"{s.from_s / 60.0:.1f}",
            f"{s.temperature_degC:g}",
            f"{s.rate_K_per_min:g}",
            *(f"{s.loads[name]:g}" for name in loads),
            *(f"{s.inputs[name]:g}" for name in inputs),
        )
    console.print(table)
    if len(plan.programme) > MOST_LISTED:
        rest = len(plan.programme) - MOST_LISTED
        console.print(f"{rest} more lines; --out FILE and --json have all.\n")
    if plan.widths:
        table = open_table("Known then", ("effect", "value", "unit"), ("now", "95 % within"))
        for width in plan.widths:
            told = (f"{width.value:.4g}", f"{width.half_width:.2g}")
            table.add_row(width.effect, width.parameter, width.unit, *told)
        console.print(table)
    if plan.outlooks:
        _print_outlooks(plan, console)
    for sentence in explain_plan(plan, directory):
        console.print(sentence)
    if plan.files:
        console.print(f"Wrote {', '.join(plan.files)}", soft_wrap=True)


def _print_outlooks(plan: PlanResult, console: Console) -> None:
    table = open_table(
        "If this one is missing", ("effect", "hardest to tell from"), ("named alone", "range")
    )
    for one in plan.outlooks:
        low, high = one.range
        table.add_row(
            one.effect, one.nearest or "-", f"{one.probability:.2f}", f"{low:.2f} .. {high:.2f}"
        )
    console.print(table)
