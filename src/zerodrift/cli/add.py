"""`zerodrift add EFFECT`: one more effect in the model, if it earns its place."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.base.errors import InputError
from zerodrift.cli.common import (
    changes_project,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)

if TYPE_CHECKING:
    from zerodrift.diagnosis.revision import Revision


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
@changes_project
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
    from zerodrift.base.config import EffectConfig
    from zerodrift.cli.console import open_console, show_progress
    from zerodrift.diagnosis.revision import summarise_revision
    from zerodrift.report.results import AddResult
    from zerodrift.tasks.effect_file import open_effect
    from zerodrift.tasks.project import ProjectFolder, open_project, tell_design
    from zerodrift.tasks.revise import add_to_project, print_revision

    held, texts = read_held(hold), _split(options, "--set", "signal=body_temperature")
    with show_progress() as say:
        config, dataset = open_project(ProjectFolder(directory, sensor, skip_invalid), say)
        config, catalogue, kind = open_effect(config, effect)
        wanted = EffectConfig(kind, held, texts)
        revision, is_kept = add_to_project(config, dataset, catalogue, wanted, force=force, say=say)
    print_notes((*dataset.notes, *(tell_design(config, sensor) if is_kept else ())))
    if as_json:
        print_result(AddResult(**vars(summarise_revision(revision)), added=is_kept))
    else:
        print_revision(revision)
        open_console().print(_conclude(revision, force, config.path))
    if not is_kept:
        sys.exit(1)


def _conclude(revision: "Revision", force: bool, path: Path) -> str:
    """Return in a sentence what happened to the file, and why."""
    from zerodrift.diagnosis.changes import ADD, name_effect

    why = f"{revision.reason[0].upper()}{revision.reason[1:]}."
    name = name_effect(revision.change.effect)
    done = f"Added {name} to" if revision.change.action == ADD else f"Changed {name} in"
    if revision.helps:
        return f"{why} {done} {path.name}. Next: zerodrift diagnose"
    if force:
        return f"{why} {done} {path.name} all the same, as --force asks."
    return f"{why} {path.name} is as it was; --force keeps {name} all the same."
