"""`zerodrift remove EFFECT`: one effect less, and what that costs."""

from pathlib import Path

import click

from zerodrift.base.errors import InputError
from zerodrift.cli.add import print_revision
from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import open_console, show_progress
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.revise import RemoveRequest, remove


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
    project = ProjectFolder(directory, sensor, skip_invalid)
    with show_progress() as progress:
        found = remove(RemoveRequest(project, effect, _read_signal(options)), progress)
    print_notes(found.notes)
    if as_json:
        print_result(found.result)
        return
    print_revision(found.revision)
    reason = found.revision.reason
    open_console().print(
        f"{reason[0].upper()}{reason[1:]}. Removed {effect} from "
        f"{project.config.path.name}; zerodrift add {effect} brings it back."
    )


def _read_signal(options: tuple[str, ...]) -> str:
    for text in options:
        name, _, value = text.partition("=")
        if name.strip() != "signal" or not value.strip():
            raise InputError(f"--set {text}: expected signal=NAME, the effect's thermometer.")
    return options[-1].partition("=")[2].strip() if options else ""
