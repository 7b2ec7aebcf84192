"""`zerodrift remove EFFECT`: one effect less, and what that costs."""

from pathlib import Path

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


@click.command()
@click.argument("effect")
@directory_option
@sensor_option
@click.option(
    "--set",
    "options",
    multiple=True,
    metavar="NAME=TEXT",
    help="signal=NAME says which one, where an effect is in the model for several thermometers.",
)
@json_option
@skip_invalid_option
@changes_project
def command(
    effect: str,
    directory: Path,
    sensor: str | None,
    options: tuple[str, ...],
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Remove EFFECT from zerodrift.toml, refit the others together, and show what that costs.

    The effect is removed in any case; the history says whether the held-out error grew.
    """
    from zerodrift.cli.console import open_console, show_progress
    from zerodrift.diagnosis.revision import summarise_revision
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.report.results import RemoveResult
    from zerodrift.tasks.project import ProjectFolder, open_project, tell_design
    from zerodrift.tasks.revise import print_revision, remove_from_project

    signal = _read_signal(options)
    with show_progress() as say:
        config, dataset = open_project(ProjectFolder(directory, sensor, skip_invalid), say)
        catalogue = load_catalogue(config.plugin_files)
        revision = remove_from_project(config, dataset, catalogue, effect, signal, say)
    print_notes((*dataset.notes, *tell_design(config, sensor)))
    if as_json:
        print_result(RemoveResult(**vars(summarise_revision(revision))))
        return
    print_revision(revision)
    open_console().print(
        f"{revision.reason[0].upper()}{revision.reason[1:]}. Removed {effect} from "
        f"{config.path.name}; zerodrift add {effect} brings it back."
    )


def _read_signal(options: tuple[str, ...]) -> str:
    for text in options:
        name, _, value = text.partition("=")
        if name.strip() != "signal" or not value.strip():
            raise InputError(f"--set {text}: expected signal=NAME, the effect's thermometer.")
    return options[-1].partition("=")[2].strip() if options else ""
