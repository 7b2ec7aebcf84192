"""A generated model on an emulated chip: cross-compiled by zig, run by unicorn."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray
from unicorn import (
    UC_ARCH_ARM,
    UC_ARCH_RISCV,
    UC_HOOK_CODE,
    UC_MODE_MCLASS,
    UC_MODE_RISCV32,
    UC_MODE_THUMB,
    Uc,
)
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_R0,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M0,
    UC_CPU_ARM_CORTEX_M3,
    UC_CPU_ARM_CORTEX_M4,
    UC_CPU_ARM_CORTEX_M33,
)
from unicorn.riscv_const import UC_RISCV_REG_A0, UC_RISCV_REG_RA, UC_RISCV_REG_SP

from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.footprint import CORES
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray

_ARM_CPUS = {
    "cortex-m0plus": UC_CPU_ARM_CORTEX_M0,
    "cortex-m3": UC_CPU_ARM_CORTEX_M3,
    "cortex-m4": UC_CPU_ARM_CORTEX_M4,
    "cortex-m33": UC_CPU_ARM_CORTEX_M33,
}
_BATCH = 256  # steps per call into the chip
_PAGE = 4096
_STACK, _STACK_BYTES, _STOP = 0x8000_0000, 0x8000, 0x9000_0000
_UNTOUCHED = 0xA5
_MAIN = """
#define ZD_PLAIN
#include "{prefix}_harness.c"
#include "zd_runtime.c"
{prefix}_state_t chip_state;
{prefix}_input_t chip_input;
{code_type} chip_codes[{batch} * {channels}];
int32_t chip_drift[{batch} * {outputs}];
uint32_t chip_flags[{batch}];
void chip_start(int settled) {{ zd_start(&chip_state, chip_codes, settled); }}
void chip_run(uint32_t steps) {{
    zd_run(&chip_state, chip_codes, steps, chip_drift, chip_flags, NULL);
}}
void chip_step(void) {{ (void){prefix}_step(&chip_state, &chip_input, chip_drift); }}
void chip_settle(void) {{ {prefix}_settle(&chip_state, &chip_input); }}
uint32_t chip_selftest(void) {{ return {prefix}_selftest(); }}
void _start(void) {{
    chip_start(0);
    chip_run(chip_selftest());
    chip_settle();
    chip_step();
}}
"""


class EmulatedModel:
    """A generated model that runs on an emulated core.

    Args:
        model: the integer model, for its shapes.
        code: its C.
        core: one of `CORES`.
        folder: where sources and program are written.
        optimise: as "-O2".
    """

    def __init__(
        self, model: IntegerModel, code: GeneratedCode, core: str, folder: Path, optimise: str
    ) -> None:
        self._outputs = len(model.outputs)
        self._code_type = np.dtype(model.code_type).newbyteorder("<")
        program = _build(model, code, core, folder, optimise)
        self._arm = core in _ARM_CPUS
        self._chip = _make_chip(core)
        with program.open("rb") as file:
            image = ELFFile(file)
            _load(self._chip, image)
            table: Any = image.get_section_by_name(".symtab")
            self._symbols = {s.name: int(s["st_value"]) for s in table.iter_symbols()}
        self._chip.mem_map(_STACK, _STACK_BYTES)
        self._chip.mem_map(_STOP, _PAGE)

    def run(
        self, codes: CodeArray, *, settled: bool
    ) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
        """Return drift [T, K] and flags [T] for codes [T, C]."""
        drift, flags = [], []
        self._write("chip_codes", codes[:1])
        self._call("chip_start", int(settled))
        for first in range(0, len(codes), _BATCH):
            part = codes[first : first + _BATCH]
            self._write("chip_codes", part)
            self._call("chip_run", len(part))
            drift.append(self._read("chip_drift", "<i4", len(part) * self._outputs))
            flags.append(self._read("chip_flags", "<u4", len(part)))
        return np.concatenate(drift).reshape(len(codes), -1), np.concatenate(flags)

    def selftest(self) -> int:
        """Return what the model's own self-test returns on this chip."""
        return self._call("chip_selftest")

    def count_instructions(self, codes: CodeArray) -> list[int]:
        """Return the number of instructions of `step` for each of codes [T, C], from rest."""
        counts = []
        total = [0]
        hook = self._chip.hook_add(UC_HOOK_CODE, lambda *_: total.__setitem__(0, total[0] + 1))
        self._write("chip_input", codes[0])
        self._call("chip_settle")
        for row in codes:
            self._write("chip_input", row)
            total[0] = 0
            self._call("chip_step")
            counts.append(total[0])
        self._chip.hook_del(hook)
        return counts

    def measure_stack(self, codes: CodeArray) -> int:
        """Return the bytes of stack that settle and steps over codes [T, C] really touched."""
        self._chip.mem_write(_STACK, bytes([_UNTOUCHED]) * _STACK_BYTES)
        self._write("chip_input", codes[0])
        self._call("chip_settle")
        for row in codes:
            self._write("chip_input", row)
            self._call("chip_step")
        stack = np.frombuffer(bytes(self._chip.mem_read(_STACK, _STACK_BYTES)), dtype=np.uint8)
        return _STACK_BYTES - int((stack != _UNTOUCHED).argmax())

    def _call(self, function: str, argument: int = 0) -> int:
        """Call a function of the program and return its result."""
        result, link, stack = (
            (UC_ARM_REG_R0, UC_ARM_REG_LR, UC_ARM_REG_SP)
            if self._arm
            else (UC_RISCV_REG_A0, UC_RISCV_REG_RA, UC_RISCV_REG_SP)
        )
        self._chip.reg_write(result, argument)
        self._chip.reg_write(stack, _STACK + _STACK_BYTES)
        self._chip.reg_write(link, _STOP | self._arm)
        self._chip.emu_start(self._symbols[function] | self._arm, _STOP)
        return int(self._chip.reg_read(result))

    def _write(self, symbol: str, codes: CodeArray) -> None:
        self._chip.mem_write(self._symbols[symbol], codes.astype(self._code_type).tobytes())

    def _read(self, symbol: str, kind: str, count: int) -> NDArray[Any]:
        raw = self._chip.mem_read(self._symbols[symbol], 4 * count)
        return np.frombuffer(bytes(raw), dtype=kind)


def _build(
    model: IntegerModel, code: GeneratedCode, core: str, folder: Path, optimise: str
) -> Path:
    write_sources(code, folder)
    (folder / f"{code.prefix}_harness.c").write_text(code.harness, encoding="utf-8")
    main = folder / "main.c"
    sizes = {"batch": _BATCH, "channels": len(model.channels), "outputs": len(model.outputs)}
    types = {"code_type": f"{np.dtype(model.code_type).name}_t"}
    main.write_text(_MAIN.format(prefix=code.prefix, **sizes, **types), encoding="utf-8")
    # string.h, which the harness names for the host's sake, is not there without a C library
    (folder / "string.h").write_text("", encoding="utf-8")
    compiler = Compiler("zig", (sys.executable, "-m", "ziglang", "cc", *CORES[core]))
    program = folder / "main.elf"
    compiler.run(
        ["-std=c99", optimise, "-g", "-ffreestanding", f"-I{folder}", str(main), "-o", str(program)]
    )
    return program


def _make_chip(core: str) -> Uc:
    if core not in _ARM_CPUS:
        return Uc(UC_ARCH_RISCV, UC_MODE_RISCV32)
    chip = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
    chip.ctl_set_cpu_model(_ARM_CPUS[core])
    return chip


def _load(chip: Uc, image: ELFFile) -> None:
    """Map and fill the program's segments, page by page."""
    mapped: set[int] = set()
    for segment in image.iter_segments():
        if segment["p_type"] != "PT_LOAD" or not segment["p_memsz"]:
            continue
        first, end = segment["p_vaddr"], segment["p_vaddr"] + segment["p_memsz"]
        for page in range(first // _PAGE, -(-end // _PAGE)):
            if page not in mapped:
                chip.mem_map(page * _PAGE, _PAGE)
                mapped.add(page)
        chip.mem_write(first, segment.data())
