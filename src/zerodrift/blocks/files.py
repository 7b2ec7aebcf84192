"""Blocks as files: bytes, Intel HEX for programmers, a C array, JSON; written and read."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from zerodrift.base.errors import InputError
from zerodrift.base.records import Json, from_json, to_json
from zerodrift.blocks.block import (
    BlockNotes,
    decode,
    decode_header,
    encode_numbers,
)
from zerodrift.blocks.design import FILE_NAME, BlockDesign, load_design

SUFFIXES = (".bin", ".hex", ".json")
"""Of files that are read as blocks; the C array is for compilers."""
BLOCK = "block"
"""Stem of the files of a single unit, beside its program."""
BLOCK_FILES = tuple(f"{BLOCK}{suffix}" for suffix in (*SUFFIXES, ".c"))
HEX_BYTES = 16
"""In a record of Intel HEX."""
END_OF_FILE = ":00000001FF"


@dataclass(frozen=True)
class BlockRecord:
    """A block as JSON has it."""

    block: int
    design: str
    """The first 16 digits of the design's identity."""
    serial: str
    calibrated: str
    """YYYY-MM-DD."""
    sequence: int
    answers: int
    crc: int
    numbers: Mapping[str, tuple[int, ...]]
    """Field -> its numbers, rows one after the other."""


def render_block(
    design: BlockDesign, content: bytes, stem: str, address: int = 0
) -> dict[str, bytes]:
    """Return a block's files by name: STEM.bin, .hex, .c and .json.

    Args:
        design: of the block.
        content: its bytes, sound ones.
        stem: of the files' names, and of the C array's.
        address: of the block in flash, for the HEX file.
    """
    return {
        f"{stem}.bin": content,
        f"{stem}.hex": write_hex(content, address).encode(),
        f"{stem}.c": write_array(content, stem).encode(),
        f"{stem}.json": write_json(design, content, stem).encode(),
    }


def write_hex(content: bytes, address: int = 0) -> str:
    """Return bytes as Intel HEX, from an address of 32 bits on."""
    lines, upper = [], -1
    for at in range(0, len(content), HEX_BYTES):
        place = address + at
        if place >> 16 != upper:
            upper = place >> 16
            lines.append(_write_record(0, 4, upper.to_bytes(2, "big")))
        lines.append(_write_record(place & 0xFFFF, 0, content[at : at + HEX_BYTES]))
    return "\n".join([*lines, END_OF_FILE, ""])


def _write_record(address: int, kind: int, data: bytes) -> str:
    record = bytes([len(data)]) + address.to_bytes(2, "big") + bytes([kind]) + data
    return ":" + (record + bytes([-sum(record) & 0xFF])).hex().upper()


def read_hex(text: str, where: str) -> bytes:
    """Return the bytes of an Intel HEX file, which must lie in one piece.

    Raises:
        InputError: names the line, and what is wrong with it.
    """
    pieces: dict[int, bytes] = {}
    base, ended = 0, False
    for number, line in enumerate(text.split(), start=1):
        try:
            record = bytes.fromhex(line.removeprefix(":"))
        except ValueError:
            record = b""
        if not line.startswith(":") or len(record) < 5 or len(record) != record[0] + 5:
            raise InputError(f"{where}:{number}: no record of Intel HEX: '{line:.20}'")
        if sum(record) & 0xFF:
            raise InputError(f"{where}:{number}: the record's checksum differs: it was damaged.")
        kind, data = record[3], record[4:-1]
        if kind == 4:
            base = int.from_bytes(data, "big") << 16
        elif kind == 0:
            pieces[base + int.from_bytes(record[1:3], "big")] = data
        ended = kind == 1
    if not ended:
        raise InputError(f"{where}: no end-of-file record: the file was cut.")
    content, at = b"", min(pieces, default=0)
    for address in sorted(pieces):
        if address != at + len(content):
            raise InputError(f"{where}: a gap before address 0x{address:08X}; a block has none.")
        content += pieces[address]
    return content


def write_array(content: bytes, name: str) -> str:
    """Return bytes as a C array of words, aligned as a block has to be."""
    words = np.frombuffer(content, dtype="<u8").tolist()
    own = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    lines = [f"    UINT64_C(0x{word:016x})," for word in words]
    return "\n".join(
        [
            f"/* A unit's block, {len(content)} bytes; for a little-endian core. */",
            "#include <stdint.h>",
            "",
            f"const uint64_t block_{own}[{len(words)}] = {{",
            *lines,
            "};",
            "",
        ]
    )


def write_json(design: BlockDesign, content: bytes, where: str) -> str:
    """Return a block as JSON."""
    block, header = decode(design, content, where), decode_header(content, where)
    record = BlockRecord(
        block=header.format,
        design=design.identity[:16],
        serial=header.serial,
        calibrated=header.notes.calibrated.isoformat(),
        sequence=header.sequence,
        answers=header.answers,
        crc=header.crc,
        numbers={name: tuple(found.ravel().tolist()) for name, found in block.numbers.items()},
    )
    told: Json = to_json(record)
    return json.dumps(told, indent=1) + "\n"


def read_json(design: BlockDesign, text: str, where: str) -> bytes:
    """Return the bytes of a block that JSON holds.

    Raises:
        InputError: it is no block, or of another design, or its CRC is not that of its content.
    """
    try:
        record = from_json(BlockRecord, json.loads(text), where)
        if record.design != design.identity[:16]:
            raise InputError(
                f"{where}: a block of design {record.design}, expected {design.identity[:16]}."
                " Take the block that was made for this program."
            )
        numbers = {
            f.place.name: np.array(record.numbers[f.place.name]).reshape(f.place.sizes)
            for f in design.fields
        }
        notes = BlockNotes(record.serial, date.fromisoformat(record.calibrated), record.sequence)
        content = encode_numbers(design, numbers, notes, record.answers)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(f"{where}: no block ({type(error).__name__}: {error})") from error
    found = decode_header(content, where).crc
    if found != record.crc:
        raise InputError(
            f"{where}: its CRC is {found:08x}, it says {record.crc:08x}: it was damaged or edited."
        )
    return content


def read_block_file(path: Path, design: BlockDesign | None = None) -> bytes:
    """Return the bytes of a block's file.

    Args:
        path: .bin, .hex or .json.
        design: of the block; JSON needs one. None: what lies beside the file, if anything does.

    Raises:
        InputError: it cannot be read, or is no block; names what is wrong.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if path.suffix == ".hex":
        return read_hex(content.decode("ascii", errors="replace"), str(path))
    if path.suffix != ".json":
        return content
    design = design or find_design_file(path)
    if design is None:
        raise InputError(
            f"{path}: JSON is read with its design, and no {FILE_NAME} lies beside it or above."
            " Name one with --design, or give the .bin."
        )
    return read_json(design, content.decode(errors="replace"), str(path))


def find_design_file(path: Path) -> BlockDesign | None:
    """Return the design beside a block's file, or in one of the two folders above."""
    for folder in list(path.resolve().parents)[:3]:
        if (folder / FILE_NAME).is_file():
            return load_design(folder / FILE_NAME)
    return None


def refuse_same_serials(named: Iterable[tuple[str, str]]) -> None:
    """Refuse a serial number that two blocks have.

    Args:
        named: (where, serial) of each.

    Raises:
        InputError: names both places.
    """
    seen: dict[str, str] = {}
    for where, serial in named:
        if serial in seen:
            raise InputError(
                f"{where}: serial '{serial}' is that of {seen[serial]} too; expected one block per"
                " unit. Correct the serial, or give one of the two alone."
            )
        seen[serial] = where
