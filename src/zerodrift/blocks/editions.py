"""Editions of units' blocks: date and sequence are the unit's own, and change when its numbers do.

A chip with two sound blocks computes with the one of the larger sequence. So a block whose numbers
are others than those of the unit's newest one gets a larger sequence, and the date that is stated
now; one with the same numbers keeps both. What was given is kept in `units.json` beside
zerodrift.toml, which belongs under version control: unlike build/ it cannot be made again. The
registry's blocks and those that lie in the firmware's folder count as well.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import BlockConfig
from zerodrift.base.records import from_json
from zerodrift.blocks.block import EPOCH, decode_header, seal

FILE_NAME = "units.json"
FORMAT = 1
LARGEST = 2**32 - 1
SEQUENCE = slice(20, 24)
"""Bytes of a block's header."""
DAYS = slice(24, 28)
"""The same, of the date of calibration."""


@dataclass(frozen=True)
class Edition:
    """One block of a unit, told from its others."""

    sequence: int
    calibrated: date
    content: str
    """SHA-256 of the block with sequence and date 0 and without its CRC."""


@dataclass(frozen=True)
class _UnitRecord:
    """An edition as units.json has it."""

    sequence: int
    calibrated: str
    """YYYY-MM-DD."""
    content: str


@dataclass(frozen=True)
class _UnitsFile:
    """units.json: serial number -> the newest edition."""

    format: int
    units: Mapping[str, _UnitRecord]


def read_edition(content: bytes, where: str) -> tuple[str, Edition]:
    """Return the serial number of a block and its edition.

    Args:
        content: the block's bytes.
        where: names it in messages.

    Raises:
        InputError: it is cut, damaged, or no block.
    """
    notes = decode_header(content, where).notes
    return notes.serial, Edition(notes.sequence, notes.calibrated, hash_content(content))


def hash_content(content: bytes) -> str:
    """Return the SHA-256 of all that a block says but for its sequence, date and CRC."""
    return hashlib.sha256(_stamp(content, 0, 0)[:-4]).hexdigest()


def number_block(content: bytes, known: Iterable[Edition], asked: BlockConfig) -> bytes:
    """Return a unit's block with its sequence and date.

    The numbers of the newest edition keep its sequence and date. Others, and such as two different
    blocks claim for themselves, get the next sequence, or the one that is stated, and the date
    that is stated.

    Args:
        content: the block, with any sequence and date.
        known: the unit's editions so far, in any order.
        asked: the date and, where it is stated, the sequence of a new edition.

    Raises:
        InputError: the sequence that is stated is not larger than that of the newest edition, or
            there is no larger one.
    """
    editions = tuple(known)
    newest = max((edition.sequence for edition in editions), default=0)
    last = [edition for edition in editions if edition.sequence == newest]
    own = hash_content(content)
    if last and {edition.content for edition in last} == {own}:
        return _stamp(content, newest, (last[0].calibrated - EPOCH).days)
    if newest >= LARGEST or 0 < asked.sequence <= newest:
        serial = decode_header(content, "block").serial
        way = (
            f"State {newest + 1} or more, or leave the key out: it is then counted."
            if newest < LARGEST
            else "Give the unit another serial number."
        )
        raise InputError(
            f"[firmware] sequence: {asked.sequence or 'the next one'} for {serial}, of which there"
            f" is a block of sequence {newest} with other numbers; of two blocks a chip takes the"
            f" one with the larger sequence, so that it has to be larger. {way}"
        )
    days = (asked.calibrated - EPOCH).days
    return _stamp(content, max(newest + 1, asked.number), days)


def _stamp(content: bytes, sequence: int, days: int) -> bytes:
    """Return a block with another sequence and date."""
    body = bytearray(content[:-4])
    body[SEQUENCE] = sequence.to_bytes(4, "little")
    body[DAYS] = days.to_bytes(4, "little")
    return seal(bytes(body))


def load_units(directory: Path) -> dict[str, Edition]:
    """Return serial number -> newest edition, as a project's units.json has it; none without one.

    Raises:
        InputError: it cannot be read, or is damaged.
    """
    path = directory / FILE_NAME
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); {_WAY}") from error
    try:
        found = from_json(_UnitsFile, json.loads(text), path.name)
        if found.format != FORMAT:
            raise ValueError(f"format {found.format}; expected {FORMAT}")
        return {serial: _read_record(serial, unit) for serial, unit in found.units.items()}
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: is no list of units' blocks ({error}); expected for each serial number"
            f' {{"sequence": 3, "calibrated": "2026-03-01", "content": SHA-256}}. {_WAY}'
        ) from error


_WAY = (
    "Take it from version control. Without the file, the blocks in the firmware's folder and the"
    " registry alone say what was given."
)


def _read_record(serial: str, unit: _UnitRecord) -> Edition:
    if not 0 < unit.sequence <= LARGEST:
        raise ValueError(f"{serial}: sequence {unit.sequence}")
    return Edition(unit.sequence, date.fromisoformat(unit.calibrated), unit.content)


def render_units(directory: Path, blocks: Iterable[bytes]) -> bytes:
    """Return units.json with the editions of blocks that are being written, a unit a line.

    Args:
        directory: of the project; what its units.json says of other units stays.
        blocks: sound ones, numbered.

    Raises:
        InputError: the file that is there is damaged.
    """
    units = load_units(directory) | dict(read_edition(block, "block") for block in blocks)
    lines = []
    for serial, edition in sorted(units.items()):
        record = {
            "sequence": edition.sequence,
            "calibrated": edition.calibrated.isoformat(),
            "content": edition.content,
        }
        lines.append(f"  {json.dumps(serial, ensure_ascii=False)}: {json.dumps(record)}")
    body = ",\n".join(lines)
    return f'{{"format": {FORMAT},\n "units": {{\n{body}\n }}\n}}\n'.encode()
