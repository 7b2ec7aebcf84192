"""`zerodrift registry`: units, calibrations, blocks and logs of a design, in one SQLite file."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from zerodrift.cli.common import json_option, print_result
from zerodrift.cli.console import open_console, open_table
from zerodrift.field.registry import HOW_TO_ENTER
from zerodrift.field.summary import RegistryResult
from zerodrift.tasks.registry import (
    RegistryPlace,
    add_block,
    add_unit,
    list_standings,
    load_block,
    make_registry,
    tell_history,
)

Result = TypeVar("Result")


def place_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """Add `-C DIR` and `--registry FILE`, passed on as `place`."""

    @functools.wraps(function)
    def call(*arguments: object, directory: Path, file: Path | None, **options: object) -> Result:
        return function(*arguments, place=RegistryPlace(directory, file), **options)

    call = click.option(
        "--registry",
        "file",
        type=click.Path(path_type=Path, dir_okay=False),
        default=None,
        metavar="FILE",
        help="The registry (default: registry.sqlite beside zerodrift.toml).",
    )(call)
    return click.option(
        "-C",
        "directory",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        default=Path(),
        metavar="DIR",
        help="The directory of zerodrift.toml (default: the current one).",
    )(call)


def tell_newer(serial: str, newer: str | None) -> None:
    """Say that a chip with two slots may hold a newer block than the one that was loaded."""
    if newer is not None:
        click.echo(
            f"note: {serial} was given the newer block {newer[:12]} before; as long as that lies in"
            " its other slot, the chip computes with it. Erase that slot, or load the newer one.",
            err=True,
        )


@click.group("registry")
def command() -> None:
    """Units of a design: their calibrations, blocks and logs, and which block is on which unit.

    `fleet` and `monitor` write into the registry beside zerodrift.toml where there is one. Many
    programs may read and write at a time, on a disk of this machine.
    """


@command.command("init")
@place_options
def make(place: RegistryPlace) -> None:
    """Make an empty registry; one that is there stays as it is."""
    click.echo(f"{place.path}: {make_registry(place)} units")


@command.command()
@click.argument("serial")
@click.option("--design", default=None, help="Default: [sensor] name of zerodrift.toml.")
@place_options
def add(serial: str, design: str | None, place: RegistryPlace) -> None:
    """Enter a unit by its serial number, which no other may have."""
    click.echo(f"{serial}: entered, design {add_unit(place, serial, design)}")


@command.command()
@click.argument("serial")
@click.argument("file_of_block", metavar="FILE", type=click.Path(path_type=Path, exists=True))
@click.option("--loaded", is_flag=True, help="It is on the unit now.")
@place_options
def block(serial: str, file_of_block: Path, loaded: bool, place: RegistryPlace) -> None:
    """Enter a unit's block of coefficients (.bin, .hex or .json), and that it was loaded into it.

    Refused is what no chip would take: a block that was cut, damaged, of another format or
    endianness, and, where its design.json lies beside FILE, above it or in the firmware's folder,
    one of another design. So is a block that names another unit.
    """
    entered = add_block(place, serial, file_of_block, loaded=loaded)
    click.echo(f"{serial}: block {entered.sha256[:12]}{', loaded' if loaded else ''}")
    tell_newer(serial, entered.newer)


@command.command()
@click.argument("serial")
@click.argument("sha256")
@place_options
def loaded(serial: str, sha256: str, place: RegistryPlace) -> None:
    """Enter that a block, by the first digits of its hash, was loaded into a unit."""
    entered = load_block(place, serial, sha256)
    click.echo(f"{serial}: block {entered.sha256[:12]} is on it")
    tell_newer(serial, entered.newer)


@command.command("list")
@json_option
@place_options
def list_units(as_json: bool, place: RegistryPlace) -> None:
    """List the units: last calibration, the block on each, and what `monitor` said last."""
    standings = list_standings(place)
    if as_json:
        print_result(RegistryResult(tuple(one.unit for one in standings)))
        return
    title = f"{len(standings)} unit{'s' if len(standings) != 1 else ''}"
    if not standings:
        click.echo(f"{title}. {HOW_TO_ENTER}")
        return
    table = open_table(title, ("serial", "design", "calibrated", "block", "monitor"), ())
    for one in standings:
        unit = one.unit
        calibrated, block = unit.calibrated_at[:19] or "-", unit.block[:12] or "-"
        table.add_row(unit.serial, unit.design, calibrated, block, one.told)
    open_console().print(table)


@command.command()
@click.argument("serial")
@json_option
@place_options
def history(serial: str, as_json: bool, place: RegistryPlace) -> None:
    """List what happened to a unit, the oldest first."""
    told = tell_history(place, serial)
    if as_json:
        print_result(told)
        return
    table = open_table(serial, ("at (UTC)", "", ""), ())
    for event in told.events:
        table.add_row(event.at[:19], event.kind, event.text)
    open_console().print(table)
