"""`zerodrift propose`: a formula where the catalogue of effects ends."""

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
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.report.results import ProposeResult
from zerodrift.report.sentences import explain_proposal
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.propose import ProposeRequest, propose


@click.command()
@directory_option
@sensor_option
@click.option(
    "--write",
    "file",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the formula as a file of effects, which [plugins] files names and `add` takes.",
)
@click.option(
    "--black-box/--no-black-box",
    default=True,
    show_default=True,
    help="Say how much more a lag bank and a GRU learn, on runs left out.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    directory: Path,
    sensor: str | None,
    file: Path | None,
    black_box: bool,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Propose a formula where no effect of the catalogue explains what is left.

    Formulas grow from the operations that the chip has, over temperature, loads, inputs and time,
    simple before complex. They are judged as effects are, on training runs left out; everything
    that was tried counts in what chance is allowed. That no formula holds is an answer too.
    """
    project = ProjectFolder(directory, sensor, skip_invalid)
    request = ProposeRequest(project, file, black_box)
    with show_progress() as progress:
        result = propose(request, progress)
    print_notes(project.dataset.notes)
    if as_json:
        print_result(result)
    else:
        print_proposal(result, directory)
    request.require_written(result)


def print_proposal(result: ProposeResult, directory: Path) -> None:
    """Print the errors, the parameters, and then the findings in sentences."""
    console = open_console()
    table = open_table(
        "Error in runs left out", ("output", "unit"), ("before", "after", "noise floor")
    )
    for name, output in result.rmse_left_out.items():
        after = "-" if output.after is None else f"{output.after:.4g}"
        table.add_row(name, output.unit, f"{output.before:.4g}", after, f"{output.noise_floor:.4g}")
    console.print(table)
    if result.parameters or result.coefficients:
        table = open_table("Fitted", ("number", "output", "unit"), ("value", "95 % interval"))
        for name, told in result.parameters.items():
            interval = "-"
            if told.interval is not None:
                interval = f"{told.interval[0]:.4g} .. {told.interval[1]:.4g}"
            table.add_row(name, "all", told.unit, f"{told.value:.4g}", interval)
        for one in result.coefficients:
            interval = "-"
            if one.std_error is not None:
                reach = 1.96 * one.std_error
                interval = f"{one.value - reach:.4g} .. {one.value + reach:.4g}"
            table.add_row(
                one.feature.split()[0], one.output, one.unit, f"{one.value:.4g}", interval
            )
        console.print(table)
    for sentence in explain_proposal(result, directory):
        console.print(sentence)
