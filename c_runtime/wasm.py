"""A generated model compiled to WebAssembly: the chip's C in a browser.

It is the C that is flashed, with the host's harness around it, which runs blocks of steps from
linear memory. It imports nothing: no library, no clock, no memory but its own.
"""

import importlib.util
import sys
import tempfile
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode

FLAGS = ("-O3",)
"""-msimd128 gives the same bits and is not surely faster; see `python -m benchmarks bench_wasm`."""
TARGET = ("-target", "wasm32-freestanding", "-nostdlib", "-s", "-Wl,--no-entry")
STACK_BYTES = 65_536
"""zd_run's own frame is some hundred bytes; see the firmware's figures of its stack."""
SHIM = (
    *("zd_state_size", "zd_start", "zd_elapse", "zd_run", "zd_pack", "zd_selftest"),
    "__heap_base",
)
"""Of the harness, and where free memory begins."""
FUNCTIONS = ("init", "settle", "step", "selftest", "save", "restore")
"""Of the firmware itself, by the names of its header."""


def find_wasm_compiler() -> Compiler:
    """Return the clang that compiles to WebAssembly.

    Raises:
        InputError: the ziglang wheel is not installed.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise InputError(
            "the ziglang wheel is not installed; expected its clang, which compiles to WebAssembly."
            " `pip install ziglang`."
        )
    return Compiler("zig", (sys.executable, "-m", "ziglang", "cc"))


def build_wasm(
    code: GeneratedCode,
    flags: tuple[str, ...] = FLAGS,
    *,
    warnings: tuple[str, ...] = ("-std=c99",),
) -> bytes:
    """Return a WebAssembly module that runs the C of a model.

    It exports `memory`, `NAME_init`, `NAME_settle`, `NAME_step` and the other functions of the
    header, and the harness's `zd_start`, `zd_run`, ... that the page calls.

    Args:
        code: its C, with the runtime of its folder.
        flags: optimisation and other compiler flags.
        warnings: what is an error; none for C of another version or by another author.

    Raises:
        InputError: there is no compiler.
        CheckError: it refuses the C.
    """
    compiler = find_wasm_compiler()
    names = [*SHIM, *(f"{code.prefix}_{function}" for function in FUNCTIONS)]
    with tempfile.TemporaryDirectory(prefix="zerodrift-wasm-") as scratch:
        folder = Path(scratch)
        write_sources(code, folder)
        harness, made = folder / f"{code.prefix}_harness.c", folder / f"{code.prefix}.wasm"
        harness.write_text(code.harness, encoding="utf-8")
        # The harness names this header and calls nothing of it; the target has no C library.
        (folder / "string.h").write_text("/* empty */\n", encoding="utf-8")
        compiler.run(
            [
                *(*TARGET, f"-Wl,-z,stack-size={STACK_BYTES}"),
                *(f"-Wl,--export={name}" for name in names),
                *(*warnings, *flags, "-DZD_PLAIN", f"-I{folder}"),
                *(str(harness), str(folder / "zd_runtime.c"), "-o", str(made)),
            ]
        )
        return made.read_bytes()
