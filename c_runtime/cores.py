"""The cores that a model is built for and run on, and the compilers that make code for them."""

import importlib.util
import shutil
import sys
from dataclasses import dataclass

from zerodrift.base.errors import InputError, nearest
from zerodrift.base.plugins import CORES as GROUP
from zerodrift.base.plugins import load_parts
from zerodrift.c_runtime.compilers import Compiler

_OMIT = "-fomit-frame-pointer"
"""zig keeps a frame pointer unless it is told not to; gcc and plain clang do not."""

CORES: dict[str, tuple[str, ...]] = {
    "cortex-m0plus": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m0plus", _OMIT),
    "cortex-m3": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m3", _OMIT),
    "cortex-m4": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m4", _OMIT),
    "cortex-m7": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m7", _OMIT),
    # +dsp: the optional extension, which nearly every Cortex-M33 has
    "cortex-m33": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m33+dsp", _OMIT),
    "rv32imc": ("-target", "riscv32-freestanding", "-mcpu=generic_rv32+m+c", _OMIT),
}
"""Core -> what makes the clang of the ziglang wheel build for it."""

GCC_CORES: dict[str, tuple[str, ...]] = {
    "cortex-m0plus": ("-mcpu=cortex-m0plus", "-mthumb"),
    "cortex-m3": ("-mcpu=cortex-m3", "-mthumb"),
    "cortex-m4": ("-mcpu=cortex-m4", "-mthumb"),
    "cortex-m7": ("-mcpu=cortex-m7", "-mthumb"),
    "cortex-m33": ("-mcpu=cortex-m33+nofp", "-mthumb"),
    "cortex-m55": ("-mcpu=cortex-m55", "-mthumb", "-mfloat-abi=hard"),
    "rv32imc": ("-march=rv32imc", "-mabi=ilp32", "-mno-relax"),
}
"""Core -> what makes the GNU cross-compiler build for it. Only it makes MVE for the M55 here."""


@dataclass(frozen=True)
class Core:
    """A core; an installed package may add its own."""

    name: str
    """For `[firmware] core`."""
    clang: tuple[str, ...] = ()
    """What makes the clang of the ziglang wheel build for it; empty: it cannot."""
    gcc: tuple[str, ...] = ()
    """What makes a GNU cross-compiler build for it; empty: none does."""
    triple: str = "arm-none-eabi"
    """Of that compiler: its name without `-gcc`."""
    emulated_as: str = ""
    """The one of `CORES` as which unicorn runs it; empty: `verify` leaves it out."""


def list_cores() -> dict[str, Core]:
    """Return name -> core: zerodrift's own, and those of installed packages."""
    own = {
        name: Core(
            name,
            CORES.get(name, ()),
            GCC_CORES.get(name, ()),
            "riscv64-unknown-elf" if name.startswith("rv") else "arm-none-eabi",
            name if name in CORES else "",
        )
        for name in {**CORES, **GCC_CORES}
    }
    return own | {each.name: each for each in load_parts(GROUP, Core) if each.name not in own}


def list_emulated() -> tuple[str, ...]:
    """Return the cores that unicorn runs, by name."""
    return tuple(name for name, core in list_cores().items() if core.emulated_as)


MEMORY = """\
void *memset(void *to, int value, size_t n);
void *memcpy(void *to, const void *from, size_t n);
void *memset(void *to, int value, size_t n) {
    volatile uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) { bytes[i] = (uint8_t)value; }
    return to;
}
void *memcpy(void *to, const void *from, size_t n) {
    volatile uint8_t *bytes = to;
    for (size_t i = 0; i < n; i++) { bytes[i] = ((const uint8_t *)from)[i]; }
    return to;
}
"""
"""What a compiler may call where there is no C library."""


def find_cross_compilers(core: str) -> list[Compiler]:
    """Return the compilers for a core that are installed, the ziglang wheel first.

    Args:
        core: one of `list_cores`.

    Raises:
        InputError: the core is unknown.
    """
    known = list_cores()
    if core not in known:
        raise InputError(
            f"core '{core}' is unknown{nearest(core, known)}; known are {', '.join(known)}"
        )
    part = known[core]
    found: list[Compiler] = []
    if part.clang and importlib.util.find_spec("ziglang"):
        found.append(Compiler("zig", (sys.executable, "-m", "ziglang", "cc", *part.clang)))
    path = shutil.which(f"{part.triple}-gcc")
    if part.gcc and path:
        found.append(Compiler("gcc", (path, *part.gcc)))
    return found
