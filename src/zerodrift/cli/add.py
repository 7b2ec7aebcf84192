"""`zerodrift add EFFECT`: one more effect in the model, if it earns its place."""

import sys
from pathlib import Path

import click

from zerodrift.base.errors import InputError
from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.diagnosis.changes import ADD, name_effect
from zerodrift.diagnosis.revision import Revision, summarise_revision
from zerodrift.physics.summary import describe_coefficients, describe_parameters
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.revise import AddRequest, add


def read_held(texts: tuple[str, ...]) -> dict[str, float]:
    """Return the parameters of `--hold NAME=NUMBER`.

    Raises:
        InputError: one of them has another form, or is given twice.
    """
    held: dict[str, float] = {}
    for name, value in _split(texts, "--hold", "tau_s=60").items():
        try:
            held[name] = float(value)
        except ValueError:
            raise InputError(
                f"--hold {name}={value}: '{value}' is no number; expected NAME=NUMBER, such as "
                "--hold tau_s=60."
            ) from None
    return held


def _split(texts: tuple[str, ...], option: str, example: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name, value = name.strip(), value.strip()
        if not (equals and name and value):
            raise InputError(f"{option} {text}: expected NAME=VALUE, such as {option} {example}.")
        if name in found:
            raise InputError(f"{option} {text}: '{name}' is set twice; keep one of them.")
        found[name] = value
    return found


@click.command()
@click.argument("effect")
@directory_option
@sensor_option
@click.option(
    "--hold",
    "hold",
    multiple=True,
    metavar="NAME=NUMBER",
    help="Hold a parameter at a value instead of fitting it; may be repeated.",
)
@click.option(
    "--set",
    "options",
    multiple=True,
    metavar="NAME=TEXT",
    help="Set an option, such as signal=body_temperature; may be repeated.",
)
@click.option("--force", is_flag=True, help="Keep the effect even if it does not help.")
@json_option
@skip_invalid_option
def command(
    effect: str,
    directory: Path,
    sensor: str | None,
    hold: tuple[str, ...],
    options: tuple[str, ...],
    force: bool,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Add EFFECT to zerodrift.toml, refit all effects together, and show what it brought.

    EFFECT may be a file of one effect, as `propose --write` writes it; it is then named under
    [plugins] files, too.

    An effect whose held-out error is not better by more than runs differ is not kept: the command
    says so, leaves every file as it was and ends with exit code 1. --force keeps it.

    Of an effect's forms, such as the order of a polynomial, the simplest is added unless a richer
    one passes the same test against it; --hold leaves that choice to you. For an effect that is
    in the model already, richer forms are tried, and --hold sets other values.
    """
    held, texts = read_held(hold), _split(options, "--set", "signal=body_temperature")
    project = ProjectFolder(directory, sensor, skip_invalid)
    with show_progress() as progress:
        found = add(AddRequest(project, effect, held, texts, force), progress)
    print_notes(found.notes)
    if as_json:
        print_result(found.result)
    else:
        print_revision(found.revision)
        open_console().print(_conclude(found.revision, force, project.config.path))
    if not found.result.added:
        sys.exit(1)


def _conclude(revision: Revision, force: bool, path: Path) -> str:
    """Return in a sentence what happened to the file, and why."""
    why = f"{revision.reason[0].upper()}{revision.reason[1:]}."
    name = name_effect(revision.change.effect)
    done = f"Added {name} to" if revision.change.action == ADD else f"Changed {name} in"
    if revision.helps:
        return f"{why} {done} {path.name}. Next: zerodrift diagnose"
    if force:
        return f"{why} {done} {path.name} all the same, as --force asks."
    return f"{why} {path.name} is as it was; --force keeps {name} all the same."


def print_revision(revision: Revision) -> None:
    """Print the errors before and after, and the fitted parameters."""
    console = open_console()
    model = revision.after.model
    table = open_table(
        f"Held-out RMSE ({revision.after.held_out.method})",
        ("output", "unit"),
        ("before", "after", "after/before", "noise floor", "x floor"),
    )
    for k, name in enumerate(model.outputs):
        before, after = float(revision.before.rmse[k]), float(revision.after.rmse[k])
        floor = float(revision.floor.rms[k])
        table.add_row(
            name,
            model.units[k],
            f"{before:.4g}",
            f"{after:.4g}",
            f"{after / before:.3f}" if before > 0.0 else "-",
            f"{floor:.4g}",
            f"{after / floor:.2f}" if floor > 0.0 else "-",
        )
    console.print(table)
    notes = [revision.after.held_out.explain(), revision.floor.explain()]
    if revision.before.has_outliers:
        pairs = zip(
            model.outputs,
            model.units,
            revision.before.steady_rmse,
            revision.after.steady_rmse,
            strict=True,
        )
        told = ", ".join(f"{n} {one:.4g} to {two:.4g} {unit}" for n, unit, one, two in pairs)
        notes.append(f"the table's errors are those of all rows; without outliers: {told}")
    summary = summarise_revision(revision)
    if (tested := summary.explain_test()) is not None:
        notes.append(tested)
    anew = summary.explain_offsets()
    if anew is not None:
        notes.append(anew)
    elif revision.tared:
        notes.append("each run's own offset is taken off, as the logs are zeroed one by one")
    for note in notes:
        console.print(f"{note[0].upper()}{note[1:]}.")
    _print_parameters(revision)
    for note in model.notes:
        console.print(f"note: {note}.")


def _print_parameters(revision: Revision) -> None:
    """Print the parameters of all effects, and the coefficients of the new one."""
    console = open_console()
    model = revision.after.model
    table = open_table("Parameters", ("effect", "parameter", "unit", ""), ("value", "std error"))
    for fitted in model.terms:
        for name, told in describe_parameters(fitted).items():
            remark = "held" if told.held else "at its bound" if told.at_bound else ""
            table.add_row(
                fitted.term.name,
                name,
                told.unit,
                remark,
                f"{told.value:.4g}",
                _write_error(told.std_error),
            )
    if table.row_count:
        console.print(table)
    term = revision.term
    rows = describe_coefficients(model, term) if term is not None else []
    if not rows:
        return
    table = open_table(
        f"Coefficients of {name_effect(revision.change.effect)}",
        ("feature", "output", "unit"),
        ("value", "std error"),
    )
    for row in rows:
        table.add_row(
            row.feature,
            row.output,
            row.unit,
            f"{row.value:.4g}",
            _write_error(row.std_error),
        )
    console.print(table)


def _write_error(error: float | None) -> str:
    """Return a standard error; a dash where there is none."""
    return "-" if error is None else f"{error:.2g}"
