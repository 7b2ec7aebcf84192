"""The cores that a model is built for and run on, and the compilers that make code for them."""

import importlib.util
import shutil
import sys

from zerodrift.base.errors import InputError, nearest
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
        core: one of `CORES` or `GCC_CORES`.

    Raises:
        InputError: the core is unknown.
    """
    known = {**CORES, **GCC_CORES}
    if core not in known:
        raise InputError(
            f"core '{core}' is unknown{nearest(core, known)}; known are {', '.join(known)}"
        )
    found: list[Compiler] = []
    if core in CORES and importlib.util.find_spec("ziglang"):
        found.append(Compiler("zig", (sys.executable, "-m", "ziglang", "cc", *CORES[core])))
    triple = "riscv64-unknown-elf" if core.startswith("rv") else "arm-none-eabi"
    path = shutil.which(f"{triple}-gcc")
    if core in GCC_CORES and path:
        found.append(Compiler("gcc", (path, *GCC_CORES[core])))
    return found
