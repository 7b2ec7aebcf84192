"""What a linked program holds: its bytes that cannot change, and where its kernels lie."""

from dataclasses import dataclass, field
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.elf import (
    ElfSpan,
    ElfSymbol,
    find_attribute,
    is_arm,
    is_linked,
    list_constants,
    list_symbols,
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
            code = [s for s in symbols if _base(s.name) == function and s.kind == "STT_FUNC"]
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
            if symbol.kind == "STT_FILE":
                groups.append((symbol.name, []))
            elif isinstance(symbol.section, int):
                groups[-1][1].append(symbol)
        return groups


def _base(name: str) -> str:
    """Return a name without what optimisers over the whole program append."""
    return name.partition(".")[0]


def read_image(path: Path) -> Image:
    """Read a linked program for a Cortex-M.

    Raises:
        InputError: it is no such program, is not linked, or is stripped; says what to do.
    """
    try:
        with path.open("rb") as file:
            return _read(path, ELFFile(file))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ELFError, ValueError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: is no ELF file ({error}). Give the linker's output, not a .bin or .hex."
        ) from error


def _read(path: Path, elf: ELFFile) -> Image:
    if not is_arm(elf):
        raise InputError(
            f"{path}: is built for {elf.get_machine_arch()}; --elf proves programs for Cortex-M"
        )
    if not is_linked(elf):
        raise InputError(
            f"{path}: is not linked: addresses of its tables are missing. Give the linker's output."
        )
    try:
        symbols = tuple(list_symbols(elf))
    except CheckError as error:
        raise InputError(
            f"{path}: has no symbols; it was stripped. Give the program as the linker wrote it,"
            " before strip or objcopy, and not linked with -s (zig cc -Os does so without -g)."
        ) from error
    architecture = find_attribute(elf, "TAG_CPU_ARCH")
    if architecture not in (None, *ARMV6_M, *ARMV7E_M):
        raise InputError(
            f"{path}: is built for an Arm core without a kernel in assembly (Tag_CPU_arch"
            f" {architecture}); --elf knows Armv6-M, Armv7E-M and Armv8-M"
        )
    unaligned = find_attribute(elf, "TAG_CPU_UNALIGNED_ACCESS") == 1
    spans = tuple(list_constants(elf))
    return Image(spans, symbols, architecture in ARMV7E_M and unaligned)
