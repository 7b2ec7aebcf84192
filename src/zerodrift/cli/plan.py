"""`zerodrift plan`: the next experiment, computed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.base.errors import InputError
from zerodrift.cli.common import (
    directory_option,
    json_option,
    packed,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress

if TYPE_CHECKING:
    from rich.console import Console

    from zerodrift.report.results import PlanResult

MOST_LISTED = 40
"""Lines of the programme that are printed; the file has all."""


@dataclass(frozen=True)
class PlanOptions:
    """The options of `plan`; the command's help explains each."""

    sensor: str | None
    hours: float | None
    within: str | None
    between: tuple[tuple[str, str], ...]
    target: str | None
    budget: float
    criterion: str
    profile: str | None
    units: int | None
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
@packed(PlanOptions)
def command(directory: Path, as_json: bool, skip_invalid: bool, options: PlanOptions) -> None:
    """Plan the next experiment: temperatures, loads and inputs over time.

    Each explanation that is still open is simulated through programmes within the limits, with
    values as the logs or the catalogue have them, and every other one is refitted to it. The
    programme is chosen that makes the right verdict of `diagnose` most probable. It works before
    the first log too.
    """
    from zerodrift.dataset.load import load_dataset
    from zerodrift.discovery.files import list_protocols, write_plan
    from zerodrift.discovery.plan import HOURS, Question
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.tasks.plan import find_plan, has_logs, keep_plan, load_limits
    from zerodrift.tasks.project import ProjectFolder
    from zerodrift.tasks.trust import require_trust

    if options.file is not None and options.file.suffix != ".csv":
        raise InputError(f"--out {options.file}: expected a name that ends in .csv.")
    if options.picture is not None and options.picture.suffix != ".html":
        raise InputError(f"--picture {options.picture}: expected a name that ends in .html.")
    with show_progress("reading logs") as say:
        config = load_limits(ProjectFolder(directory, options.sensor).config, options.within)
        require_trust(config.plugin_files, directory, say)
        dataset = load_dataset(config, skip_invalid) if has_logs(config) else None
        question = Question(
            hours=options.hours or config.experiment.hours or HOURS,
            between=join_pairs(options.between),
            target=read_target(options.target),
            budget_s=options.budget,
            criterion=options.criterion,
            profile=options.profile,
            units=options.units or 0,
        )
        catalogue = load_catalogue(config.plugin_files)
        planned, plan = find_plan(config, dataset, catalogue, question, say)
    keep_plan(config, plan, 0 if dataset is None else len({run.group for run in dataset.train}))
    if options.file is not None:
        protocols = list_protocols(planned.programme, planned.limits, plan.units)
        plan = write_plan(plan, protocols, options.file)
    if options.picture is not None:
        from zerodrift.base.files import write_whole
        from zerodrift.report.figures_plan import draw_plan
        from zerodrift.report.page import render_page

        page = render_page("The next experiment", [draw_plan(plan)])
        write_whole(options.picture, page.encode())
    print_notes((*(dataset.notes if dataset is not None else ()), *plan.notes))
    if as_json:
        print_result(plan)
        return
    print_plan(plan, directory)


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


def print_plan(plan: "PlanResult", directory: Path) -> None:
    """Print the programme, what it is expected to decide, and both in sentences."""
    from zerodrift.discovery.summary import explain_plan

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


def _print_outlooks(plan: "PlanResult", console: "Console") -> None:
    table = open_table(
        "If this one is missing", ("effect", "hardest to tell from"), ("named alone", "range")
    )
    for one in plan.outlooks:
        low, high = one.range
        table.add_row(
            one.effect, one.nearest or "-", f"{one.probability:.2f}", f"{low:.2f} .. {high:.2f}"
        )
    console.print(table)
