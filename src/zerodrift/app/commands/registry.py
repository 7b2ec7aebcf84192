"""`zerodrift registry`: units, calibrations, blocks and logs of a design, in one SQLite file."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from zerodrift.app.commands.common import json_option, print_result
from zerodrift.app.commands.console import open_console, open_table

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
    from zerodrift.field.registry import FILE_NAME

    return file if file is not None else directory / FILE_NAME


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
    """Enter a unit's block of coefficients, and that it was loaded into it."""
    from zerodrift.field.registry import open_registry

    content = file_of_block.read_bytes()
    with open_registry(find_file(directory, file)) as registry:
        sha256 = registry.add_block(serial, content)
        if loaded:
            registry.load_block(serial, sha256)
    click.echo(f"{serial}: block {sha256[:12]}{', loaded' if loaded else ''}")


@command.command()
@click.argument("serial")
@click.argument("sha256")
@place_options
def loaded(serial: str, sha256: str, directory: Path, file: Path | None) -> None:
    """Enter that a block, by the first digits of its hash, was loaded into a unit."""
    from zerodrift.field.registry import open_registry

    with open_registry(find_file(directory, file)) as registry:
        whole = registry.load_block(serial, sha256)
    click.echo(f"{serial}: block {whole[:12]} is on it")


@command.command("list")
@json_option
@place_options
def list_units(as_json: bool, directory: Path, file: Path | None) -> None:
    """List the units: last calibration, and the block that is on each."""
    from zerodrift.field.registry import open_registry
    from zerodrift.field.summary import RegistryResult

    with open_registry(find_file(directory, file)) as registry:
        units = registry.list_units()
    if as_json:
        print_result(RegistryResult(units))
        return
    table = open_table(f"{len(units)} units", ("serial", "design", "calibrated", "block"), ())
    for unit in units:
        table.add_row(unit.serial, unit.design, unit.calibrated_at[:19] or "-", unit.block[:12])
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
