"""A generated model as a bare-metal program under QEMU, built by a GNU cross-compiler.

An independent check beside unicorn: another compiler, whole boards with their memory maps, and the
only emulation of the vector extension of the Cortex-M55. Input and output are files, by
semihosting.
"""

import shutil
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.lstm import IntegerLstmLayer

SUPPORT = Path(__file__).parent / "bare_metal"
LONGEST_RUN_S = 500
_SCRIPT = """ENTRY(reset)
MEMORY {{
  code : ORIGIN = {code:#x}, LENGTH = 512K
  data : ORIGIN = {data:#x}, LENGTH = 256K
}}
SECTIONS {{
  .text : {{ KEEP(*(.vectors)) *(.text*) *(.rodata*) *(.srodata*) }} > code
  .data : {{ *(.data*) *(.sdata*) }} > data
  .bss (NOLOAD) : {{ *(.bss*) *(.sbss*) *(COMMON) }} > data
  stack_top = ORIGIN(data) + LENGTH(data);
}}
"""


@dataclass(frozen=True)
class QemuMachine:
    """A board that QEMU emulates."""

    program: str
    """The emulator."""
    arguments: tuple[str, ...]
    code_at: int
    """Where the program lies, its vector table first."""
    data_at: int


MACHINES: dict[str, QemuMachine] = {
    "cortex-m3": QemuMachine("qemu-system-arm", ("-M", "mps2-an385"), 0x0, 0x2000_0000),
    "cortex-m4": QemuMachine("qemu-system-arm", ("-M", "mps2-an386"), 0x0, 0x2000_0000),
    "cortex-m7": QemuMachine("qemu-system-arm", ("-M", "mps2-an500"), 0x0, 0x2000_0000),
    "cortex-m33": QemuMachine("qemu-system-arm", ("-M", "mps2-an505"), 0x1000_0000, 0x3800_0000),
    "cortex-m55": QemuMachine("qemu-system-arm", ("-M", "mps3-an547"), 0x0, 0x2000_0000),
    "rv32imc": QemuMachine(
        "qemu-system-riscv32", ("-M", "virt", "-bios", "none"), 0x8000_0000, 0x8010_0000
    ),
}
"""Core -> the board that has it. QEMU has none with a Cortex-M0+."""


def _describe_layer(model: IntegerModel) -> list[str]:
    """Return what `run.c` has to know of the layer whose instructions it counts."""
    gru = model.recurrent
    if gru is not None and len(gru.layers) == 1:
        step = "STEP(x, h, c)=((void)(c),{}_step(x, h, -1))"
        name, inputs, hidden = gru.name, gru.gru.inputs, gru.gru.hidden
    else:
        lstm = next((n for n in model.recurrents if isinstance(n, IntegerLstmLayer)), None)
        if gru is not None or lstm is None:  # of a stack of GRUs nothing is counted
            return []
        step = "STEP(x, h, c)={}_step(x, h, c, 0u)"
        name, inputs, hidden = lstm.name, lstm.layers[0].inputs, lstm.units
    return [f"-DLAYER_{step.format(name)}", f"-DINPUTS={inputs}", f"-DHIDDEN={hidden}"]


@dataclass(frozen=True)
class QemuRun:
    """What the program wrote."""

    drift: NDArray[np.int32]  # [T, K]
    flags: NDArray[np.uint32]  # [T]
    selftest: int
    """0 = passed."""
    layer_instructions: float
    """Of one step of the recurrent layer, call and return included; by QEMU's own clock, in which
    an instruction takes a nanosecond. Exact to about 0.1."""


def is_available(core: str) -> bool:
    """Tell whether the board's emulator and a GNU cross-compiler for the core are installed."""
    if core not in MACHINES:
        return False
    compilers = [c for c in find_cross_compilers(core) if c.name == "gcc"]
    return bool(compilers) and shutil.which(MACHINES[core].program) is not None


class QemuModel:
    """A model built for a board.

    Args:
        model: the integer model, for its shapes.
        code: its C.
        core: one of `MACHINES`.
        folder: where sources, program, input and output lie.
        flags: of the compiler.
        libraries: to link, as "-lm" for code under comparison; the model needs none.

    Raises:
        InputError: emulator or compiler are missing; says how to get them.
        CheckError: the C does not compile.
    """

    def __init__(
        self,
        model: IntegerModel,
        code: GeneratedCode,
        core: str,
        folder: Path,
        flags: tuple[str, ...] = ("-O2",),
        libraries: tuple[str, ...] = (),
    ) -> None:
        self._libraries = libraries
        if not is_available(core):
            raise InputError(f"QEMU for {core} is not installed: `make setup-qemu`")
        self._machine = MACHINES[core]
        self._folder = folder
        self._outputs = len(model.outputs)
        self._code_type = np.dtype(model.code_type).newbyteorder("<")
        compiler = next(c for c in find_cross_compilers(core) if c.name == "gcc")
        self.program = self._build(model, code, compiler, flags)

    def run(self, codes: CodeArray, *, settled: bool = True) -> QemuRun:
        """Run over codes [T, C] from `settle` or `init` at codes[0].

        Raises:
            CheckError: the program did not come to its end; tells what QEMU said.
        """
        steps = len(codes)
        head = struct.pack("<II", int(settled), steps)
        (self._folder / "in.bin").write_bytes(head + codes.astype(self._code_type).tobytes())
        result = self._folder / "out.bin"
        result.unlink(missing_ok=True)
        command = [self._machine.program, *self._machine.arguments]
        command += ["-kernel", str(self.program.name), "-nographic", "-monitor", "none"]
        command += ["-serial", "none", "-icount", "shift=0"]
        command += ["-semihosting-config", "enable=on,target=native"]
        done = subprocess.run(
            command, cwd=self._folder, capture_output=True, text=True, check=False,
            timeout=LONGEST_RUN_S,
        )  # fmt: skip
        raw = result.read_bytes() if result.exists() else b""
        expected = 4 * (self._outputs + 1) * steps + 12
        if done.returncode != 0 or len(raw) != expected:
            raise CheckError(
                f"QEMU ended with exit code {done.returncode} and {len(raw)} of {expected} bytes:"
                f" {done.stderr[-1000:]}"
            )
        words = np.frombuffer(raw[:-12], dtype="<u4").reshape(steps, self._outputs + 1)
        selftest, ticks, per_million = struct.unpack("<III", raw[-12:])
        return QemuRun(
            drift=words[:, :-1].astype(np.int32),
            flags=words[:, -1].copy(),
            selftest=selftest,
            layer_instructions=ticks / per_million * 1e6 / 1000.0 if per_million else 0.0,
        )

    def _build(
        self,
        model: IntegerModel,
        code: GeneratedCode,
        compiler: Compiler,
        flags: tuple[str, ...],
    ) -> Path:
        folder = self._folder
        write_sources(code, folder)
        (folder / f"{code.prefix}_harness.c").write_text(code.harness, encoding="utf-8")
        (folder / "string.h").write_text("", encoding="utf-8")
        shape = [f"-DCHANNELS={model.columns}", f"-DOUTPUTS={self._outputs}"]
        shape += [f"-DCODE={np.dtype(model.code_type).name}_t"]
        shape += [f'-DHARNESS="{code.prefix}_harness.c"', "-DZD_PLAIN"]
        shape += _describe_layer(model)
        script = folder / "link.ld"
        script.write_text(
            _SCRIPT.format(code=self._machine.code_at, data=self._machine.data_at),
            encoding="utf-8",
        )
        program = folder / "program.elf"
        free = ["-std=c99", *flags, "-g", "-ffreestanding", "-nostdlib"]
        free += ["-fno-tree-loop-distribute-patterns", f"-I{folder}", *shape]
        linked = ["-T", str(script), "-Wl,--no-relax", *self._libraries, "-lgcc"]
        compiler.run([*free, str(SUPPORT / "run.c"), *linked, "-o", str(program)])
        return program
