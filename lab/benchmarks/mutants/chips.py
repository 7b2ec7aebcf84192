"""A judge on an emulated core: built by the clang of the ziglang wheel, run by unicorn."""

import importlib.util
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile
from unicorn import (
    UC_ARCH_ARM,
    UC_ARCH_RISCV,
    UC_MODE_MCLASS,
    UC_MODE_RISCV32,
    UC_MODE_THUMB,
    unicorn,
)
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M0,
    UC_CPU_ARM_CORTEX_M3,
    UC_CPU_ARM_CORTEX_M4,
)
from unicorn.riscv_const import UC_RISCV_REG_PC, UC_RISCV_REG_RA, UC_RISCV_REG_SP

from zerodrift.c_runtime.cores import CORES

_CPUS = {
    "cortex-m0plus": UC_CPU_ARM_CORTEX_M0,
    "cortex-m3": UC_CPU_ARM_CORTEX_M3,
    "cortex-m4": UC_CPU_ARM_CORTEX_M4,
}
_STACK, _STACK_BYTES, _STOP, _PAGE = 0x8000_0000, 0x8000, 0x9000_0000, 4096
_MICROSECONDS = 60_000_000


class CrashError(Exception):
    """The core left its memory, met no instruction, or did not end."""


@dataclass(frozen=True)
class Chip:
    """A core."""

    core: str

    @cached_property
    def command(self) -> list[str]:
        """What compiles for it."""
        spec = importlib.util.find_spec("ziglang")
        assert spec and spec.origin, "no ziglang wheel"
        zig = Path(spec.origin).parent / "zig"
        free = ("-std=gnu99", "-w", "-g", "-ffreestanding", "-DZD_CHIP", "-fno-sanitize=all")
        return [str(zig), "cc", *CORES[self.core], *free]


def run_on_chip(program: Path, chip: Chip, phases: int) -> tuple[str, ...]:
    """Return the hashes that the judge leaves in its memory.

    Raises:
        CrashError: it does not come to its end.
    """
    arm = chip.core in _CPUS
    machine: Any = unicorn.Uc
    if arm:
        core = machine(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        core.ctl_set_cpu_model(_CPUS[chip.core])
    else:
        core = machine(UC_ARCH_RISCV, UC_MODE_RISCV32)
    with program.open("rb") as file:
        image: Any = ELFFile(file)
        symbols = {
            s.name: int(s["st_value"]) for s in image.get_section_by_name(".symtab").iter_symbols()
        }
        mapped: set[int] = set()
        for segment in image.iter_segments():
            if segment["p_type"] == "PT_LOAD" and segment["p_memsz"]:
                end = segment["p_vaddr"] + segment["p_memsz"]
                for page in range(segment["p_vaddr"] // _PAGE, -(-end // _PAGE)):
                    if page not in mapped:
                        core.mem_map(page * _PAGE, _PAGE)
                        mapped.add(page)
                core.mem_write(segment["p_vaddr"], segment.data())
    core.mem_map(_STACK, _STACK_BYTES)
    core.mem_map(_STOP, _PAGE)
    core.reg_write(UC_ARM_REG_SP if arm else UC_RISCV_REG_SP, _STACK + _STACK_BYTES)
    core.reg_write(UC_ARM_REG_LR if arm else UC_RISCV_REG_RA, _STOP | arm)
    try:
        core.emu_start(symbols["judge"] | arm, _STOP, timeout=_MICROSECONDS)
    except unicorn.UcError as error:
        raise CrashError(str(error)) from error
    ended = core.reg_read(UC_ARM_REG_PC if arm else UC_RISCV_REG_PC)
    if ended & ~1 != _STOP:
        raise CrashError("does not end")
    words = bytes(core.mem_read(symbols["judged"], 8 * phases))
    return tuple(words[8 * k : 8 * k + 8][::-1].hex() for k in range(phases))
