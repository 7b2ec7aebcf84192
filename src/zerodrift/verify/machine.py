"""What this machine has to build and check firmware with, and the state of a project's folder."""

import importlib.metadata
import os
import platform
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zerodrift import __version__
from zerodrift.base.errors import InputError
from zerodrift.base.extras import (
    FLEET,
    PAGE,
    RECORD_CAN,
    RECORD_MQTT,
    RECORD_SERIAL,
    TRAIN,
    is_there,
    tell_install,
)
from zerodrift.base.lock import LOCK, describe_holder, find_state, try_lock
from zerodrift.c_runtime.compilers import find_compilers
from zerodrift.c_runtime.cores import find_cross_compilers, list_cores

PACKAGES: dict[str, str] = {
    "numpy": "arithmetic",
    "scipy": "fits",
    "polars": "reads logs",
    "onnx": "reads and writes networks",
    "onnxruntime": "runs the integer model as ONNX",
    "torch": "trains networks other than the lag bank",
    "unicorn": "emulates cores",
    "ziglang": "compiles for every core",
    "dash": "serves the page",
    "ray": "spreads a fleet over machines",
    "serial": "records from serial ports",
    "can": "records from CAN buses",
    "paho.mqtt": "records from MQTT brokers",
}
"""What zerodrift uses, and for what."""
DISTRIBUTIONS = {"serial": "pyserial", "can": "python-can", "paho.mqtt": "paho-mqtt"}
"""Where the name to install is not the module's."""
EXTRAS = (TRAIN, PAGE, FLEET, RECORD_SERIAL, RECORD_CAN, RECORD_MQTT)
EXTRA_OF = {extra.package: extra.name for extra in EXTRAS}
PROGRAMS: dict[str, tuple[tuple[str, ...], str]] = {
    "Chromium": (("chromium", "chromium-browser", "google-chrome"), "report as PDF and PNG"),
    "QEMU for Arm": (("qemu-system-arm",), "boards as a second opinion on the cores"),
    "QEMU for RISC-V": (("qemu-system-riscv32",), "boards as a second opinion on the cores"),
}
STRAYS = (".firmware-*", ".verify-*", ".report-*")
"""Scratch folders that killed commands of earlier versions have left behind."""
STATE_FILES = (
    ("*.begin", "change", "was not decided; the next command that writes takes it back"),
    ("*.forward", "change", "is being made, or was cut off; the next command ends it"),
    ("*.back", "change", "is being taken back; the next command ends that"),
    ("scratch-*", "scratch folder", "removed by the next command that writes, unless in use"),
)
LEAST_FREE_BYTES = 200_000_000


@dataclass(frozen=True)
class Item:
    """One line of the findings."""

    group: str
    name: str
    state: str
    """A version or a place; `missing`; or what is wrong."""
    use: str
    """What it is for, or what to do."""
    is_missing: bool = False


@dataclass(frozen=True)
class Machine:
    """All that was found."""

    items: tuple[Item, ...]

    @property
    def can_check(self) -> bool:
        """Whether firmware can be built and checked here on the host and on a core."""
        there = {item.name for item in self.items if not item.is_missing}
        return "host compiler" in there and {"unicorn", "ziglang"} <= there


def examine_machine() -> Machine:
    """Return what of zerodrift's surroundings is there and what is not."""
    return Machine(
        (
            Item("zerodrift", "zerodrift", __version__, ""),
            Item("zerodrift", "Python", platform.python_version(), sys.executable),
            Item("zerodrift", "system", f"{platform.system()} {platform.machine()}", ""),
            *_list_packages(),
            *_list_compilers(),
            *_list_programs(),
        )
    )


def examine_project(directory: Path, folders: Sequence[Path]) -> tuple[Item, ...]:
    """Return what a project's folder says of its state: room on the disk, and strays.

    Args:
        directory: of zerodrift.toml.
        folders: where zerodrift writes, existing or not.
    """
    free = shutil.disk_usage(directory).free
    short = free < LEAST_FREE_BYTES
    items = [
        Item(
            "project",
            "free on its disk",
            f"{free / 1e9:.1f} GB",
            "make room: a build needs some 200 MB" if short else "",
            is_missing=short,
        )
    ]
    strays = sorted(
        stray
        for folder in {directory, *folders}
        if folder.is_dir()
        for pattern in STRAYS
        for stray in folder.glob(pattern)
    )
    remedy = (
        "left by a command that was killed, or of one that runs now; may be deleted if none does"
    )
    items += [
        Item("project", "scratch folder", os.path.relpath(stray, directory), remedy)
        for stray in strays
    ]
    return (*items, *_list_state(directory))


def _list_state(directory: Path) -> list[Item]:
    """Return who holds the project, and what the next command that writes will end or remove."""
    state = find_state(directory)
    items = []
    try:
        release = try_lock(state / LOCK) if (state / LOCK).exists() else None
        if release is not None:
            release()
        elif (state / LOCK).exists():
            held = "writes; another command that writes waits for it"
            items.append(Item("project", "lock", describe_holder(state), held))
    except OSError as error:
        why = "the lock cannot be tried: this folder can be read only"
        items.append(Item("project", "lock", str(error.strerror), why))
    for pattern, name, remedy in STATE_FILES:
        items += [Item("project", name, path.name, remedy) for path in state.glob(pattern)]
    return items


def _list_packages() -> list[Item]:
    items = []
    for name, use in PACKAGES.items():
        if not is_there(name):
            extra = EXTRA_OF.get(name)
            remedy = f"{use}; {tell_install(extra) if extra else f'pip install {name}'}"
            items.append(Item("packages", name, "missing", remedy, is_missing=True))
        else:
            installed = importlib.metadata.version(DISTRIBUTIONS.get(name, name))
            items.append(Item("packages", name, installed, use))
    return items


def _list_compilers() -> list[Item]:
    try:
        hosts = find_compilers()
    except InputError as error:
        hosts, problem = [], str(error)
    else:
        problem = "install gcc, or `pip install ziglang`"
    names = ", ".join(compiler.name for compiler in hosts)
    items = [
        Item("compilers", "host compiler", names or "missing", "" if hosts else problem, not hosts)
    ]
    for core in list_cores():
        found = ", ".join(compiler.name for compiler in find_cross_compilers(core))
        remedy = "" if found else "`pip install ziglang`, or the GNU cross-compiler"
        items.append(Item("compilers", core, found or "missing", remedy, not found))
    return items


def _list_programs() -> list[Item]:
    items = []
    for name, (programs, use) in PROGRAMS.items():
        place = next((path for p in programs if (path := shutil.which(p))), None)
        items.append(Item("programs", name, place or "missing", use, place is None))
    return items
