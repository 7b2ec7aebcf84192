"""Flash, RAM, stack and symbols of a compiled program, as compilers and pyelftools tell them."""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.relocation import RelocationSection
from elftools.elf.sections import SymbolTableSection

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode

# The symbols of a compiled program, as pyelftools reads them.


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


# Flash, RAM and stack of a generated model on a chip, read from what a cross-compiler makes of it.
#
# The compiler is the clang inside the `ziglang` wheel, so that no toolchain has to be installed, or
# the GNU one. Stack frames are what the compiler says of itself: clang's -fstack-size-section,
# gcc's -fstack-usage. Flash counts code and constants of model and runtime, self-test included (a
# linker drops it where it is not called), the compiler's helper routines (64-bit arithmetic on
# small cores) excluded. RAM is the state struct; stack is the deepest chain of calls below any
# function that the firmware calls. It is one compiler's with one set of flags: another one's frames
# differ.

FLAGS = (
    "-std=c99",
    "-Os",
    "-ffreestanding",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
    "-ffunction-sections",
    "-fdata-sections",
)
_STACK_FLAG = {"zig": "-fstack-size-section", "gcc": "-fstack-usage"}
HELPER_STACK_BYTES = 32
"""Taken for each routine of the compiler's own library, as the 64-bit product on a Cortex-M0+."""

_IN_FLASH = (".text", ".rodata", ".srodata", ".data", ".sdata")
_LAYER = (
    *("gru_step", "gru_assembly", "zd_gru_step_after", "zd_gru_step_before", "zd_gru_step_pairs"),
    *("lstm_step", "lstm_assembly", "zd_lstm_step"),
)
_LAYER_SECTION = re.compile(
    r"\.((gru|lstm)|(gru|lstm)_(?!is_sound)\w+|zd_(gru|lstm)_\w+|zd_(tanh|sigmoid)_\w+|zd_dot\w*)$"
)
ENTRIES = ("init", "settle", "step", "selftest", "save", "restore")
"""The functions that a firmware calls."""
_STACK_SIZES = ".stack_sizes"
_ASSEMBLY_STACK = "zd_stack_"


@dataclass(frozen=True)
class Footprint:
    """What a model needs of a chip, in bytes, compiled for size."""

    core: str
    flash_bytes: int
    """Code and constants of model and runtime, self-test and activation table included; without
    the compiler's own library (`helpers`)."""
    ram_bytes: int
    """The state struct, one per sensor."""
    stack_bytes: int
    """Of the deepest of `ENTRIES`, with everything that it calls."""
    stacks: tuple[tuple[str, int], ...]
    """The same of each of `ENTRIES`, the deepest first."""
    compiler: str
    """What made these numbers, as it names itself."""
    flags: tuple[str, ...]
    """The compiler's, for code and size."""
    helpers: tuple[str, ...]
    """Routines of the compiler's library that are called, as 64-bit products on a Cortex-M0+."""
    layer_flash_bytes: int
    """Of the flash: the recurrent layer's step, its weights and the activation table."""
    layer_stack_bytes: int
    """Of the recurrent layer's step alone; 0 if the compiler has merged it into its callers."""


def measure_footprint(
    code: GeneratedCode,
    core: str = "cortex-m4",
    flags: tuple[str, ...] = (),
    compiler: str = "zig",
) -> Footprint:
    """Return the footprint of a model, compiled with -Os.

    Args:
        code: the model's C.
        core: one of `cores.list_cores`.
        flags: further ones of the compiler, as -DZD_SMALL.
        compiler: "zig" or "gcc".

    Raises:
        InputError: the core is unknown, or the compiler is missing.
        CheckError: the C does not compile for it.
    """
    compilers = [c for c in find_cross_compilers(core) if c.name == compiler]
    if not compilers:
        remedy = "`pip install ziglang`" if compiler == "zig" else "`make setup-qemu`"
        raise InputError(f"sizes on {core} need the compiler {compiler}: {remedy}")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_sources(code, folder)
        unit = folder / "zd_unit.c"  # one object holds model, runtime and a state to measure
        unit.write_text(
            f'#include "{code.source_name}"\n#include "zd_runtime.c"\n'
            f"{code.prefix}_state_t zd_probe_state;\n",
            encoding="utf-8",
        )
        target = folder / "zd_unit.o"
        told = [_STACK_FLAG[compiler], *flags]
        compilers[0].run([*FLAGS, *told, f"-I{folder}", "-c", str(unit), "-o", str(target)])
        unit_object = _read(target, _read_stack_usage(target.with_suffix(".su")))
    depths = ((entry, unit_object.find_depth(f"{code.prefix}_{entry}")) for entry in ENTRIES)
    stacks = tuple(sorted(depths, key=lambda item: -item[1]))
    return Footprint(
        core=core,
        flash_bytes=unit_object.flash,
        ram_bytes=unit_object.sizes["zd_probe_state"],
        stack_bytes=stacks[0][1],
        stacks=stacks,
        compiler=compilers[0].describe(),
        flags=("-Os", *flags),
        helpers=unit_object.helpers,
        layer_flash_bytes=unit_object.layer_flash,
        layer_stack_bytes=max(
            (unit_object.find_depth(name) for name in unit_object.frames if name in _LAYER),
            default=0,
        ),
    )


@dataclass(frozen=True)
class _Object:
    """What a relocatable ELF compiled with FLAGS tells."""

    flash: int
    layer_flash: int
    sizes: dict[str, int]
    """Data symbol -> its size."""
    frames: dict[str, int]
    """Function -> bytes of its own stack frame."""
    calls: dict[str, set[str]]
    """Function -> the functions it calls."""
    helpers: tuple[str, ...]

    def find_depth(self, function: str) -> int:
        """Return the worst stack of `function` with what it calls; there is no recursion."""
        below = [self.find_depth(called) for called in self.calls.get(function, ())]
        return self.frames[function] + max(below, default=0)


def _read_stack_usage(path: Path) -> dict[str, int]:
    """Return function -> bytes of its frame from what -fstack-usage has written, if it has."""
    frames: dict[str, int] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        where, size, kind = line.split("\t")
        if not kind.startswith("static"):
            raise CheckError(f"{where}: a frame of {kind} size. No bound of the stack is known.")
        name = where.rsplit(":", 1)[-1]
        frames[name] = max(int(size), frames.get(name, 0))
    return frames


def _read(path: Path, told: dict[str, int]) -> _Object:
    """Read an object; `told` are frames that are known already."""
    with path.open("rb") as file:
        elf = ELFFile(file)
        symbols = list_symbols(elf)
        functions = {  # by their section: each has one of its own
            s.section: s.name for s in symbols if s.kind == "STT_FUNC"
        }
        # a clone of a function, name.constprop.0, is told without its number
        frames = {
            name: told[known]
            for name in functions.values()
            for known in (name, name.rpartition(".")[0])
            if known in told
        }
        calls: dict[str, set[str]] = {name: set() for name in functions.values()}
        for section in elf.iter_sections():
            if not isinstance(section, RelocationSection):
                continue
            holder = elf.get_section(section["sh_info"])
            for relocation in section.iter_relocations():
                symbol = symbols[relocation["r_info_sym"]]
                if symbol.section == "SHN_UNDEF" and symbol.name:
                    function = symbol.name
                    frames[function] = HELPER_STACK_BYTES
                elif symbol.section in functions:
                    function = functions[symbol.section]
                else:
                    continue
                if holder.name.startswith(_STACK_SIZES):
                    frames[function] = _read_uleb(holder.data(), relocation["r_offset"] + 4)
                elif section["sh_info"] in functions and function != functions[section["sh_info"]]:
                    calls[functions[section["sh_info"]]].add(function)
        # An assembly function tells its frame by a symbol of its own.
        for symbol in symbols:
            if symbol.name.startswith(_ASSEMBLY_STACK):
                frames[symbol.name.removeprefix(_ASSEMBLY_STACK)] = symbol.value
        return _Object(
            flash=sum(s["sh_size"] for s in elf.iter_sections() if s.name.startswith(_IN_FLASH)),
            layer_flash=sum(
                s["sh_size"]
                for s in elf.iter_sections()
                if s.name.startswith(_IN_FLASH) and _LAYER_SECTION.search(s.name)
            ),
            sizes={s.name: s.size for s in symbols if s.kind == "STT_OBJECT"},
            frames=frames,
            calls=calls,
            helpers=tuple(sorted(set(frames) - set(calls))),
        )


def _read_uleb(data: bytes, offset: int) -> int:
    """Return the unsigned LEB128 number at `offset`."""
    value, shift = 0, 0
    while True:
        byte = data[offset]
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
        offset, shift = offset + 1, shift + 7
