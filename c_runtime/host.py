"""A generated model compiled for the host and called through ctypes."""

import ctypes
import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import WARNINGS, Compiler, find_compiler, list_runtime
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray

SAVED_EXTRA_BYTES = 16
"""Bytes of a saved state beyond the state itself: version, model, size, CRC."""
_UNWRITTEN = 123456789
"""In what a step has to write: memory used before might hold the right answer by chance."""


@dataclass(frozen=True)
class HostTrace:
    """What the C gave for one sequence."""

    drift: NDArray[np.int32]  # [T, K]
    flags: NDArray[np.uint32]  # [T]
    nodes: NDArray[np.int32]
    """[T, N] the values of all nodes in order (a GRU: its Q1.30 state); N = 0 if not observed."""


class HostModel:
    """A compiled model; holds one state.

    Args:
        model: the integer model, for its shapes.
        code: its C.
        directory: where sources and the shared library are written.
        compiler: host compiler; the preferred one if None.
        flags: optimisation and other compiler flags.
        observe: record every node's value; False compiles the source exactly as it is flashed.
        warnings: warnings that are errors; none for C of another version or by another author.
    """

    def __init__(
        self,
        model: IntegerModel,
        code: GeneratedCode,
        directory: Path,
        compiler: Compiler | None = None,
        flags: tuple[str, ...] = ("-O2",),
        *,
        observe: bool = True,
        warnings: tuple[str, ...] = WARNINGS,
    ) -> None:
        compiler = compiler or find_compiler()
        directory.mkdir(parents=True, exist_ok=True)
        write_sources(code, directory)
        harness = directory / f"{code.prefix}_harness.c"
        harness.write_text(code.harness, encoding="utf-8")
        arguments = [
            *warnings,
            *flags,
            *(() if observe else ("-DZD_PLAIN",)),
            "-shared",
            "-fPIC",
            f"-I{directory}",
            str(harness),
            str(directory / "zd_runtime.c"),
        ]
        # The loader takes a library for the one it has already loaded under the same name.
        texts = [*render_sources(code).values(), code.harness]
        build = [*texts, *compiler.command, *arguments]
        digest = hashlib.sha256("\0".join(build).encode()).hexdigest()[:16]
        library = directory / f"{code.prefix}_{digest}.so"
        library.unlink(missing_ok=True)
        compiler.run([*arguments, "-o", str(library)])
        self._attach(model, code.prefix, library, observe=observe)

    @classmethod
    def attach(
        cls, model: IntegerModel, prefix: str, library: Path, symbols: str, *, observe: bool
    ) -> "HostModel":
        """Return the model whose symbols begin with `symbols` in a library of several models.

        Args:
            model: the integer model, for its shapes.
            prefix: of its C names.
            library: the shared library, already built.
            symbols: what precedes every name of the model and of its harness there.
            observe: whether its harness records every node's value.
        """
        host = cls.__new__(cls)
        host._attach(model, prefix, library, symbols, observe=observe)
        return host

    def _attach(
        self, model: IntegerModel, prefix: str, library: Path, symbols: str = "", *, observe: bool
    ) -> None:
        """Load the library and find the harness in it.

        Raises:
            CheckError: a function is missing in the C.
        """
        self.model = model
        self.prefix, self._symbols = f"{symbols}{prefix}", symbols
        self.library = library
        self.observes = observe
        self._values = sum(max(node.width, 1) for node in model.nodes) if observe else 0
        try:
            self._lib = ctypes.CDLL(str(library))
        except OSError as error:  # most often a function that no file holds
            raise CheckError(f"{library}:\nerror: the library cannot be loaded: {error}") from error
        self._start, self._elapse, self._run = (
            self._lib[f"{symbols}{name}"] for name in ("zd_start", "zd_elapse", "zd_run")
        )
        self._size, self._selftest, self._pack = (
            self._lib[f"{symbols}{name}"] for name in ("zd_state_size", "zd_selftest", "zd_pack")
        )
        for function in (self._size, self._selftest, self._pack):
            function.restype = ctypes.c_uint32
        # Told once, so that addresses are passed as they are, call after call.
        place = ctypes.c_void_p
        self._run.argtypes = [place, place, ctypes.c_uint32, place, place, place]
        self._pack.argtypes = [place, place]
        self._state = ctypes.create_string_buffer(self._size() + 16)

    @property
    def values(self) -> int:
        """How many nodes' values a step records; 0 if not observed."""
        return self._values

    @property
    def state_bytes(self) -> int:
        """Size of the state struct on this host."""
        return int(self._size())

    def selftest(self) -> int:
        """Return what the model's own self-test returns; 0 = passed."""
        return int(self._selftest())

    def use_block(self, content: bytes) -> int:
        """Compute with a unit's block from here on; return what the C says of it, 0 = accepted.

        A refused block is not used, and none is. For the C of a design only.
        """
        self._hold_block(content)
        function = self._lib[f"{self._symbols}zd_use_block"]
        function.restype = ctypes.c_uint32
        return int(function(ctypes.c_void_p(self._block_at), ctypes.c_uint32(len(content))))

    def choose_block(self, first: bytes, second: bytes) -> int | None:
        """Return which of two slots of equal length the C chooses, 0 or 1; None for neither."""
        slots = [ctypes.create_string_buffer(len(first) + 16) for _ in range(2)]
        places = [-(-ctypes.addressof(slot) // 8) * 8 for slot in slots]
        for place, content in zip(places, (first, second), strict=True):
            ctypes.memmove(place, content, len(first))
        function = self._lib[f"{self.prefix}_choose_block"]
        function.restype = ctypes.c_void_p
        arguments = (*map(ctypes.c_void_p, places), ctypes.c_size_t(len(first)))
        found = function(*arguments)
        return None if found is None else places.index(int(found))

    def _hold_block(self, content: bytes) -> None:
        """Keep a copy at an address that 8 divides, as in flash."""
        self._block = ctypes.create_string_buffer(len(content) + 16)
        self._block_at = -(-ctypes.addressof(self._block) // 8) * 8
        ctypes.memmove(self._block_at, content, len(content))

    def save(self) -> bytes:
        """Return the copy of the state that the model's own save makes."""
        saved = ctypes.create_string_buffer(self.state_bytes + SAVED_EXTRA_BYTES)
        self._lib[f"{self.prefix}_save"](self._state, saved)
        return saved.raw

    def restore(self, saved: bytes) -> int:
        """Take over a copy of `state_bytes` + 16 bytes; return what the C returns, 0 = accepted."""
        if len(saved) != self.state_bytes + SAVED_EXTRA_BYTES:
            raise ValueError(f"{len(saved)} bytes, not {self.state_bytes + SAVED_EXTRA_BYTES}")
        own = f"{self._symbols}zd_restore_state"  # of a program that takes a block
        function = self._lib[own if hasattr(self._lib, own) else f"{self.prefix}_restore"]
        function.restype = ctypes.c_uint32
        return int(function(self._state, saved))

    def tare(self) -> None:
        """Count the drift from the last answer on."""
        self._lib[f"{self.prefix}_tare"](self._state)

    def untare(self) -> None:
        """Count the drift from 0 again."""
        self._lib[f"{self.prefix}_untare"](self._state)

    def restore_after(self, saved: bytes, age_us: int) -> int:
        """Take over a copy made some time ago; return what the C returns, 0 = accepted."""
        if len(saved) != self.state_bytes + SAVED_EXTRA_BYTES:
            raise ValueError(f"{len(saved)} bytes, not {self.state_bytes + SAVED_EXTRA_BYTES}")
        function = self._lib[f"{self._symbols}zd_restore_after"]
        function.restype = ctypes.c_uint32
        return int(function(self._state, saved, ctypes.c_uint64(age_us)))

    def overwrite(self, content: bytes) -> None:
        """Put bytes over the beginning of the state, as a stray pointer does."""
        ctypes.memmove(self._state, content, min(len(content), self.state_bytes))

    def pack(self, length: int) -> NDArray[np.int64]:
        """Return the state as `length` numbers, in the order of `ModelState.pack`."""
        packed = np.empty(length, dtype=np.int64)
        _check_width(int(self._pack(self._state, _pointer(packed))), length)
        return packed

    def run(
        self,
        codes: CodeArray,
        *,
        settled: bool = True,
        restart: bool = True,
        elapsed: int = 0,
    ) -> HostTrace:
        """Run over codes [T, C]; from `settle` or `init` at codes[0], or on from the last call.

        Args:
            codes: raw input codes.
            settled: start from `settle` rather than `init`.
            restart: False goes on from the last call.
            elapsed: steps since power-on, for a log that starts later; only with `settled`.
        """
        codes = np.ascontiguousarray(codes, dtype=self.model.code_type)
        if restart:
            self._begin(codes, settled)
            if elapsed:
                self._elapse(self._state, ctypes.c_int32(min(elapsed, 2**31 - 1)))
        trace = self._make_trace(len(codes))
        _Places(codes, trace).run(self._run, self._state, 0, len(codes))
        return trace

    def run_chunks(
        self, codes: CodeArray, chunk: int, width: int, *, settled: bool = True
    ) -> tuple[HostTrace, NDArray[np.int64]]:
        """Run over codes [T, C] from `settle` or `init`; return also the states after each chunk.

        Args:
            codes: raw input codes, T > 0.
            chunk: steps after which the state is read; the last chunk may be shorter.
            width: numbers of a state, in the order of `ModelState.pack`.
            settled: start from `settle` rather than `init`.

        Returns:
            What the C gave at all T steps, and the states [chunks, width].
        """
        codes = np.ascontiguousarray(codes, dtype=self.model.code_type)
        self._begin(codes, settled)
        trace = self._make_trace(len(codes))
        places = _Places(codes, trace)
        states = np.empty((-(-len(codes) // chunk), width), dtype=np.int64)
        at = states.ctypes.data
        for number in range(len(states)):
            first = number * chunk
            places.run(self._run, self._state, first, min(chunk, len(codes) - first))
            count = self._pack(self._state, at + number * states.strides[0])
            _check_width(int(count), width)
        return trace, states

    def _begin(self, codes: CodeArray, settled: bool) -> None:
        self._start(self._state, _pointer(codes), ctypes.c_int(int(settled)))

    def _make_trace(self, steps: int) -> HostTrace:
        """Return where the C writes what it gives for some steps."""
        return HostTrace(
            np.full((steps, len(self.model.outputs)), _UNWRITTEN, dtype=np.int32),
            np.full(steps, _UNWRITTEN, dtype=np.uint32),
            np.zeros((steps, self._values), dtype=np.int32),
        )


class _Places:
    """Where codes lie and answers go, so that a call of the C costs no search for them."""

    def __init__(self, codes: CodeArray, trace: HostTrace) -> None:
        self._kept = (codes, trace)
        arrays = (codes, trace.drift, trace.flags, trace.nodes)
        self._firsts = [array.ctypes.data for array in arrays]
        self._strides = [array.strides[0] for array in arrays]
        self._traced = trace.nodes.shape[1] > 0

    def run(
        self,
        function: Callable[..., object],
        state: "ctypes.Array[ctypes.c_char]",
        first: int,
        steps: int,
    ) -> None:
        """Go on by some steps, the first of which is row `first`."""
        codes, drift, flags, nodes = (
            at + first * stride for at, stride in zip(self._firsts, self._strides, strict=True)
        )
        function(state, codes, steps, drift, flags, nodes if self._traced else None)


def _check_width(count: int, expected: int) -> None:
    if count != expected:
        raise AssertionError(f"the C packs {count} numbers, the reference {expected}")


def write_sources(code: GeneratedCode, directory: Path) -> list[Path]:
    """Write model and runtime into a `directory` for the time being; return their paths."""
    contents = {directory / name: text.encode() for name, text in render_sources(code).items()}
    for path, content in contents.items():
        path.write_bytes(content)
    return list(contents)


def render_sources(code: GeneratedCode) -> dict[str, str]:
    """Return model and runtime by the name of the file."""
    runtime = code.runtime
    if runtime is None:
        runtime = list_runtime(code.header, code.source)
    return {code.header_name: code.header, code.source_name: code.source, **runtime}


def _pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


# Many generated models in one host library, so that a compiler starts once for all of them.
#
# Models of one design have the same C names. Their sources are compiled as they are: a file that
# includes one after the other gives every name of a model another one by the preprocessor, and
# takes that and the model's macros back before the next. The runtime is compiled once.

HARNESS = "zd_harness.c"
_MACRO = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", re.MULTILINE)
_DEFINED = re.compile(
    r"^(?:static )?(?:const )?\w[\w \t]*?[ \t*](\w+)[ \t]*(?:\(|\[|=|;)", re.MULTILINE
)


def build_host_batch(
    models: Sequence[IntegerModel],
    codes: Sequence[GeneratedCode],
    directory: Path,
    compiler: Compiler | None = None,
    flags: tuple[str, ...] = ("-O1",),
    *,
    observe: bool = False,
) -> list[HostModel]:
    """Return the compiled models, all in one shared library.

    Args:
        models: the integer models, for their shapes.
        codes: their C; names may repeat.
        directory: where sources and library are written.
        compiler: host compiler; the preferred one if None.
        flags: optimisation and other compiler flags.
        observe: record every node's value; False compiles the sources exactly as they are flashed.

    Raises:
        CheckError: the compiler refuses a source.
    """
    compiler = compiler or find_compiler()
    directory.mkdir(parents=True, exist_ok=True)
    runtime = directory / "runtime"
    runtime.mkdir(exist_ok=True)
    lines = []
    for number, code in enumerate(codes):
        folder = directory / str(number)
        folder.mkdir(exist_ok=True)
        texts = {code.header_name: code.header, code.source_name: code.source}
        for name, text in {**texts, HARNESS: code.harness}.items():
            (folder / name).write_text(text, encoding="utf-8")
        lines.append(include_renamed(code, number))
    files = list_runtime(*(text for code in codes for text in (code.header, code.source)))
    for name, text in files.items():
        (runtime / name).write_text(text, encoding="utf-8")
    together = directory / "together.c"
    together.write_text("\n".join(lines), encoding="utf-8")
    common = [*WARNINGS, *flags, "-fPIC", f"-I{runtime}"]
    if not observe:
        common.append("-DZD_PLAIN")
    # The loader takes a library for the one it has already loaded under the same name.
    digest = hashlib.sha256("\0".join([*(c.source for c in codes), *common]).encode()).hexdigest()
    library = directory / f"together_{digest[:16]}.so"
    arguments = [*common, "-shared", str(together), str(runtime / "zd_runtime.c")]
    compiler.run([*arguments, "-o", str(library)])
    return [
        HostModel.attach(model, code.prefix, library, _symbols(number), observe=observe)
        for number, (model, code) in enumerate(zip(models, codes, strict=True))
    ]


def include_renamed(code: GeneratedCode, number: int) -> str:
    """Return the lines of C that include a model's harness, its names made unlike any other's."""
    texts = (code.header, code.source, code.harness)
    macros = {name for text in texts for name in _MACRO.findall(text)}
    names = {name for text in texts for name in _DEFINED.findall(text)}
    names |= set(re.findall(rf"\b{re.escape(code.prefix)}_\w+", "\n".join(texts)))
    renamed = sorted(names - macros - {"", "in", "s", "out", "n", "k"})
    lines = [f"#define {name} {_symbols(number)}{name}" for name in renamed]
    lines.append(f'#include "{number}/{HARNESS}"')
    lines += [f"#undef {name}" for name in (*renamed, *sorted(macros))]
    return "\n".join(lines) + "\n"


def _symbols(number: int) -> str:
    return f"m{number}_"
