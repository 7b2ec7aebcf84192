"""`zerodrift effects`: the catalogue of physical effects, and everything about one of them."""

import textwrap
from pathlib import Path

import click
from rich.console import Console

from zerodrift.cli.common import json_option, print_result, trust_option
from zerodrift.cli.console import open_console, open_table, show_progress
from zerodrift.diagnosis.fingerprint import Fingerprint, draw_characters
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Effect, Parameter
from zerodrift.tasks.effects import EffectsRequest, list_effects
from zerodrift.tasks.project import ProjectFolder

WIDTH = 88
"""Columns of running text."""


@click.command()
@click.argument("name", required=False)
@click.option(
    "-C",
    "directory",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=Path(),
    metavar="DIR",
    help="The directory of zerodrift.toml, whose own effects are listed too; it may have none.",
)
@click.option(
    "--html",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="With a name: write the picture as a self-contained page.",
)
@trust_option
@json_option
def command(name: str | None, directory: Path, html: Path | None, as_json: bool) -> None:
    """List the effects; with NAME, describe one.

    Equation, parameters with units and bounds, what it looks like, how to provoke it, what to do
    about it in hardware, and the source.
    """
    with show_progress() as progress:
        found = list_effects(EffectsRequest(ProjectFolder(directory), name, html), progress)
    if as_json:
        print_result(found.result)
    elif found.effect is None:
        _print_catalogue(found.catalogue, open_console())
    else:
        _print_effect(found.effect, found.picture, open_console())
        if html is not None:
            click.echo(f"Wrote {html}")


def _print_catalogue(catalogue: Catalogue, console: Console) -> None:
    table = open_table("Physical effects", ("effect", "term", "model", "needs"), ())
    for effect in catalogue.listed():
        needs = ", ".join(need.split("|")[0] for need in effect.needs)
        table.add_row(effect.kind, effect.title, effect.equation, needs)
    console.print(table)
    console.print("More about one: zerodrift effects NAME")


def _print_effect(effect: Effect, picture: Fingerprint | None, console: Console) -> None:
    console.print(f"{effect.kind}: {effect.title}")
    if effect.file:
        console.print(f"declared in {effect.file}")
    console.print()
    _print_text(effect.physics, console)
    console.print(f"    {effect.equation}\n")
    if effect.parameters:
        table = open_table(
            "Parameters", ("name", "unit", "meaning", "typical", "allowed", "if left out"), ()
        )
        for p in effect.parameters:
            table.add_row(p.name, p.unit, p.meaning, *_tell_ranges(p))
        console.print(table)
    if picture is not None:
        for line in draw_characters(picture):
            console.print(line)
        console.print()
    for heading, text in (
        ("Looks like", effect.fingerprint),
        ("To provoke it", effect.provoke),
        ("Cure in hardware", effect.cure),
        ("Source", effect.source),
    ):
        if text:
            _print_text(f"{heading}: {text}", console)


def _tell_ranges(parameter: Parameter) -> tuple[str, str, str]:
    """Return typical range, allowed range, and the default if the parameter is left out."""
    if parameter.choices:
        allowed = ", ".join(f"{choice:g}" for choice in parameter.choices)
        return "", allowed, f"{parameter.default:g}"
    low, high = parameter.typical
    left_out = "fitted" if parameter.default is None else f"{parameter.default:g}"
    return (
        f"{low:g} .. {high:g}",
        f"{parameter.lower:g} .. {parameter.upper:g}",
        left_out,
    )


def _print_text(text: str, console: Console) -> None:
    """Print a paragraph, filled."""
    if text:
        console.print(textwrap.fill(text, WIDTH))
        console.print()
