"""An emulated core and its memory: unicorn, as far as it is used here."""

from collections.abc import Callable
from typing import Protocol, cast

from elftools.elf.elffile import ELFFile
from unicorn import UC_ARCH_ARM, UC_ARCH_RISCV, UC_MODE_MCLASS, UC_MODE_RISCV32, UC_MODE_THUMB
from unicorn import unicorn as wheel
from unicorn.arm_const import (
    UC_CPU_ARM_CORTEX_M0,
    UC_CPU_ARM_CORTEX_M3,
    UC_CPU_ARM_CORTEX_M4,
    UC_CPU_ARM_CORTEX_M7,
    UC_CPU_ARM_CORTEX_M33,
)

ARM_CPUS = {
    "cortex-m0plus": UC_CPU_ARM_CORTEX_M0,
    "cortex-m3": UC_CPU_ARM_CORTEX_M3,
    "cortex-m4": UC_CPU_ARM_CORTEX_M4,
    "cortex-m7": UC_CPU_ARM_CORTEX_M7,
    "cortex-m33": UC_CPU_ARM_CORTEX_M33,
}
PAGE = 4096
"""Bytes that are mapped at once."""


class EmulatedCore(Protocol):
    """A core with memory. Addresses and sizes in bytes; registers by unicorn's numbers."""

    def mem_map(self, address: int, size: int, /) -> None:
        """Give the core memory."""

    def mem_write(self, address: int, data: bytes, /) -> None:
        """Write to memory."""

    def mem_read(self, address: int, size: int, /) -> bytearray:
        """Read from memory."""
        ...

    def reg_write(self, register: int, value: int, /) -> None:
        """Write a register."""

    def reg_read(self, register: int, /) -> int:
        """Read a register."""
        ...

    def emu_start(self, begin: int, until: int, /, timeout: int) -> None:
        """Run from an address until another one, or for `timeout` us."""

    def hook_add(self, kind: int, callback: Callable[..., object], /) -> int:
        """Have a function called while the core runs."""
        ...

    def hook_del(self, hook: int, /) -> None:
        """Take such a function away."""

    def ctl_set_cpu_model(self, model: int, /) -> None:
        """Choose the core."""

    def ctl_flush_tb(self) -> None:
        """Forget what was translated."""


def make_chip(core: str) -> EmulatedCore:
    """Return a core without memory: one of `ARM_CPUS`, or else of RISC-V with 32 bits."""
    make = cast(
        Callable[[int, int], EmulatedCore], wheel.Uc
    )  # whose own types lack some of its methods
    if core not in ARM_CPUS:
        return make(UC_ARCH_RISCV, UC_MODE_RISCV32)
    chip = make(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
    chip.ctl_set_cpu_model(ARM_CPUS[core])
    return chip


def load_program(chip: EmulatedCore, image: ELFFile) -> None:
    """Map and fill the program's segments, page by page."""
    mapped: set[int] = set()
    for segment in image.iter_segments():
        if segment["p_type"] != "PT_LOAD" or not segment["p_memsz"]:
            continue
        first, end = segment["p_vaddr"], segment["p_vaddr"] + segment["p_memsz"]
        for page in range(first // PAGE, -(-end // PAGE)):
            if page not in mapped:
                chip.mem_map(page * PAGE, PAGE)
                mapped.add(page)
        chip.mem_write(first, segment.data())
