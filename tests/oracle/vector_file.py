"""A file of golden vectors, read without the code that wrote it."""

import json
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Vectors:
    """Codes of each step, and the rows that some steps must give."""

    codes: list[list[int]]
    """One row of codes per step, written in the file as `times: hex hex ...`."""
    settled: bool
    """Begun by `settle` at the first codes, or by `init`."""
    every: int
    """Each row is that of the last of so many steps."""
    rows: list[list[int]]
    """Drifts, flags, h_q30 of the topmost GRU."""
    crc: int
    """CRC-32 of the rows of all steps, as little-endian int32."""


def read_vectors(path: Path) -> Vectors:
    """Read one file."""
    body = json.loads(path.read_text(encoding="utf-8"))
    codes = []
    for line in body["codes"]:
        times, row = line.split(":")
        codes += [[read_hex(word) for word in row.split()]] * int(times)
    rows = [[read_hex(word) for word in row.split()] for row in body["rows"]]
    return Vectors(codes, body["settled"], body["every"], rows, int(body["crc"], 16))


def read_hex(word: str) -> int:
    """Return a number in two's complement, as wide as its digits are many."""
    bits, number = 4 * len(word), int(word, 16)
    return number - 2**bits if number >= 2 ** (bits - 1) else number


def compute_crc(rows: Iterable[list[int]]) -> int:
    """Return the CRC-32 that the file keeps."""
    return zlib.crc32(b"".join(struct.pack(f"<{len(row)}i", *row) for row in rows))
