"""`registry`: units of a design, their calibrations, blocks and logs, in one SQLite file."""

from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.base.errors import InputError
from zerodrift.blocks.block import decode, decode_header
from zerodrift.blocks.design import find_design, load_design
from zerodrift.blocks.files import find_design_file, read_block_file
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import UnitStanding, open_registry
from zerodrift.field.summary import UnitHistoryResult


@dataclass(frozen=True)
class RegistryPlace:
    """Which registry is meant."""

    directory: Path = Path()
    """Of zerodrift.toml."""
    file: Path | None = None
    """The registry; None: registry.sqlite in the directory."""

    @property
    def path(self) -> Path:
        """The registry's file."""
        return self.file if self.file is not None else self.directory / REGISTRY


@dataclass(frozen=True)
class EnteredBlock:
    """A block that was entered."""

    sha256: str
    newer: str | None
    """Hash of a newer block that the unit was given before, where it was loaded."""


def make_registry(place: RegistryPlace) -> int:
    """Make an empty registry unless there is one; return how many units it has.

    Raises:
        InputError: it cannot be written.
    """
    with open_registry(place.path, make=True) as registry:
        return len(registry.list_units())


def add_unit(place: RegistryPlace, serial: str, design: str | None = None) -> str:
    """Enter a unit; return its design, by default `[sensor] name` of zerodrift.toml.

    Raises:
        InputError: it is entered already, or there is no registry.
    """
    known = design if design is not None else load_config(place.directory).sensor_name
    with open_registry(place.path) as registry:
        registry.add_unit(serial, known)
    return known


def add_block(place: RegistryPlace, serial: str, file: Path, *, loaded: bool) -> EnteredBlock:
    """Enter a unit's block, and that it was loaded into it where it was.

    Raises:
        InputError: no chip of the design would take it, or it is another unit's.
    """
    content = _read_own_block(place.directory, file, serial)
    with open_registry(place.path) as registry:
        sha256, newer = registry.add_block(serial, content), None
        if loaded:
            registry.load_block(serial, sha256)
            newer = registry.find_newer(serial, sha256)
    return EnteredBlock(sha256, newer)


def load_block(place: RegistryPlace, serial: str, sha256: str) -> EnteredBlock:
    """Enter that a block, by the first digits of its hash, was loaded into a unit.

    Raises:
        InputError: there is no such unit or block.
    """
    with open_registry(place.path) as registry:
        whole = registry.load_block(serial, sha256)
        return EnteredBlock(whole, registry.find_newer(serial, whole))


def list_standings(place: RegistryPlace) -> tuple[UnitStanding, ...]:
    """Return the units, with what `monitor` said last of each.

    Raises:
        InputError: there is no registry.
    """
    with open_registry(place.path) as registry:
        return tuple(registry.list_standings())


def tell_history(place: RegistryPlace, serial: str) -> UnitHistoryResult:
    """Return what happened to a unit, the oldest first.

    Raises:
        InputError: there is no such unit.
    """
    with open_registry(place.path) as registry:
        return UnitHistoryResult(serial, registry.tell_history(serial))


def _read_own_block(directory: Path, file: Path, serial: str) -> bytes:
    """Return the bytes of a unit's block.

    Args:
        directory: of zerodrift.toml, whose firmware may hold the design.
        file: of the block.
        serial: of the unit.

    Raises:
        InputError: it is no sound block, or not of this unit.
    """
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
