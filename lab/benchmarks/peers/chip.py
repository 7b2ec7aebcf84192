"""A layer's C, built for this host and for an emulated Cortex-M4, run on both and measured."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray
from unicorn import UC_HOOK_CODE, UcError
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_SP

from benchmarks.bench_kernels import HIDDEN
from benchmarks.peers.layers import Array, Task
from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.emulator import PAGE, load_program, make_chip
from zerodrift.c_runtime.footprint import list_symbols

CORE = "cortex-m4"
_STACK, _STACK_BYTES, _STOP = 0x8000_0000, 0x8000, 0x9000_0000
_UNTOUCHED = 0xA5
_ALIGNED, _TRIED = 16, 8
"""Bytes by which an arena is made smaller, steps that are run with it."""
_COUNTED = 32
"""Steps whose instructions are counted."""
_SECTIONS = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")


@dataclass(frozen=True)
class Program:
    """C with `peer_in`, `peer_out`, and `void peer_step(void)` that makes one of the other."""

    text: str
    """The program, which holds the numbers of the layer."""
    sources: tuple[Path, ...]
    flags: tuple[str, ...]
    """Such as -I of the library's headers."""
    encode: Callable[[Array], NDArray[np.generic]]
    """Inputs [T, I] as `peer_in` holds them, little endian."""
    decode: Callable[[NDArray[np.generic]], Array]
    """What `peer_out` holds [T, H] as states."""
    out_type: str
    """Of `peer_out`, by NumPy's name."""
    keeps_in_out: bool = False
    """Whether `peer_out` is the state itself, and so part of what the layer needs."""
    main: str = "main.c"
    """The name of `text`; main.cc is C++."""
    chip_libraries: tuple[Path, ...] = ()
    host_libraries: tuple[Path, ...] = ()
    arena_bytes: int = 0
    """Of memory that the library divides up itself, less what `peer_withheld` takes away."""


@dataclass(frozen=True)
class Figures:
    """What one library takes for one step of one layer, and what it answers."""

    instructions: int
    """Median of some steps on the core, the call included; -O2."""
    flash_bytes: int
    """Code and constants that the step needs, -Os, the C library's part included."""
    ram_bytes: int
    """Static, the states included; without the input's array, copies for the output, and what an
    arena can do without."""
    stack_bytes: int
    """Touched at -O2."""
    error_pct: float
    """On the core, against float64: RMS in % of the states' variation."""
    different: int
    """Numbers of all steps and units that this host computes differently."""
    numbers: int


def measure(task: Task, program: Program, folder: Path) -> Figures:
    """Return the figures of one library's layer.

    Raises:
        InputError: there is no GNU cross-compiler.
        CheckError: the C does not compile.
    """
    (folder / program.main).write_text(program.text, encoding="utf-8")
    given = program.encode(task.x)
    fast = _Chip(program, _build_chip(program, folder, "-O2"))
    answers, counts = fast.run(given)
    small = _build_chip(program, folder, "-Os")
    unlike = answers.view(np.uint8) != _run_host(program, folder, given).view(np.uint8)
    apart = ("peer_in", "peer_withheld")
    apart += () if program.keeps_in_out else ("peer_out",)
    spare = _find_spare(program, fast.elf, given, answers)
    return Figures(
        instructions=int(np.median(counts)),
        flash_bytes=_add_sections(small, writable=False),
        ram_bytes=_add_sections(small, writable=True) - _add_symbols(small, apart) - spare,
        stack_bytes=fast.stack_bytes,
        error_pct=task.measure_error(program.decode(answers)),
        different=int(unlike.reshape(*answers.shape, -1).any(axis=-1).sum()),
        numbers=answers.size,
    )


def _list_arguments(program: Program, folder: Path, libraries: tuple[Path, ...]) -> list[str]:
    given = (folder / program.main, *program.sources, *libraries)
    return [*program.flags, *_SECTIONS, "-w", *map(str, given)]


def _build_chip(program: Program, folder: Path, level: str) -> Path:
    found = [c for c in find_cross_compilers(CORE) if c.name == "gcc"]
    if not found:
        raise InputError("the GNU cross-compiler is not installed: `make setup-qemu`")
    elf = folder / f"peer{level}.elf"
    link = ["-nostartfiles", "-Wl,-Ttext=0x10000,-Tdata=0x100000,-e,peer_step", "-lm"]
    link += ["-Wl,-u,peer_in,-u,peer_out", "--specs=nosys.specs"]
    arguments = _list_arguments(program, folder, program.chip_libraries)
    found[0].run([level, *arguments, *link, "-o", str(elf)])
    return elf


def _run_host(program: Program, folder: Path, given: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return what this host answers to given [T, I], [T, H]."""
    compiler: Compiler = find_compilers()[0]
    library = folder / "peer.so"
    arguments = _list_arguments(program, folder, program.host_libraries)
    shown = folder / "shown.map"  # what is not needed is left out, as on the chip
    shown.write_text("{global: peer_in; peer_out; peer_step; local: *;};\n", encoding="utf-8")
    arguments += ["-shared", "-fPIC", f"-Wl,--version-script={shown}", "-lm"]
    compiler.run(["-O2", *arguments, "-o", str(library)])
    loaded = ctypes.CDLL(str(library))
    place = ctypes.addressof(ctypes.c_char.in_dll(loaded, "peer_in"))
    out = np.zeros((len(given), HIDDEN), dtype=program.out_type)
    told = ctypes.addressof(ctypes.c_char.in_dll(loaded, "peer_out"))
    for t, row in enumerate(given):
        ctypes.memmove(place, row.tobytes(), row.nbytes)
        loaded.peer_step()
        ctypes.memmove(out[t].ctypes.data, told, out[t].nbytes)
    return out


class _Chip:
    """The program on the emulated core."""

    def __init__(self, program: Program, elf: Path) -> None:
        self._type = np.dtype(program.out_type).newbyteorder("<")
        self.elf = elf
        self._chip = make_chip(CORE)
        with elf.open("rb") as file:
            image = ELFFile(file)
            load_program(self._chip, image)
            self._at = {s.name: s.value for s in list_symbols(image)}
        self._chip.mem_map(_STACK, _STACK_BYTES)
        self._chip.mem_map(_STOP, PAGE)
        self._chip.mem_write(_STACK, bytes([_UNTOUCHED]) * _STACK_BYTES)

    def run(self, given: NDArray[np.generic]) -> tuple[NDArray[np.generic], list[int]]:
        """Return the answers [T, H] to given [T, I], and the instructions of the last steps."""
        out = np.zeros((len(given), HIDDEN), dtype=self._type)
        count, counts = [0], []
        for t, row in enumerate(given):
            if t == len(given) - _COUNTED:
                self._chip.hook_add(UC_HOOK_CODE, lambda *_: count.__setitem__(0, count[0] + 1))
                self._chip.ctl_flush_tb()
            before = count[0]
            self._chip.mem_write(self._at["peer_in"], row.tobytes())
            self._step()
            counts.append(count[0] - before)
            raw = self._chip.mem_read(self._at["peer_out"], out[t].nbytes)
            out[t] = np.frombuffer(bytes(raw), dtype=self._type)
        return out, counts[-_COUNTED:]

    def _step(self) -> None:
        self._chip.reg_write(UC_ARM_REG_SP, _STACK + _STACK_BYTES)
        self._chip.reg_write(UC_ARM_REG_LR, _STOP | 1)
        self._chip.emu_start(self._at["peer_step"] | 1, _STOP, timeout=10_000_000)

    def write_word(self, name: str, value: int) -> None:
        """Set a variable of 32 bits."""
        self._chip.mem_write(self._at[name], value.to_bytes(4, "little"))

    @property
    def stack_bytes(self) -> int:
        """Return the bytes of stack that all steps touched."""
        stack = np.frombuffer(bytes(self._chip.mem_read(_STACK, _STACK_BYTES)), dtype=np.uint8)
        return _STACK_BYTES - int((stack != _UNTOUCHED).argmax())


def _find_spare(
    program: Program, elf: Path, given: NDArray[np.generic], answers: NDArray[np.generic]
) -> int:
    """Return how many bytes of its arena the library can do without: the first answers stay."""
    works, fails = 0, program.arena_bytes
    while fails - works > _ALIGNED:
        middle = (works + fails) // (2 * _ALIGNED) * _ALIGNED
        chip = _Chip(program, elf)
        chip.write_word("peer_withheld", middle)
        try:
            same = bool((chip.run(given[:_TRIED])[0] == answers[:_TRIED]).all())
        except UcError:  # it ends in a trap or at an address that is not there
            same = False
        works, fails = (middle, fails) if same else (works, middle)
    return works


def _add_sections(elf: Path, *, writable: bool) -> int:
    """Return the bytes of what a program holds in flash, or of its variables."""
    with elf.open("rb") as file:
        image = ELFFile(file)
        total = 0
        for section in image.iter_sections():
            flags = section["sh_flags"]
            if not flags & SH_FLAGS.SHF_ALLOC:
                continue
            is_writable = bool(flags & SH_FLAGS.SHF_WRITE)
            in_flash = section["sh_type"] != "SHT_NOBITS"  # initial values lie there as well
            if (writable and is_writable) or (not writable and in_flash):
                total += int(section["sh_size"])
    return total


def _add_symbols(elf: Path, names: tuple[str, ...]) -> int:
    """Return the bytes of some variables."""
    with elf.open("rb") as file:
        return sum(s.size for s in list_symbols(ELFFile(file)) if s.name in names)
