"""A generated model on an emulated chip: cross-compiled, and run by unicorn."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeVar, cast

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
    unicorn,
)
from unicorn import unicorn as wheel
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M0,
    UC_CPU_ARM_CORTEX_M3,
    UC_CPU_ARM_CORTEX_M4,
    UC_CPU_ARM_CORTEX_M7,
    UC_CPU_ARM_CORTEX_M33,
)
from unicorn.riscv_const import (
    UC_RISCV_REG_A0,
    UC_RISCV_REG_PC,
    UC_RISCV_REG_RA,
    UC_RISCV_REG_SP,
)

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.cores import MEMORY, find_cross_compilers, list_cores
from zerodrift.c_runtime.footprint import is_constant, list_symbols
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.layer_norm import IntegerLayerNorm
from zerodrift.operations.lstm import IntegerLstmLayer

# An emulated core and its memory: unicorn, as far as it is used here.

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
    """Return a core without memory: one of `cores.list_emulated`."""
    core = list_cores()[core].emulated_as
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


# A generated model on an emulated chip: cross-compiled, and run by unicorn.

Number = TypeVar("Number", np.int32, np.uint32, np.int64)
_BATCH = 256  # steps per call into the chip, at most
_ROOM = 65_536  # numbers of the states after the steps of one call
_LONGEST_US = 120_000_000  # of one call, by the host's clock
_STACK, _STACK_BYTES, _STOP = 0x8000_0000, 0x8000, 0x9000_0000
_UNTOUCHED = 0xA5
_MAIN = """
#define ZD_PLAIN
#include "{prefix}_harness.c"
#include "zd_runtime.c"
{memory}{prefix}_state_t chip_state;
{prefix}_input_t chip_input;
{code_type} chip_codes[{batch} * {columns}];
int32_t chip_drift[{batch} * {outputs}];
uint32_t chip_flags[{batch}];
void chip_start(int settled) {{ zd_start(&chip_state, chip_codes, settled); }}
void chip_run(uint32_t steps) {{
    zd_run(&chip_state, chip_codes, steps, chip_drift, chip_flags, NULL);
}}
int64_t chip_states[{batch} * {width}];
void chip_trace(uint32_t steps) {{
    for (uint32_t t = 0; t < steps; t++) {{
        zd_run(&chip_state, &chip_codes[t * {columns}u], 1u, &chip_drift[t * {outputs}u],
               &chip_flags[t], NULL);
        (void)zd_pack(&chip_state, &chip_states[t * {width}u]);
    }}
}}
void chip_step(void) {{ (void){prefix}_step(&chip_state{block}, &chip_input, chip_drift); }}
void chip_settle(void) {{ {prefix}_settle(&chip_state{block}, &chip_input); }}
uint32_t chip_selftest(void) {{ return zd_selftest(); }}
uint8_t chip_saved[{PREFIX}_SAVED_BYTES];
void chip_save(void) {{ {prefix}_save(&chip_state, chip_saved); }}
uint32_t chip_restore(void) {{ return {prefix}_restore(&chip_state{block}, chip_saved); }}
void chip_tare(void) {{ {tare} }}
{layer}
{norm}
void _start(void) {{
    chip_norm();
    chip_tare();
    chip_start(0);
    chip_layer();
    chip_save();
    chip_run(chip_selftest() + chip_restore());
    chip_trace(1);
    chip_settle();
    chip_step();
}}
"""
_LAYER = """int16_t chip_features[{inputs}];
int32_t chip_h_q30[{hidden}];
void chip_layer(void) {{ {name}_step({block}chip_features, chip_h_q30, -1); }}
"""
_STACK_OF_LAYERS = """int16_t chip_features[{inputs}];
int32_t chip_lower_q30[{lower}];
int32_t chip_h_q30[{hidden}];
void chip_layer(void) {{ {name}_step(chip_features, chip_lower_q30, chip_h_q30); }}
"""
_LSTM = """int16_t chip_features[{inputs}];
int32_t chip_h_q30[{units}];
int32_t chip_cell[{units}];
void chip_layer(void) {{ {name}_step(chip_features, chip_h_q30, chip_cell, 0u); }}
"""
_NORM = """int16_t chip_copies[{width}];
int32_t chip_normalised[{width}];
void chip_norm(void) {{ zd_layer_norm(&{name}_p, chip_copies, chip_normalised, {width}u); }}
"""


class EmulatedModel:
    """A generated model that runs on an emulated core.

    Args:
        model: the integer model, for its shapes.
        code: its C.
        core: one of `cores.list_emulated`.
        folder: where sources and program are written.
        flags: of the compiler, "-O2" by default.
        compiler: for the core; the preferred one if None.

    Raises:
        InputError: there is no compiler for the core, or the core is unknown.
        CheckError: the C does not compile.
    """

    def __init__(
        self,
        model: IntegerModel,
        code: GeneratedCode,
        core: str,
        folder: Path,
        flags: tuple[str, ...] = ("-O2",),
        compiler: Compiler | None = None,
    ) -> None:
        self._outputs = len(model.outputs)
        self._width = _count_state(model)
        self._batch = _choose_batch(self._width)
        self._code_type = np.dtype(model.code_type).newbyteorder("<")
        fields = [
            (f"c{k}", np.dtype(c.raw_type).newbyteorder("<")) for k, c in enumerate(model.channels)
        ]
        self._input_type = np.dtype(fields, align=True)  # as the compilers lay the struct out
        program = _build(model, code, folder, flags, compiler or _find(core))
        self._arm = list_cores()[core].emulated_as in ARM_CPUS
        self._chip = make_chip(core)
        with program.open("rb") as file:
            image = ELFFile(file)
            load_program(self._chip, image)
            symbols = list_symbols(image)
            self._symbols = {s.name: s.value for s in symbols}
            objects = [s for s in symbols if s.kind == "STT_OBJECT"]
            self._objects = {s.name: s.size for s in objects}
            self._constants = {s.name for s in objects if is_constant(image, s)}
        self._chip.mem_map(_STACK, _STACK_BYTES)
        self._chip.mem_map(_STOP, PAGE)

    def run(
        self, codes: CodeArray, *, settled: bool = True, restart: bool = True
    ) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
        """Return drift [T, K] and flags [T] for codes [T, C].

        Args:
            codes: raw input codes.
            settled: start from `settle` rather than `init`.
            restart: False goes on from the last call.
        """
        drift, flags = [], []
        if restart:
            self._write("chip_codes", codes[:1])
            self._call("chip_start", int(settled))
        for first in range(0, len(codes), self._batch):
            part = codes[first : first + self._batch]
            self._write("chip_codes", part)
            self._call("chip_run", len(part))
            drift.append(self._read("chip_drift", np.int32, len(part) * self._outputs))
            flags.append(self._read("chip_flags", np.uint32, len(part)))
        return np.concatenate(drift).reshape(len(codes), -1), np.concatenate(flags)

    def trace(
        self, codes: CodeArray, *, settled: bool = True
    ) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.int64]]:
        """Return drift [T, K], flags [T] and the state after each step [T, n], as packed.

        Args:
            codes: raw input codes.
            settled: start from `settle` rather than `init`.
        """
        parts = []
        self._write("chip_codes", codes[:1])
        self._call("chip_start", int(settled))
        for first in range(0, len(codes), self._batch):
            part = codes[first : first + self._batch]
            self._write("chip_codes", part)
            self._call("chip_trace", len(part))
            steps = len(part)
            drift = self._read("chip_drift", np.int32, steps * self._outputs)
            flags = self._read("chip_flags", np.uint32, steps)
            states = self._read("chip_states", np.int64, steps * self._width)
            parts.append((drift.reshape(steps, -1), flags, states.reshape(steps, -1)))
        return (
            np.concatenate([drift for drift, _, _ in parts]),
            np.concatenate([flags for _, flags, _ in parts]),
            np.concatenate([states for _, _, states in parts]),
        )

    def selftest(self) -> int:
        """Return what the model's own self-test returns on this chip."""
        return self._call("chip_selftest")

    def tare(self) -> None:
        """Count the drift from the last answer on, where the model can."""
        self._call("chip_tare")

    def save(self) -> bytes:
        """Return the copy of the state that the model's own save makes on this chip."""
        self._call("chip_save")
        return self.read_memory("chip_saved")

    def restore(self, saved: bytes) -> int:
        """Take over a copy of the state; return what the C returns, 0 = accepted."""
        if len(saved) != self._objects["chip_saved"]:
            raise ValueError(f"{len(saved)} bytes, not {self._objects['chip_saved']}")
        self._chip.mem_write(self._symbols["chip_saved"], saved)
        return self._call("chip_restore")

    @property
    def arrays(self) -> dict[str, int]:
        """Name -> bytes of the model's and the runtime's constants, which lie in the flash."""
        return {name: size for name, size in self._objects.items() if name in self._constants}

    def read_memory(self, symbol: str) -> bytes:
        """Return the bytes of a constant or variable."""
        return bytes(self._chip.mem_read(self._symbols[symbol], self._objects[symbol]))

    def write_memory(self, symbol: str, content: bytes) -> None:
        """Overwrite the bytes of a constant or variable."""
        self._chip.mem_write(self._symbols[symbol], content)

    def flip_bit(self, symbol: str, bit: int) -> None:
        """Damage a constant or variable, as a failing memory does."""
        at = self._symbols[symbol] + bit // 8
        self._chip.mem_write(at, bytes([self._chip.mem_read(at, 1)[0] ^ 1 << bit % 8]))

    def count_instructions(self, codes: CodeArray) -> list[int]:
        """Return the number of instructions of `step` for each of codes [T, C], from rest."""
        counts = []
        self._write_input(codes[0])
        self._call("chip_settle")
        for row in codes:
            self._write_input(row)
            counts.append(self._count("chip_step"))
        return counts

    def count_layer(
        self, features: NDArray[np.int16] | None = None, h_q30: NDArray[np.int32] | None = None
    ) -> int:
        """Return the number of instructions of the recurrent layer's step, call included.

        Args:
            features: [I] what the layer reads; as they are if None.
            h_q30: [H] state before the step; as it is if None.
        """
        self._write_layer(features, h_q30)
        return self._count("chip_layer")

    def count_norm(self, copies: NDArray[np.int16]) -> int:
        """Return the number of instructions of the first layer normalisation, call included.

        Args:
            copies: [M] int16 copies that it reads.
        """
        self._chip.mem_write(self._symbols["chip_copies"], copies.astype("<i2").tobytes())
        return self._count("chip_norm")

    def step_layer(
        self, features: NDArray[np.int16], h_q30: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """Return the state [H] that the recurrent layer's step makes of features [I], state [H]."""
        self._write_layer(features, h_q30)
        self._call("chip_layer")
        return self._read("chip_h_q30", np.int32, h_q30.size)

    def _write_layer(
        self, features: NDArray[np.int16] | None, h_q30: NDArray[np.int32] | None
    ) -> None:
        if features is not None:
            self._chip.mem_write(self._symbols["chip_features"], features.astype("<i2").tobytes())
        if h_q30 is not None:
            self._chip.mem_write(self._symbols["chip_h_q30"], h_q30.astype("<i4").tobytes())

    def _count(self, function: str) -> int:
        """Return the number of instructions of a call.

        Code that has been translated before the hook was set would not be counted.
        """
        total = [0]
        hook = self._chip.hook_add(UC_HOOK_CODE, lambda *_: total.__setitem__(0, total[0] + 1))
        self._chip.ctl_flush_tb()
        self._call(function)
        self._chip.hook_del(hook)
        self._chip.ctl_flush_tb()
        return total[0]

    def measure_stack(self, codes: CodeArray) -> int:
        """Return the bytes of stack that settle and steps over codes [T, C] really touched."""
        self._chip.mem_write(_STACK, bytes([_UNTOUCHED]) * _STACK_BYTES)
        self._write_input(codes[0])
        self._call("chip_settle")
        for row in codes:
            self._write_input(row)
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
        try:
            self._chip.emu_start(self._symbols[function] | self._arm, _STOP, timeout=_LONGEST_US)
        except unicorn.UcError as error:
            raise CheckError(f"{function} is stopped by the core: {error}") from error
        pc = UC_ARM_REG_PC if self._arm else UC_RISCV_REG_PC
        if int(self._chip.reg_read(pc)) & ~1 != _STOP:
            raise CheckError(f"{function} does not return within {_LONGEST_US // 10**6} s")
        return int(self._chip.reg_read(result))

    def _write(self, symbol: str, codes: CodeArray) -> None:
        self._chip.mem_write(self._symbols[symbol], codes.astype(self._code_type).tobytes())

    def _write_input(self, row: CodeArray) -> None:
        packed = np.zeros((), dtype=self._input_type)
        for name, code in zip(self._input_type.fields or (), row, strict=False):
            packed[name] = code
        self._chip.mem_write(self._symbols["chip_input"], packed.tobytes())

    def _read(self, symbol: str, kind: type[Number], count: int) -> NDArray[Number]:
        raw = self._chip.mem_read(self._symbols[symbol], np.dtype(kind).itemsize * count)
        return np.frombuffer(bytes(raw), dtype=np.dtype(kind).newbyteorder("<"))


def _count_state(model: IntegerModel) -> int:
    """Return how many numbers a packed state has."""
    codes = np.zeros((1, model.columns), dtype=np.int64)
    return int(Reference(model).start(codes, settled=False).pack().shape[1])


def _choose_batch(width: int) -> int:
    return max(1, min(_BATCH, _ROOM // width))


def _find(core: str) -> Compiler:
    compilers = find_cross_compilers(core)
    if not compilers:
        raise InputError(f"no compiler for {core}: `pip install ziglang`, or a GNU cross-compiler")
    return compilers[0]


def _build(
    model: IntegerModel,
    code: GeneratedCode,
    folder: Path,
    flags: tuple[str, ...],
    compiler: Compiler,
) -> Path:
    write_sources(code, folder)
    (folder / f"{code.prefix}_harness.c").write_text(code.harness, encoding="utf-8")
    main = folder / "zd_main.c"
    text = _MAIN.format(
        memory=MEMORY,
        prefix=code.prefix,
        PREFIX=code.prefix.upper(),
        batch=_choose_batch(_count_state(model)),
        width=_count_state(model),
        columns=model.columns,
        outputs=len(model.outputs),
        code_type=f"{np.dtype(model.code_type).name}_t",
        tare=f"{code.prefix}_tare(&chip_state);" if model.tare else "",
        layer=_render_layer(model, "zd_block, " if code.design is not None else ""),
        norm=_render_norm(model),
        block=", zd_block" if code.design is not None else "",
    )
    main.write_text(text, encoding="utf-8")
    # string.h, which the harness includes for the host, is missing without a C library
    (folder / "string.h").write_text("", encoding="utf-8")
    program = folder / "main.elf"
    free = ["-std=c99", *flags, "-g", "-ffreestanding", f"-I{folder}", str(main)]
    if compiler.name == "gcc":
        # relaxing would address data by a register that only a start-up sets
        free += ["-nostdlib", "-Wl,-Ttext=0x10000,-Tdata=0x100000,--no-relax", "-lgcc"]
    compiler.run([*free, "-o", str(program)])
    return program


def _render_norm(model: IntegerModel) -> str:
    """Return the C that calls the first layer normalisation alone."""
    for node in model.nodes:
        if isinstance(node, IntegerLayerNorm):
            return _NORM.format(name=node.name, width=node.width)
    return "void chip_norm(void) {}\n"


def _render_layer(model: IntegerModel, block: str) -> str:
    """Return the C that calls the first GRU or else LSTM alone, or all layers of its stack.

    `block` is the first argument of a layer whose numbers lie in a block.
    """
    layer = model.recurrent
    if layer is None:
        for lstm in model.recurrents:
            if isinstance(lstm, IntegerLstmLayer):
                inputs = lstm.layers[0].inputs
                return _LSTM.format(name=lstm.name, inputs=inputs, units=lstm.units)
        return "void chip_layer(void) {}\n"
    *lower, top = layer.layers
    return (_STACK_OF_LAYERS if lower else _LAYER).format(
        name=layer.name,
        inputs=layer.layers[0].inputs,
        lower=sum(below.hidden for below in lower),
        hidden=top.hidden,
        block=block,
    )
