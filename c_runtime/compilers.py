"""Finds a C compiler on the host: $CC, then cc, gcc, clang, then the `ziglang` wheel."""

import ctypes
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import CheckError, InputError

RUNTIME_DIRECTORY = Path(__file__).parent
INCLUDE_DIRECTORY = RUNTIME_DIRECTORY / "include" / "zerodrift"
RUNTIME_FILES = (
    INCLUDE_DIRECTORY / "zd_runtime.h",
    INCLUDE_DIRECTORY / "zd_signals.h",
    INCLUDE_DIRECTORY / "zd_exp2.h",
    INCLUDE_DIRECTORY / "zd_network.h",
    INCLUDE_DIRECTORY / "zd_tanh_table.h",
    INCLUDE_DIRECTORY / "zd_gru_portable.h",
    INCLUDE_DIRECTORY / "zd_gru_pairs.h",
    INCLUDE_DIRECTORY / "zd_gru_rows.h",
    INCLUDE_DIRECTORY / "zd_gru_columns.h",
    INCLUDE_DIRECTORY / "zd_gru_columns_sse2.h",
    INCLUDE_DIRECTORY / "zd_gru_columns_avx2.h",
    INCLUDE_DIRECTORY / "zd_lstm.h",
    INCLUDE_DIRECTORY / "zd_lstm_rows.h",
    INCLUDE_DIRECTORY / "zd_layer_norm.h",
    RUNTIME_DIRECTORY / "src" / "zd_runtime.c",
)
"""What a generated model may include, with what it is linked with; `list_runtime` says which."""
_INCLUDED = re.compile(r'^[ \t]*#[ \t]*include[ \t]*"(zd_\w+\.h)"', re.MULTILINE)

HOST_MVE_DIRECTORY = RUNTIME_DIRECTORY / "host_mve"
"""Holds arm_mve.h for a host, by which the rows kernel runs there."""

WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")


LEAST_ROOM = 2**20
"""Bytes: a model's object files and library together, with debug information, are smaller."""
_NO_ROOM = ("No space left on device", "NoSpaceLeft", "Disk quota exceeded", "File too large")
"""What compilers print of a disk that is full: of the system's errors ENOSPC, EDQUOT, EFBIG."""

SANITIZE = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
"""What makes undefined behaviour end a program by a signal; no compiler's library is needed."""


@dataclass(frozen=True)
class Compiler:
    """A host C compiler as a command."""

    name: str
    command: tuple[str, ...]

    def run(self, arguments: list[str]) -> None:
        """Compile.

        Raises:
            InputError: the disk has no room for what it makes.
            CheckError: the compiler failed; carries what it said.
        """
        done = subprocess.run(
            [*self.command, *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            env=make_environment(),
        )
        if done.returncode != 0:
            places = [Path(word) for word in arguments if os.path.isabs(word)]  # noqa: PTH117
            if (full := find_full(places, done.stderr)) is not None:
                raise InputError(
                    f"{full}: the compiler could not write there (no space left on the disk);"
                    f" expected {LEAST_ROOM // 2**20} MiB of room at least. Make room on that disk"
                    " and run the command again. Every file is as it was before."
                )
            raise CheckError(
                f"{shlex.join([*self.command, *arguments])} failed with exit code"
                f" {done.returncode}:\n{done.stderr[:4000]}"
            )

    def describe(self) -> str:
        """Return name and version as the compiler tells them; its name alone if it does not."""
        done = subprocess.run(
            [*self.command, "--version"], capture_output=True, text=True, check=False
        )
        lines = done.stdout.splitlines()
        return lines[0].strip() if lines else self.name


def list_runtime(*texts: str) -> dict[str, str]:
    """Return the runtime that has to lie beside C: name -> text.

    Args:
        texts: the C. What it includes is followed, and what that includes, under any condition.
    """
    every = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    found = {name: text for name, text in every.items() if name.endswith(".c")}
    left = [*texts, *found.values()]
    while left:
        for name in _INCLUDED.findall(left.pop()):
            if name in every and name not in found:
                found[name] = every[name]
                left.append(every[name])
    return {name: text for name, text in every.items() if name in found}


def find_full(places: Iterable[Path], told: str) -> Path | None:
    """Return the folder whose disk was full while a compiler worked; None if none was.

    A compiler that cannot write may say so, or be aborted without a word, or say what the linker
    made of a file that was cut off; so the disk is asked too.

    Args:
        places: files that it read and wrote.
        told: what it printed.
    """
    folders = dict.fromkeys([*(place.parent for place in places), Path(tempfile.gettempdir())])
    room: dict[Path, int] = {}
    for folder in folders:
        with suppress(OSError):
            room[folder] = shutil.disk_usage(folder).free
    if not room:
        return None
    least = min(room, key=room.__getitem__)
    is_told = any(words in told for words in _NO_ROOM)
    return least if is_told or room[least] < LEAST_ROOM else None


def can_sanitize(compiler: Compiler, folder: Path) -> bool:
    """Tell whether a compiler knows `SANITIZE` and what it makes of it can be loaded.

    Args:
        compiler: of the host.
        folder: for a small program.
    """
    source, library = folder / "zd_sanitized.c", folder / "zd_sanitized.so"
    source.write_text("int zd_sum(int a, int b);\nint zd_sum(int a, int b) { return a + b; }\n")
    try:
        compiler.run([*SANITIZE, "-O1", "-shared", "-fPIC", str(source), "-o", str(library)])
        ctypes.CDLL(str(library))
    except (CheckError, OSError):
        return False
    return True


def make_environment() -> dict[str, str]:
    """Return the environment that compilers run in: this process's, and a cache for zig.

    zig keeps what it compiles below the user's home. Where there is none that can be written, as
    under cron and in containers, it is given a folder among the temporary files.
    """
    environment = dict(os.environ)
    if "ZIG_GLOBAL_CACHE_DIR" in environment:
        return environment
    home = environment.get("XDG_CACHE_HOME") or environment.get("HOME", "")
    if os.name == "posix" and not (home and os.access(home, os.W_OK)):
        cache = Path(tempfile.gettempdir()) / f"zerodrift-zig-{os.getuid()}"
        environment["ZIG_GLOBAL_CACHE_DIR"] = str(cache)
    return environment


def find_compilers() -> list[Compiler]:
    """Return the host compilers there are, the preferred one first."""
    found: list[Compiler] = []
    if os.environ.get("CC"):
        command = shlex.split(os.environ["CC"])
        if not shutil.which(command[0]):
            raise InputError(f"CC={os.environ['CC']}: no such program; unset CC or correct it")
        found.append(Compiler("cc", tuple(command)))
    for name in ("gcc", "clang", "cc"):
        path = shutil.which(name)
        if path and not (name == "cc" and found):
            found.append(Compiler(name, (path,)))
    if importlib.util.find_spec("ziglang"):
        found.append(Compiler("zig", (sys.executable, "-m", "ziglang", "cc")))
    return found


def find_compiler() -> Compiler:
    """Return the preferred host compiler.

    Raises:
        InputError: there is none; says how to get one.
    """
    found = find_compilers()
    if not found:
        raise InputError(
            "no C compiler found (looked for $CC, gcc, clang, cc and the ziglang wheel); the host"
            " check needs one. Install gcc, or `pip install ziglang`."
        )
    return found[0]
