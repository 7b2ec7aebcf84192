"""The symbols of a compiled program, as pyelftools reads them."""

from collections.abc import Iterator
from dataclasses import dataclass

from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import ARMAttributesSection, SymbolTableSection

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


@dataclass(frozen=True)
class ElfSpan:
    """Bytes at an address."""

    at: int
    content: bytes
    runs: bool
    """Whether they are instructions."""


def list_constants(image: ELFFile) -> Iterator[ElfSpan]:
    """Yield what a program has in memory and cannot write to, section by section."""
    for section in image.iter_sections():
        flags = section["sh_flags"]
        fixed = flags & SH_FLAGS.SHF_ALLOC and not flags & SH_FLAGS.SHF_WRITE
        if fixed and section["sh_type"] == "SHT_PROGBITS":
            runs = bool(flags & SH_FLAGS.SHF_EXECINSTR)
            yield ElfSpan(section["sh_addr"], section.data(), runs)


def is_arm(image: ELFFile) -> bool:
    """Return whether a program is for an Arm core of 32 bits, little end first."""
    return image["e_machine"] == "EM_ARM" and image.elfclass == 32 and image.little_endian


def is_linked(image: ELFFile) -> bool:
    """Return whether the addresses in a program are those that it runs at."""
    return image["e_type"] in ("ET_EXEC", "ET_DYN")


def find_attribute(image: ELFFile, tag: str) -> int | None:
    """Return what a program's build attributes say (Arm IHI 0045); None where nothing."""
    section = image.get_section_by_name(".ARM.attributes")
    if not isinstance(section, ARMAttributesSection):
        return None
    for subsection in section.iter_subsections("aeabi"):
        for part in subsection.iter_subsubsections("TAG_FILE"):
            for attribute in part.iter_attributes(tag):
                return int(attribute.value)
    return None
