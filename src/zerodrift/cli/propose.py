"""`zerodrift propose`: a formula where the catalogue of effects ends."""

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
    from zerodrift.report.results import ProposeResult


@dataclass(frozen=True)
class ProposeOptions:
    """The options of `propose`; the command's help explains each."""

    sensor: str | None
    file: Path | None
    black_box: bool


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
@packed(ProposeOptions)
def command(directory: Path, as_json: bool, skip_invalid: bool, options: ProposeOptions) -> None:
    """Propose a formula where no effect of the catalogue explains what is left.

    Formulas grow from the operations that the chip has, over temperature, loads, inputs and time,
    simple before complex. They are judged as effects are, on training runs left out; everything
    that was tried counts in what chance is allowed. That no formula holds is an answer too.
    """
    from zerodrift.diagnosis.formula.effect_file import render_file
    from zerodrift.tasks.formula_search import search_formula
    from zerodrift.tasks.project import ProjectFolder, open_project
    from zerodrift.tasks.propose import explain_proposal, summarise_search
    from zerodrift.tasks.survey import keep_proposal
    from zerodrift.tasks.trust import remember

    file = options.file
    if file is not None and file.suffix != ".py":
        raise InputError(f"--write {file}: expected a name that ends in .py, as [plugins] takes.")
    if file is not None:
        check_place(file)
    with show_progress() as say:
        config, dataset = open_project(ProjectFolder(directory, options.sensor, skip_invalid), say)
        found = search_formula(config, dataset, say, black_box=options.black_box)
    formula = found.search.formula
    is_written = file is None or formula is None or write_once(file, render_file(formula))
    if is_written and file is not None and formula is not None:
        remember((file,))
    result = summarise_search(found, dataset, file if is_written else None)
    keep_proposal(config, dataset, result, explain_proposal(result, directory))
    print_notes(dataset.notes)
    if as_json:
        print_result(result)
    else:
        print_proposal(result, directory)
    if not is_written:
        raise InputError(
            f"--write {file}: holds another formula, and is as it was; name another file, or "
            f"remove it."
        )


def check_place(file: Path) -> None:
    """Refuse a file that is there and was not written by this command.

    One that it wrote may be the same formula: a command that was cut off can be given again.
    """
    from zerodrift.diagnosis.formula.effect_file import is_proposed

    try:
        if is_proposed(file.read_text(encoding="utf-8")):
            return
    except FileNotFoundError:
        return
    except UnicodeDecodeError:
        pass
    raise InputError(f"--write {file}: is there already; name another file, or remove it.")


def write_once(file: Path, text: str) -> bool:
    """Write a new file; return whether the place holds this text, written now or before."""
    from zerodrift.base.files import write_new

    if file.exists():
        return file.read_bytes() == text.encode()
    write_new(file, text.encode())
    return True


def print_proposal(result: "ProposeResult", directory: Path) -> None:
    """Print the errors, the parameters, and then the findings in sentences."""
    from zerodrift.tasks.propose import explain_proposal

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
