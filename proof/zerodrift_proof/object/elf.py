"""ELF files of 32 bits, little end first: sections, symbols, an Arm core's build attributes.

Written from the System V ABI (chapters 4 and 5) and Arm's IHI 0044 and IHI 0045.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

ARM, EXECUTABLE, SHARED = 40, 2, 3
MACHINES = {3: "x86", 8: "MIPS", 62: "x64", 83: "AVR", 94: "Xtensa", 183: "AArch64", 243: "RISC-V"}
"""Other machines that programs are built for, by their number in the file."""
PROGBITS, SYMBOLS, ATTRIBUTES = 1, 2, 0x70000003
"""Types of sections."""
WRITE, ALLOC, RUN = 1, 2, 4
"""Flags of a section."""
FUNCTION, FILE = 2, 4
"""Kinds of a symbol."""
UNDEFINED, RESERVED = 0, 0xFF00
"""No section holds such a symbol: another object does, or it is a number."""
CPU_ARCH, UNALIGNED_ACCESS = 6, 34
"""Tags of attributes."""
_TEXTS = (4, 5, 32, 65, 67)
"""Tags below 128 whose value is, or ends in, a text; of those above 32 also every odd one."""


class ElfError(ValueError):
    """It is no such file, or its parts do not fit together."""


@dataclass(frozen=True)
class Section:
    """A part of the file."""

    name: str
    type: int
    flags: int
    at: int
    """Its address in memory."""
    content: bytes
    link: int
    """The section that goes with it: of symbols, that of their names."""


@dataclass(frozen=True)
class ElfSymbol:
    """A name of a program and what lies there."""

    name: str
    value: int
    """Its address, or a number that an assembler was told."""
    size: int
    """Bytes."""
    kind: int
    """FUNCTION, FILE or others."""
    section: int | None
    """The number of its section; None where no section holds it."""


@dataclass(frozen=True)
class ElfSpan:
    """Bytes at an address that a program cannot write to."""

    at: int
    content: bytes
    runs: bool
    """Whether they are instructions."""


@dataclass(frozen=True)
class Elf:
    """A program."""

    machine: int
    is_small: bool
    """Of 32 bits, little end first; of others no section is read."""
    type: int
    sections: tuple[Section, ...] = ()

    @property
    def is_arm(self) -> bool:
        """Whether it is for an Arm core of 32 bits."""
        return self.machine == ARM and self.is_small

    @property
    def is_linked(self) -> bool:
        """Whether its addresses are those that it runs at."""
        return self.type in (EXECUTABLE, SHARED)

    def list_symbols(self) -> tuple[ElfSymbol, ...] | None:
        """Return the symbols in their order; None where it was stripped of them."""
        table = next((s for s in self.sections if s.name == ".symtab" and s.type == SYMBOLS), None)
        if table is None:
            return None
        if not 0 < table.link < len(self.sections) or len(table.content) % 16:
            raise ElfError("its symbols have no names")
        names = self.sections[table.link].content
        found = []
        for at in range(0, len(table.content), 16):
            name, value, size, info, _, section = struct.unpack_from("<IIIBBH", table.content, at)
            held = section if UNDEFINED < section < RESERVED else None
            found.append(ElfSymbol(_read_text(names, name), value, size, info & 15, held))
        return tuple(found)

    def list_constants(self) -> Iterator[ElfSpan]:
        """Yield what it has in memory and cannot write to, section by section."""
        for one in self.sections:
            if one.type == PROGBITS and one.flags & (ALLOC | WRITE) == ALLOC:
                yield ElfSpan(one.at, one.content, bool(one.flags & RUN))

    def find_attribute(self, tag: int) -> int | None:
        """Return a number among what the build says of the whole file; None where it says none."""
        for one in self.sections:
            if one.type == ATTRIBUTES and one.name == ".ARM.attributes":
                return _find_attribute(one.content, tag)
        return None


def read_elf(content: bytes) -> Elf:
    """Read a program.

    Raises:
        ElfError: it is no ELF file, or it is damaged.
    """
    if content[:4] != b"\x7fELF" or len(content) < 20:
        raise ElfError("Magic number does not match")
    kind, machine = struct.unpack_from("<HH", content, 16)
    if content[4:6] != b"\x01\x01":
        return Elf(machine, False, kind)
    try:
        (first,) = struct.unpack_from("<I", content, 32)
        size, count, names = struct.unpack_from("<HHH", content, 46)
        heads = [struct.unpack_from("<10I", content, first + size * k) for k in range(count)]
        bodies = [_read_body(content, head[1], head[4], head[5]) for head in heads]
        sections = tuple(
            Section(_read_text(bodies[names], head[0]), head[1], head[2], head[3], body, head[6])
            for head, body in zip(heads, bodies, strict=True)
        )
    except (struct.error, IndexError) as error:
        raise ElfError(f"it is cut off or damaged: {error}") from error
    return Elf(machine, True, kind, sections)


def _read_body(content: bytes, kind: int, at: int, size: int) -> bytes:
    if kind in (0, 8):  # of nothing, and of memory that begins as zeros: no bytes in the file
        return b""
    if at + size > len(content):
        raise ElfError("it is cut off")
    return content[at : at + size]


def _read_text(content: bytes, at: int) -> str:
    end = content.find(b"\0", at)
    if not 0 <= at <= end:
        raise ElfError("a name is cut off")
    return content[at:end].decode()


class _Reader:
    """Reads attributes byte by byte."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    def take(self, count: int) -> bytes:
        if count < 0 or self.at + count > len(self.content):
            raise ElfError("its attributes are cut off")
        self.at += count
        return self.content[self.at - count : self.at]

    def number(self) -> int:
        """Read seven bits a byte, the low ones first."""
        found, by = 0, 0
        while True:
            (byte,) = self.take(1)
            found |= (byte & 127) << by
            by += 7
            if byte < 128:
                return found

    def text(self) -> bytes:
        end = self.content.find(b"\0", self.at)
        return self.take(end - self.at + 1)[:-1]

    def part(self, behind: int) -> "_Reader":
        """Read a length of 4 bytes, which counts itself and `behind` more before it."""
        return _Reader(self.take(int.from_bytes(self.take(4), "little") - 4 - behind))

    @property
    def is_left(self) -> bool:
        return self.at < len(self.content)


def _find_attribute(content: bytes, tag: int) -> int | None:
    whole = _Reader(content)
    if whole.take(1) != b"A":
        raise ElfError("its attributes are of another version")
    while whole.is_left:
        vendor = whole.part(0)
        if vendor.text() != b"aeabi":
            continue
        while vendor.is_left:
            (scope,) = vendor.take(1)
            part = vendor.part(1)
            while scope == 1 and part.is_left:
                found = part.number()
                has_text = found in _TEXTS or (found > 32 and found % 2 == 1)
                value = part.number() if not has_text or found == 32 else 0
                if has_text:
                    part.text()
                if found == tag:
                    return value
    return None
