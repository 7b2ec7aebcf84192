"""What a linked program holds: its bytes that cannot change, and where its kernels lie."""

from dataclasses import dataclass, field
from pathlib import Path

from zerodrift_proof.object.elf import (
    CPU_ARCH,
    FILE,
    FUNCTION,
    MACHINES,
    UNALIGNED_ACCESS,
    ElfError,
    ElfSpan,
    ElfSymbol,
    read_elf,
)

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
