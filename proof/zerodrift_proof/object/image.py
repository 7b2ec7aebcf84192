"""A linked program: its ELF file, its bytes that cannot change, and where its kernels lie.

ELF files of 32 bits, little end first: sections, symbols, an Arm core's build attributes.

Written from the System V ABI (chapters 4 and 5) and Arm's IHI 0044 and IHI 0045.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

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


ARMV6_M = (11, 12, 16)
"""CPU architectures of the Arm ABI's attributes: v6-M, v6S-M, v8-M baseline."""
ARMV7E_M = (13, 17, 21)
"""v7E-M, v8-M mainline, v8.1-M mainline."""


@dataclass(frozen=True)
class Kernel:
    """A layer's function in assembly, and the constants that it is given."""

    at: int
    size: int
    """Bytes, or 0 where the program does not say."""
    stream: int
    stream_bytes: int
    file: str
    """Of which source, as far as the program says."""


@dataclass(frozen=True)
class Image:
    """The constant part of a program."""

    spans: tuple[ElfSpan, ...]
    symbols: tuple[ElfSymbol, ...] = field(repr=False)
    unaligned: bool
    """Whether a word may be read from any even address."""

    def read(self, at: int, size: int) -> bytes | None:
        """Return bytes that cannot change; None where there are none."""
        for span in self.spans:
            if span.at <= at and at + size <= span.at + len(span.content):
                return span.content[at - span.at : at - span.at + size]
        return None

    def fetch(self, at: int) -> bytes | None:
        """Return two bytes of an instruction."""
        for span in self.spans:
            if span.runs and span.at <= at < span.at + len(span.content) - 1:
                return span.content[at - span.at : at - span.at + 2]
        return None

    def change(self, at: int, content: bytes) -> "Image":
        """Return this image with other bytes at an address."""
        spans = []
        for span in self.spans:
            first = at - span.at
            if first >= 0 and first + len(content) <= len(span.content):
                old = span.content
                new = old[:first] + content + old[first + len(content) :]
                spans.append(ElfSpan(span.at, new, span.runs))
            else:
                spans.append(span)
        return Image(tuple(spans), self.symbols, self.unaligned)

    def find_kernels(self, layer: str) -> list[Kernel]:
        """Return what the program holds of a layer's assembly; several where several models do."""
        found: list[Kernel] = []
        function = f"{layer}_assembly"
        for file, symbols in self._by_file():
            code = [s for s in symbols if _base(s.name) == function and s.kind == FUNCTION]
            tables = [s for s in symbols if _base(s.name) == f"{layer}_stream"]
            found.extend(
                Kernel(one.value & ~1, one.size, table.value, table.size, file)
                for one in code
                for table in tables[:1]
            )
        return found

    def _by_file(self) -> list[tuple[str, list[ElfSymbol]]]:
        """Return the symbols of each source file; those of none come last."""
        groups: list[tuple[str, list[ElfSymbol]]] = [("", [])]
        for symbol in self.symbols:
            if symbol.kind == FILE:
                groups.append((symbol.name, []))
            elif symbol.section is not None:
                groups[-1][1].append(symbol)
        return groups


def _base(name: str) -> str:
    """Return a name without what optimisers over the whole program append."""
    return name.partition(".")[0]


class ProgramError(Exception):
    """A program cannot be proven: it is none for a Cortex-M, not linked, stripped, of others."""


def read_image(path: Path) -> Image:
    """Read a linked program for a Cortex-M.

    Raises:
        ProgramError: it is no such program, is not linked, or is stripped; says what to do.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ProgramError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_image(str(path), content)


def parse_image(name: str, content: bytes) -> Image:
    """Return what a linked program holds.

    Args:
        name: of its file, for messages.
        content: of its file.

    Raises:
        ProgramError: as `read_image`.
    """
    try:
        return _parse(name, content)
    except (ElfError, UnicodeDecodeError) as error:
        raise ProgramError(
            f"{name}: is no ELF file ({error}). Give the linker's output, not a .bin or .hex."
        ) from error


def _parse(name: str, content: bytes) -> Image:
    elf = read_elf(content)
    if not elf.is_arm:
        machine = MACHINES.get(elf.machine, f"machine {elf.machine}")
        raise ProgramError(f"{name}: is built for {machine}; --elf proves programs for Cortex-M")
    if not elf.is_linked:
        raise ProgramError(
            f"{name}: is not linked: addresses of its tables are missing. Give the linker's output."
        )
    symbols = elf.list_symbols()
    if symbols is None:
        raise ProgramError(
            f"{name}: has no symbols; it was stripped. Give the program as the linker wrote it,"
            " before strip or objcopy, and not linked with -s (zig cc -Os does so without -g)."
        )
    architecture = elf.find_attribute(CPU_ARCH)
    if architecture not in (None, *ARMV6_M, *ARMV7E_M):
        raise ProgramError(
            f"{name}: is built for an Arm core without a kernel in assembly (Tag_CPU_arch"
            f" {architecture}); --elf knows Armv6-M, Armv7E-M and Armv8-M"
        )
    unaligned = elf.find_attribute(UNALIGNED_ACCESS) == 1
    spans = tuple(elf.list_constants())
    return Image(spans, symbols, architecture in ARMV7E_M and unaligned)
