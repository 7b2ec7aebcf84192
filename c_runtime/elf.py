"""The symbols of a compiled program, as pyelftools reads them."""

from dataclasses import dataclass

from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from zerodrift.base.errors import CheckError


@dataclass(frozen=True)
class ElfSymbol:
    """A name of a program and what lies there."""

    name: str
    value: int
    """Its address, or a number that an assembler was told."""
    size: int
    """Bytes."""
    kind: str
    """Of the format's own words: STT_FUNC, STT_OBJECT, ..."""
    section: int | str
    """The number of its section, or SHN_UNDEF for what another object holds, SHN_ABS, ..."""


def list_symbols(image: ELFFile) -> list[ElfSymbol]:
    """Return the symbols in their order.

    Raises:
        CheckError: the program has no table of them.
    """
    table = image.get_section_by_name(".symtab")
    if not isinstance(table, SymbolTableSection):
        raise CheckError("the compiled program has no table of symbols; it was stripped")
    return [
        ElfSymbol(s.name, s["st_value"], s["st_size"], s["st_info"]["type"], s["st_shndx"])
        for s in table.iter_symbols()
    ]


def is_constant(image: ELFFile, symbol: ElfSymbol) -> bool:
    """Return whether a symbol names what the program cannot write to."""
    if not isinstance(symbol.section, int):
        return False
    return not image.get_section(symbol.section)["sh_flags"] & SH_FLAGS.SHF_WRITE
