"""A unit's block: its bytes, its fields, and why some blocks are refused.

Layout (docs/reference/block-format.md), little-endian, no gaps:

    0   u32   magic "ZDBK"          16  u32   second word of the design   32  char[24] serial
    4   u32   format of the block   20  u32   sequence: the newest has the largest
    8   u32   length in bytes       24  u32   calibrated, days since 1970-01-01
    12  u32   first word of design  28  u32   CRC of the self-test's answers
    56  u64   reserved, 0           64  the fields, widest numbers first
    -4  u32   CRC-32 of all before
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import InputError
from zerodrift.blocks.design import FORMAT_OF_BLOCK, BlockDesign, find_outside
from zerodrift.blocks.fields import TYPES, put, read
from zerodrift.export.integer_model import IntegerModel

MAGIC = 0x4B42445A
"""The bytes Z, D, B, K."""
HEADER_BYTES = 64
SERIAL_BYTES = 24
ALIGNMENT = 8
EPOCH = date(1970, 1, 1)


@dataclass(frozen=True)
class BlockNotes:
    """Serial number, date and sequence of a block."""

    serial: str
    """Up to 24 bytes of UTF-8."""
    calibrated: date
    sequence: int
    """Of two slots the one with the larger number is newer; 1 .. 2^32 - 1."""


@dataclass(frozen=True)
class BlockHeader:
    """The header of a block of any design; the words in their order."""

    magic: int
    format: int
    size: int
    design: int
    design_2: int
    sequence: int
    days: int
    answers: int
    serial: str
    crc: int

    @property
    def notes(self) -> BlockNotes:
        """Serial, date and sequence."""
        return BlockNotes(self.serial, EPOCH + timedelta(days=self.days), self.sequence)


@dataclass(frozen=True)
class UnitBlock:
    """A block that was read: its notes, its numbers by field, its answers."""

    notes: BlockNotes
    answers: int
    """CRC-32 of the answers that the self-test has to give."""
    numbers: Mapping[str, IntArray]
    crc: int
    size: int


def find_size(design: BlockDesign) -> int:
    """Return the length of every block of a design, in bytes: a multiple of 8."""
    used = HEADER_BYTES + sum(_count(f.place.sizes) * _width(f.place.type) for f in design.fields)
    return -(-(used + 4) // ALIGNMENT) * ALIGNMENT


def _count(sizes: tuple[int, ...]) -> int:
    return int(np.prod(sizes, dtype=np.int64))


def _width(kind: str) -> int:
    return np.dtype(TYPES[kind]).itemsize


def encode(design: BlockDesign, model: IntegerModel, notes: BlockNotes, answers: int) -> bytes:
    """Return a unit's block.

    Args:
        design: of the unit.
        model: the unit's, in the design's format (`BlockDesign.fit`).
        notes: serial, date and sequence.
        answers: CRC of what its self-test answers.

    Raises:
        InputError: the serial number, date or sequence does not fit its field.
    """
    return encode_numbers(
        design, {f.place.name: read(model, f.place) for f in design.fields}, notes, answers
    )


def encode_numbers(
    design: BlockDesign, numbers: Mapping[str, IntArray], notes: BlockNotes, answers: int
) -> bytes:
    """Return a block of any numbers that fit their types, admissible or not."""
    serial = notes.serial.encode()
    if not 0 < len(serial) <= SERIAL_BYTES or "\0" in notes.serial:
        raise InputError(
            f"serial '{notes.serial}': {len(serial)} bytes in UTF-8; a block holds 1 to"
            f" {SERIAL_BYTES}. Shorten it."
        )
    days = (notes.calibrated - EPOCH).days
    if days < 0 or not 0 < notes.sequence < 2**32:
        raise InputError(
            f"block of {notes.serial}: calibrated {notes.calibrated}, sequence {notes.sequence};"
            " expected a date from 1970 on and a sequence of 1 .. 2^32 - 1."
        )
    size = find_size(design)
    words = (MAGIC, FORMAT_OF_BLOCK, size, *design.words, notes.sequence, days, answers)
    body = np.array(words, dtype="<u4").tobytes() + serial.ljust(SERIAL_BYTES, b"\0") + bytes(8)
    for field in design.fields:
        body += numbers[field.place.name].astype(TYPES[field.place.type]).tobytes()
    body = body.ljust(size - 4, b"\0")
    return seal(body)


def seal(body: bytes) -> bytes:
    """Return a block's bytes with their CRC."""
    return body + zlib.crc32(body).to_bytes(4, "little")


def decode(design: BlockDesign, content: bytes, where: str) -> UnitBlock:
    """Return the content of a block.

    Args:
        design: of the program it is for.
        content: its bytes.
        where: names it in messages.

    Raises:
        InputError: it is cut, of another endianness, format or design, damaged, or outside the set
            for which the certificate is proven.
    """
    header = decode_header(content, where)
    if (header.design, header.design_2) != design.words:
        found = f"{header.design:08x}{header.design_2:08x}"
        raise InputError(
            f"{where}: a block of design {found}, expected {design.identity[:16]}. Take the block"
            " that was made for this program, or flash the program that belongs to it."
        )
    if header.size != find_size(design):
        raise InputError(
            f"{where}: {header.size} bytes, expected {find_size(design)}. Make the block again with"
            " `zerodrift firmware`."
        )
    numbers, at = {}, HEADER_BYTES
    for field in design.fields:
        place = field.place
        end = at + _count(place.sizes) * _width(place.type)
        found_numbers = np.frombuffer(content[at:end], dtype=TYPES[place.type])
        numbers[place.name] = found_numbers.astype(np.int64).reshape(place.sizes)
        at = end
        why = find_outside(field, numbers[place.name])
        if why:
            raise InputError(
                f"{where}: {place.name}: {why}, so that nothing is proven of it. Make the block"
                " again with `zerodrift firmware`."
            )
    if any(content[at:-4]):
        raise InputError(
            f"{where}: the bytes between numbers and CRC are not 0. Make the block again"
            " with `zerodrift firmware`."
        )
    return UnitBlock(header.notes, header.answers, numbers, header.crc, header.size)


def decode_header(content: bytes, where: str) -> BlockHeader:
    """Return the header of a block of any design.

    Raises:
        InputError: it is cut, of another endianness or format, or damaged.
    """
    if len(content) < HEADER_BYTES + 4:
        raise InputError(
            f"{where}: {len(content)} bytes are no block; its header alone has {HEADER_BYTES}."
            " It was cut, or is another file: copy it again, or name the block's."
        )
    serial = content[32 : 32 + SERIAL_BYTES].rstrip(b"\0").decode(errors="replace")
    crc = int.from_bytes(content[-4:], "little")
    words: list[int] = np.frombuffer(content[:32], dtype="<u4").tolist()
    magic, form, size, design, design_2, sequence, days, answers = words
    header = BlockHeader(magic, form, size, design, design_2, sequence, days, answers, serial, crc)
    if header.magic == int.from_bytes(MAGIC.to_bytes(4, "little"), "big"):
        raise InputError(
            f"{where}: the block's words lie with the highest byte first; blocks are little-endian."
            " Swap the bytes back in what copied it."
        )
    if header.magic != MAGIC:
        raise InputError(
            f"{where}: begins with {content[:4]!r}; a block begins with b'ZDBK'. Name the block's"
            " file, or make it again with `zerodrift firmware`."
        )
    if header.format != FORMAT_OF_BLOCK:
        age = "an older" if header.format < FORMAT_OF_BLOCK else "a newer"
        raise InputError(
            f"{where}: {age} format, {header.format}; this version knows {FORMAT_OF_BLOCK}. Make"
            " the block again with `zerodrift firmware`, or take the zerodrift that wrote it."
        )
    if header.size != len(content):
        raise InputError(
            f"{where}: {len(content)} bytes, its header says {header.size}: it was cut or has"
            " something behind it. Copy it again, as many bytes as the header says."
        )
    if zlib.crc32(content[:-4]) != crc:
        raise InputError(
            f"{where}: its CRC is {zlib.crc32(content[:-4]):08x}, it says {crc:08x}: it was"
            " damaged or edited. Copy it again, or make it again with `zerodrift firmware`."
        )
    return header


def apply(design: BlockDesign, block: UnitBlock) -> IntegerModel:
    """Return the integer model that the program computes with a block."""
    return put(design.model, {f.place: block.numbers[f.place.name] for f in design.fields})
