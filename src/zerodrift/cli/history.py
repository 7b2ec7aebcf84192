"""`zerodrift history`: the staircase of held-out errors so far."""

import math
from collections.abc import Sequence
from pathlib import Path

import click

from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
)
from zerodrift.cli.console import open_console, open_table
from zerodrift.diagnosis.history import Step
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.revise import HistoryRequest, show_history

BAR_WIDTH = 48
EIGHTHS = " ▏▎▍▌▋▊▉█"


def draw_bar(ratio: float, largest: float, width: int = BAR_WIDTH) -> str:
    """Return a bar on a logarithmic scale from the floor, a ratio of 1, to the largest ratio."""
    if largest <= 1.0 or ratio <= 1.0:
        return ""
    eighths = round(8 * width * math.log(ratio) / math.log(largest))
    return "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()


@click.command()
@directory_option
@sensor_option
@click.option(
    "--html",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Write the picture, output by output, as a self-contained page.",
)
@click.option(
    "--restore",
    type=click.IntRange(0),
    default=None,
    metavar="N",
    help="Write the effects of step N back into zerodrift.toml; the rest of the file stays.",
)
@json_option
def command(
    directory: Path, sensor: str | None, html: Path | None, restore: int | None, as_json: bool
) -> None:
    """Show every effect that was added or removed, with the held-out errors it brought.

    The table gives the errors in N or the like; the bars give them as multiples of the noise floor,
    root mean square over the outputs, on a logarithmic scale that begins at the floor.
    """
    found = show_history(HistoryRequest(ProjectFolder(directory, sensor), restore, html))
    if found.restored:
        click.echo(found.restored, err=True)
    print_notes(found.notes)
    if as_json:
        print_result(found.result)
        return
    if not found.steps:
        click.echo(f"No history yet in {found.path}: `zerodrift add EFFECT` begins one.")
        return
    print_steps(found.steps)
    if html is not None:
        click.echo(f"Wrote {html}")


def print_steps(steps: Sequence[Step]) -> None:
    """Print the table, the bars, and the reasons."""
    console = open_console()
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    units = {name: unit for step in steps for name, unit in step.units.items()}
    table = open_table(
        "Held-out RMSE, step by step", ("", "change"), [f"{n} {units.get(n, '')}" for n in outputs]
    )
    for number, step in enumerate(steps):
        errors = [f"{step.errors[n]:.4g}" if n in step.errors else "-" for n in outputs]
        table.add_row(str(number), step.label, *errors)
    floor = steps[-1].noise_floor
    table.add_section()
    table.add_row("", "noise floor", *(f"{floor[n]:.4g}" if n in floor else "-" for n in outputs))
    console.print(table)
    ratios = [step.ratio() for step in steps]
    largest = max((ratio for ratio in ratios if ratio is not None), default=1.0)
    width = max(len(step.label) for step in steps)
    for number, (step, ratio) in enumerate(zip(steps, ratios, strict=True)):
        if ratio is not None:
            bar = draw_bar(ratio, largest)
            console.print(f"{number:3} {step.label:<{width}} │{bar} {ratio:.2f} x floor")
    for number, step in enumerate(steps):
        if step.reason:
            console.print(f"{number:3} {step.label}: {step.reason}.")
