"""`zerodrift registry`: units, calibrations, blocks and logs of a design, in one SQLite file."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from zerodrift.cli.common import json_option, print_result
from zerodrift.cli.console import open_console, open_table

Command = TypeVar("Command", bound=Callable[..., object])


def place_options(function: Command) -> Command:
    """Add `-C DIR` and `--registry FILE`, passed on as `directory` and `file`."""
    function = click.option(
        "--registry",
        "file",
        type=click.Path(path_type=Path, dir_okay=False),
        default=None,
        metavar="FILE",
        help="The registry (default: registry.sqlite beside zerodrift.toml).",
    )(function)
    return click.option(
        "-C",
        "directory",
        type=click.Path(exists=True, file_okay=False, path_type=Path),
        default=Path(),
        metavar="DIR",
        help="The directory of zerodrift.toml (default: the current one).",
    )(function)


def find_file(directory: Path, file: Path | None) -> Path:
    """Return the registry's file."""
    from zerodrift.field.registry_file import FILE_NAME

    return file if file is not None else directory / FILE_NAME


def read_own_block(directory: Path, file: Path, serial: str) -> bytes:
    """Return the bytes of a unit's block.

    Args:
        directory: of zerodrift.toml, whose firmware may hold the design.
        file: of the block.
        serial: of the unit.

    Raises:
        InputError: it is no sound block, or not of this unit.
    """
    from zerodrift.base.config import FILE_NAME, load_config
    from zerodrift.base.errors import InputError
    from zerodrift.blocks.block import decode, decode_header
    from zerodrift.blocks.design import find_design, load_design
    from zerodrift.blocks.files import find_design_file, read_block_file

    design = find_design_file(file)
    if design is None and (directory / FILE_NAME).is_file():
        place = find_design(load_config(directory).firmware_out)
        design = load_design(place) if place is not None else None
    content = read_block_file(file, design)
    header = decode_header(content, str(file))
    if design is not None:
        decode(design, content, str(file))
    if header.serial != serial:
        raise InputError(
            f"{file}: is the block of '{header.serial}'; expected that of {serial}. On {serial} it"
            " would compensate another sensor: name the right file, or the right unit."
        )
    return content


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
def make(directory: Path, file: Path | None) -> None:
    """Make an empty registry; one that is there stays as it is."""
    from zerodrift.field.registry import open_registry

    path = find_file(directory, file)
    with open_registry(path, make=True) as registry:
        click.echo(f"{path}: {len(registry.list_units())} units")


@command.command()
@click.argument("serial")
@click.option("--design", default=None, help="Default: [sensor] name of zerodrift.toml.")
@place_options
def add(serial: str, design: str | None, directory: Path, file: Path | None) -> None:
    """Enter a unit by its serial number, which no other may have."""
    from zerodrift.base.config import load_config
    from zerodrift.field.registry import open_registry

    known = design if design is not None else load_config(directory).sensor_name
    with open_registry(find_file(directory, file)) as registry:
        registry.add_unit(serial, known)
    click.echo(f"{serial}: entered, design {known}")


@command.command()
@click.argument("serial")
@click.argument("file_of_block", metavar="FILE", type=click.Path(path_type=Path, exists=True))
@click.option("--loaded", is_flag=True, help="It is on the unit now.")
@place_options
def block(
    serial: str, file_of_block: Path, loaded: bool, directory: Path, file: Path | None
) -> None:
    """Enter a unit's block of coefficients (.bin, .hex or .json), and that it was loaded into it.

    Refused is what no chip would take: a block that was cut, damaged, of another format or
    endianness, and, where its design.json lies beside FILE, above it or in the firmware's folder,
    one of another design. So is a block that names another unit.
    """
    from zerodrift.field.registry import open_registry

    content = read_own_block(directory, file_of_block, serial)
    with open_registry(find_file(directory, file)) as registry:
        sha256, newer = registry.add_block(serial, content), None
        if loaded:
            registry.load_block(serial, sha256)
            newer = registry.find_newer(serial, sha256)
    click.echo(f"{serial}: block {sha256[:12]}{', loaded' if loaded else ''}")
    tell_newer(serial, newer)


@command.command()
@click.argument("serial")
@click.argument("sha256")
@place_options
def loaded(serial: str, sha256: str, directory: Path, file: Path | None) -> None:
    """Enter that a block, by the first digits of its hash, was loaded into a unit."""
    from zerodrift.field.registry import open_registry

    with open_registry(find_file(directory, file)) as registry:
        whole = registry.load_block(serial, sha256)
        newer = registry.find_newer(serial, whole)
    click.echo(f"{serial}: block {whole[:12]} is on it")
    tell_newer(serial, newer)


@command.command("list")
@json_option
@place_options
def list_units(as_json: bool, directory: Path, file: Path | None) -> None:
    """List the units: last calibration, the block on each, and what `monitor` said last."""
    from zerodrift.field.registry import HOW_TO_ENTER, open_registry
    from zerodrift.field.summary import RegistryResult

    with open_registry(find_file(directory, file)) as registry:
        standings = registry.list_standings()
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
def history(serial: str, as_json: bool, directory: Path, file: Path | None) -> None:
    """Tell what happened to a unit, the oldest first."""
    from zerodrift.field.registry import open_registry
    from zerodrift.field.summary import UnitHistoryResult

    with open_registry(find_file(directory, file)) as registry:
        events = registry.tell_history(serial)
    if as_json:
        print_result(UnitHistoryResult(serial, events))
        return
    table = open_table(serial, ("at (UTC)", "", ""), ())
    for event in events:
        table.add_row(event.at[:19], event.kind, event.text)
    open_console().print(table)
