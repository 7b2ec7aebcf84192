"""Many generated models compiled into one shared library: one start of the compiler for all."""

import ctypes
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.c_runtime.compilers import WARNINGS, find_compilers
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray

TRAPS = (
    "-fsanitize=signed-integer-overflow,shift,bounds,integer-divide-by-zero",
    "-fsanitize-undefined-trap-on-error",
)
"""What C leaves undefined ends the process."""
HOW = (
    ("-O0", *TRAPS),
    ("-O1",),
    ("-O0", "-DZD_SMALL", *TRAPS),
    ("-O1", "-DZD_LANES=2u"),
    ("-O0", "-DZD_KERNEL=ZD_KERNEL_PAIRS", *TRAPS),
    ("-O2",),
)
"""Options of the compiler, a set for each batch."""
CALLS = ("state_size", "selftest", "start", "elapse", "pack", "run")


class ManyHosts:
    """Compiled models, whose names differ, each run through the harness that was written for it.

    Args:
        models: with names that make different prefixes.
        directory: where sources and the library are written.
        how: options of the compiler.
    """

    def __init__(self, models: list[IntegerModel], directory: Path, how: tuple[str, ...]) -> None:
        self._models = models
        self.codes: list[GeneratedCode] = []
        sources = []
        for model in models:
            code = generate(model)
            write_sources(code, directory)
            renamed = [f"#define zd_{call} {code.prefix}_zd_{call}" for call in CALLS]
            source = directory / f"{code.prefix}_harness.c"
            source.write_text("\n".join([*renamed, code.harness]), encoding="utf-8")
            self.codes.append(code)
            sources.append(str(source))
        library = directory / "models.so"
        runtime = str(directory / "zd_runtime.c")
        options = [*WARNINGS, *how, "-shared", "-fPIC", f"-I{directory}"]
        find_compilers()[0].run([*options, *sources, runtime, "-o", str(library)])
        self._lib = ctypes.CDLL(str(library))

    def _call(self, index: int, name: str, *arguments: object) -> int:
        function = self._lib[f"{self.codes[index].prefix}_zd_{name}"]
        function.restype = ctypes.c_uint32
        return int(function(*arguments))

    def selftest(self, index: int) -> int:
        """Return what a model's own self-test returns; 0 = passed."""
        return self._call(index, "selftest")

    def run(self, index: int, codes: CodeArray, settled: bool, width: int) -> IntArray:
        """Return drifts, flags, nodes and the packed state, [B, width], for codes [B, T, C]."""
        model = self._models[index]
        state = ctypes.create_string_buffer(self._call(index, "state_size") + 16)
        nodes = sum(max(node.width, 1) for node in model.nodes)
        rows = []
        for sequence in codes:
            given = np.ascontiguousarray(sequence, dtype=model.code_type)
            steps = len(given)
            drift = np.empty((steps, len(model.outputs)), dtype=np.int32)
            flags = np.empty(steps, dtype=np.uint32)
            # a step without a first reading does not come to the nodes, which are 0 then
            trace = np.zeros((steps, nodes), dtype=np.int32)
            packed = np.empty(width - drift.size - flags.size - trace.size, dtype=np.int64)
            self._call(index, "start", state, _at(given), ctypes.c_int(int(settled)))
            self._call(
                index, "run", state, _at(given), ctypes.c_uint32(steps), _at(drift), _at(flags),
                _at(trace),
            )  # fmt: skip
            if self._call(index, "pack", state, _at(packed)) != packed.size:
                raise AssertionError(f"{self.codes[index].prefix}: the C packs another state")
            parts = (drift, flags, trace, packed)
            rows.append(np.concatenate([part.ravel().astype(np.int64) for part in parts]))
        return np.stack(rows)


def _at(array: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
