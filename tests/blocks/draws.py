"""Blocks drawn within a design's set and just outside it: written from the design's file alone.

Shares no code with what chooses the set, encodes blocks or checks them.
"""

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FORMATS = {"i64": "<i8", "i32": "<i4", "i16": "<i2", "u8": "u1"}
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class FileField:
    """A field as the design's file tells it."""

    name: str
    kind: str
    sizes: tuple[int, ...]
    low: int
    high: int
    norm: int
    row: int
    pairs: tuple[int, ...] = ()
    """Of a GRU: words of a row of features, and of the state."""

    @property
    def count(self) -> int:
        """How many numbers it has."""
        return int(np.prod(self.sizes, dtype=np.int64))


@dataclass(frozen=True)
class FileDesign:
    """A design as its file tells it."""

    identity: str
    fields: tuple[FileField, ...]


def read_design(text: str) -> FileDesign:
    """Return what a design's file tells."""
    told = json.loads(text)
    fields = []
    for f in told["fields"]:
        place, bounds = f["place"], (f["low"], f["high"], f["norm"], f["row"])
        own = place["node"] != "guards"
        name = f"{place['node']}_{place['attribute']}" if own else place["attribute"]
        pairs = tuple(f.get("pairs", ()))
        fields.append(FileField(name, place["type"], tuple(place["sizes"]), *bounds, pairs))
    return FileDesign(told["identity"], tuple(fields))


def write_block(design: FileDesign, numbers: dict[str, Numbers], sequence: int = 1) -> bytes:
    """Return the bytes of a block, as docs/reference/block-format.md has them."""
    body = b"".join(numbers[f.name].astype(FORMATS[f.kind]).tobytes() for f in design.fields)
    size = -(-(64 + len(body) + 4) // 8) * 8
    ids = (int(design.identity[:8], 16), int(design.identity[8:16], 16))
    head = b"ZDBK" + struct.pack("<7I", 1, size, *ids, sequence, 20_000, 0)
    whole = (head + b"SN1".ljust(24, b"\0") + bytes(8) + body).ljust(size - 4, b"\0")
    return whole + struct.pack("<I", zlib.crc32(whole))


def draw_admissible(design: FileDesign, seed: int) -> dict[str, Numbers]:
    """Return numbers of every field within the set: anywhere in it, at its corners, or at one."""
    rng = np.random.default_rng(seed)
    manner = seed % 4
    numbers = {}
    for field in design.fields:
        if manner == 0:
            drawn = rng.integers(field.low, field.high, field.count, endpoint=True)
        elif manner == 1:
            drawn = rng.choice(np.array([field.low, field.high]), field.count)
        elif manner == 2:
            drawn = np.full(field.count, field.high if rng.random() < 0.5 else field.low)
        else:
            share = rng.random(field.count) ** 8 * rng.choice([-1, 1], field.count)
            drawn = np.clip((share * field.high).astype(np.int64), field.low, field.high)
        if field.norm:
            drawn = limit_rows(drawn, field, rng)
        if field.pairs:
            drawn = draw_layer(field, manner, rng)
        numbers[field.name] = np.asarray(drawn, dtype=np.int64)
    return numbers


def limit_rows(drawn: Numbers, field: FileField, rng: np.random.Generator) -> Numbers:
    """Return rows of weights whose norms are the largest allowed, or less where they were."""
    rows = drawn.reshape(-1, field.row)
    for row in rows:
        norm = int(np.abs(row).sum())
        if norm > field.norm:
            row[:] = np.trunc(row * (field.norm / norm)).astype(np.int64)
            order = rng.permutation(field.row)
            for at in order:  # what rounding has left over
                room = field.norm - int(np.abs(row).sum())
                sign = -1 if row[at] < 0 else 1
                row[at] = sign * min(abs(int(row[at])) + room, field.high)
    return rows.ravel()


def draw_layer(
    field: FileField, manner: int, rng: np.random.Generator, beyond: str = ""
) -> Numbers:
    """Return a GRU's numbers of which the sums reach the ends of 32 bits, or come near.

    Args:
        field: of the layer.
        manner: 0: any share of what a sum may be; else all of it.
        rng: draws shares and signs.
        beyond: r, u, inside or outside: the sum that is one too large in one unit.
    """
    units, (x, h) = field.sizes[0], field.pairs
    out, at = [], int(rng.integers(units))
    for unit in range(units):
        sums = dict.fromkeys(("r", "u", "inside", "outside"), 2**31 - 1)
        if manner == 0:
            sums = {name: int(most * rng.random()) for name, most in sums.items()}
        if unit == at and beyond:
            sums[beyond] = 2**31
        biases, rows = [], {}
        for name in ("r", "u", "inside"):
            counts = {"r": (x, h), "u": (x, h), "inside": (h,)}[name]
            bias, rows[name] = draw_row(sums[name], 2 * sum(counts), rng)
            biases.append(bias)
        used = abs(biases[2]) + 2**15 * sum(map(abs, rows["inside"]))
        left = max(sums["outside"] - used // 2 - 1, 0)
        bias, rows["outside"] = draw_row(left, 2 * x, rng)
        of_x = [rows["r"][: 2 * x], rows["u"][: 2 * x], rows["outside"]]
        of_h = [rows["r"][2 * x :], rows["u"][2 * x :], rows["inside"]]
        out += [biases[0], biases[1], bias, biases[2], *pack_rows(of_x), *pack_rows(of_h)]
    return np.array(out, dtype=np.int64)


def draw_row(most: int, count: int, rng: np.random.Generator) -> tuple[int, list[int]]:
    """Return a bias and weights with |bias| + 2^15 sum |weights| = most, as far as 16 bits go."""
    share = rng.random() ** 2
    norm = min(int(most * share) >> 15, 32767 * count)
    bias = min(most - (norm << 15), 2**31)
    sign = -1 if bias == 2**31 else int(rng.choice([-1, 1]))
    weights = []
    for left in range(count, 0, -1):
        least = max(norm - 32767 * (left - 1), 0)
        size = int(rng.integers(least, min(norm, 32767), endpoint=True)) if left > 1 else norm
        weights.append(size * int(rng.choice([-1, 1])))
        norm -= size
    return sign * bias, [weights[k] for k in rng.permutation(count)]


def pack_rows(rows: list[list[int]]) -> list[int]:
    """Return rows r, u, n as words of two weights: blocks of two words each, a last one alone."""
    words = [
        [(row[k] & 0xFFFF) | (row[k + 1] & 0xFFFF) << 16 for k in range(0, len(row), 2)]
        for row in rows
    ]
    packed = [w for k in range(0, len(words[0]), 2) for row in words for w in row[k : k + 2]]
    return [w - 2**32 if w >= 2**31 else w for w in packed]


def list_inadmissible(design: FileDesign, seed: int) -> Iterator[tuple[str, bytes]]:
    """Yield what is wrong, and the block: one number out by one, a norm above by one, the rest."""
    rng = np.random.default_rng(seed)
    for field in design.fields:
        for beyond in ("r", "u", "inside", "outside") if field.pairs else ():
            numbers = draw_admissible(design, 4 * seed + 3)
            numbers[field.name] = draw_layer(field, 1, rng, beyond)
            yield f"{beyond} of {field.name} out by one", write_block(design, numbers)
        info = np.iinfo(FORMATS[field.kind])
        for value in (field.low - 1, field.high + 1):
            if not info.min <= value <= info.max:
                continue
            numbers = draw_admissible(design, 4 * seed + 3)
            numbers[field.name][rng.integers(field.count)] = value
            yield f"{field.name} = {value}", write_block(design, numbers)
        if field.norm and field.row * field.high > field.norm:
            numbers = draw_admissible(design, 4 * seed + 3)
            rows = np.zeros((field.count // field.row, field.row), dtype=np.int64)
            row, left = rows[rng.integers(len(rows))], field.norm + 1
            for at in range(field.row):
                row[at] = min(left, field.high) * rng.choice([-1, 1])
                left -= abs(int(row[at]))
            numbers[field.name] = rows.ravel()
            yield f"norm of {field.name} = {field.norm + 1}", write_block(design, numbers)
    sound = write_block(design, draw_admissible(design, 4 * seed))
    for length in rng.integers(0, len(sound), 3):
        yield f"cut to {length}", sound[:length]
    bit = int(rng.integers(8 * len(sound)))
    flipped = bytearray(sound)
    flipped[bit // 8] ^= 1 << (bit % 8)
    yield f"bit {bit} flipped", bytes(flipped)
    words = np.frombuffer(sound, dtype="<u4").astype(">u4").tobytes()
    yield "of another endianness", words
    for at, what in ((4, "format"), (8, "length"), (12, "design"), (16, "design")):
        changed = bytearray(sound[:-4])
        changed[at] ^= 1
        yield f"another {what}", bytes(changed) + struct.pack("<I", zlib.crc32(bytes(changed)))
