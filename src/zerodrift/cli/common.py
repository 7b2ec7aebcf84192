"""Options that the commands share, and how each of them prints."""

import functools
import json
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import click

from zerodrift.base.errors import CheckError
from zerodrift.base.journal import settle_project
from zerodrift.base.records import to_dict
from zerodrift.base.terminal import CONTROLS
from zerodrift.tasks.project import ProjectFolder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

TRUST = "zerodrift.trust"
"""In a click context: `--trust` was given."""

Command = TypeVar("Command", bound=Callable[..., object])
Result = TypeVar("Result")


def directory_option(function: Command) -> Command:
    """Add `-C DIR`: the project directory, passed on as `directory: Path`.

    An interrupted change of its files is completed, or reversed, before the command begins.
    """
    return click.option(
        "-C",
        "directory",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        default=Path(),
        metavar="DIR",
        callback=_settle,
        help="The directory of zerodrift.toml (default: the current one).",
    )(function)


def _settle(context: click.Context, _: click.Parameter, directory: Path) -> Path:
    if not context.resilient_parsing:
        settle_project(directory)
    return directory


def as_request(
    kind: "type[DataclassInstance]",
) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Pass the options that are fields of a task's request on as that request, `request`.

    Args:
        kind: of the request; a field has the name of its option, and `project` is what
            `--sensor` and `--skip-invalid` say of the directory.
    """
    names = [field.name for field in fields(kind)]

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        @functools.wraps(function)
        def pack(*arguments: object, **given: object) -> Result:
            if "project" in names:
                given["project"] = ProjectFolder(
                    cast(Path, given.pop("directory")),
                    cast("str | None", given.pop("sensor", None)),
                    bool(given.pop("skip_invalid", False)),
                )
            request = kind(**{name: given.pop(name) for name in names if name in given})
            return function(*arguments, request=request, **given)

        return pack

    return decorate


def json_option(function: Callable[..., Result]) -> Callable[..., Result]:
    """Add `--json`, passed on as `as_json: bool`; the result of a failed check is printed by it."""

    @functools.wraps(function)
    def call(*arguments: object, as_json: bool, **options: object) -> Result:
        try:
            return function(*arguments, as_json=as_json, **options)
        except CheckError as error:
            if as_json and error.result is not None:
                print_result(error.result)
            raise

    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else."
    )(call)


def skip_invalid_option(function: Command) -> Command:
    """Add `--skip-invalid`, passed on as `skip_invalid: bool`."""
    return click.option(
        "--skip-invalid", is_flag=True, help="Drop invalid rows of the logs and say how many."
    )(function)


def sensor_option(function: Command) -> Command:
    """Add `--sensor NAME`, a unit of a fleet, passed on as `sensor: str | None`."""
    return click.option(
        "--sensor",
        default=None,
        metavar="NAME",
        help="One unit of a fleet ([fleet]): its logs, its model, its C.",
    )(function)


def out_option(function: Command) -> Command:
    """Add `--out DIR`, the firmware folder, passed on as `out: Path | None`."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path, file_okay=False),
        default=None,
        metavar="DIR",
        help="The firmware folder, in place of that of [firmware] out. One outside the project has"
        " to be named here once before [firmware] out may name it.",
    )(function)


def trust_option(function: Command) -> Command:
    """Add `--trust`, which `is_trusted` finds in click's context."""
    return click.option(
        "--trust",
        is_flag=True,
        expose_value=False,
        callback=_note_trust,
        help="Run code that the project brings, files of effects ([plugins]) and C, without"
        " asking.",
    )(function)


def _note_trust(context: click.Context, _: click.Parameter, trust: bool) -> None:
    context.meta[TRUST] = trust


def is_trusted() -> bool:
    """Return whether the command was given `--trust`."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(TRUST))


def print_result(result: object) -> None:
    """Print a command's record as JSON."""
    print_json(to_dict(result))


def print_json(value: object) -> None:
    """Print one JSON object on stdout; NaN and infinity, which JSON lacks, are refused.

    Where stdout's encoding lacks a character, everything but ASCII is written as JSON escapes.
    """
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    text = CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)  # those that JSON allows
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(value, indent=2, allow_nan=False)
    click.echo(text)


def print_notes(notes: tuple[str, ...]) -> None:
    """Print what was noticed on stderr, so that stdout stays the command's result."""
    for note in notes:
        click.echo(f"note: {note}", err=True)
