"""A GRU and an LSTM by other libraries and by zerodrift, on an emulated Cortex-M4 and on this host.

    python -m benchmarks.peers [--cmsis-nn DIR] [--nnom DIR] [--onnx2c DIR] [--tflm DIR]
                               [--emlearn DIR]

DIR is a checkout of the library's sources; a library without one is left out, and said to be.
onnx2c has to be built in a folder of its checkout, TensorFlow Lite Micro (TFLM) by its own
makefile for chip and host. All get the same five random layers of 16 units on 4 inputs, 2,000 steps
of the same inputs from a state of zero, and are built by arm-none-eabi-gcc for a Cortex-M4 without
floating-point unit and by this host's compiler. *instructions*: of a step, call included, at -O2,
the median of 32, counted by unicorn. *flash*: code and constants that the step needs, C library
included, at -Os. *RAM*: static, at -Os, states included. *stack*: touched at -O2. *error*: of the
states on the chip against float64, RMS in % of the variation of the states, the median and the
largest of the five. *host*: how many of the states' numbers this host computes differently.
Networks around the layer, interpreters and their memory are not counted but for TFLM, which makes
no step without them; every figure of it is of its makefile's one release build.
"""

import argparse
import re
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.chip import Figures, Program, measure
from benchmarks.peers.cmsis_nn import NEEDED as CMSIS_NN_NEEDED
from benchmarks.peers.cmsis_nn import write_cmsis_nn
from benchmarks.peers.layers import Task, draw_task
from benchmarks.peers.nnom import NEEDED as NNOM_NEEDED
from benchmarks.peers.nnom import write_nnom
from benchmarks.peers.onnx2c import NEEDED as ONNX2C_NEEDED
from benchmarks.peers.onnx2c import find_generator, write_onnx2c
from benchmarks.peers.ours import write_ours
from benchmarks.peers.tflm import NEEDED as TFLM_NEEDED
from benchmarks.peers.tflm import find_lack, list_libraries, write_tflm

KINDS = ("gru", "lstm")
SEEDS = range(5)
CMSIS = "cmsis_nn"
"""The other kernels that TFLM can be built with, by its makefile's name."""
WIDTHS = (12, 6, 5, 5, 8, 8)
"""Of the table's columns."""
_WORDS = {"gru": re.compile(r"gru(?![a-z])", re.I), "lstm": re.compile(r"lstm", re.I)}


@dataclass(frozen=True)
class Peer:
    """A library."""

    name: str
    option: str
    needed: str
    """A file that its checkout has."""
    sources: tuple[str, ...]
    """Folders of its operators, in which a kind's name is looked for."""
    form: str
    """Of its numbers."""
    write: Callable[[Task, Path, Path], Program] | None = None
    """From task, checkout and a folder to write to."""
    find_lack: Callable[[Path], str] = lambda _: ""
    """From a checkout what it lacks to be run, "" if nothing."""


PEERS = (
    Peer(
        "CMSIS-NN",
        "cmsis_nn",
        CMSIS_NN_NEEDED,
        ("Source",),
        "int16, weights int8",
        lambda task, place, _: write_cmsis_nn(task, place),
    ),
    Peer(
        "NNoM",
        "nnom",
        NNOM_NEEDED,
        ("src/layers",),
        "int8, states int16",
        lambda task, place, _: write_nnom(task, place),
    ),
    Peer(
        "onnx2c",
        "onnx2c",
        ONNX2C_NEEDED,
        ("src/nodes",),
        "float",
        write_onnx2c,
        lambda place: "" if find_generator(place) else "is not built, there is no */onnx2c",
    ),
    Peer(
        "TFLM",
        "tflm",
        TFLM_NEEDED,
        ("tensorflow/lite/micro/kernels",),
        "int16, weights int8",
        lambda task, place, _: write_tflm(task, place),
        find_lack,
    ),
    Peer("emlearn", "emlearn", "emlearn/__init__.py", ("emlearn", "bindings"), ""),
)


def main() -> None:
    """Print the figures of all libraries whose sources are named."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for peer in PEERS:
        parser.add_argument(f"--{peer.option.replace('_', '-')}", type=Path, metavar="DIR")
    places: dict[str, Path | None] = vars(parser.parse_args())
    columns = ("instructions", "flash", "RAM", "stack", "error, %", "largest")
    for kind in KINDS:
        tasks = [draw_task(kind, seed) for seed in SEEDS]
        print(f"{kind.upper()}, {HIDDEN} units, {INPUTS} inputs")
        print(" " * 32 + _line_up(columns))
        for weights in ("int16", "int8"):
            _print(f"zerodrift {weights}", tasks, lambda t, f, w=weights: write_ours(t, w, f))
        for peer in PEERS:
            try_peer(peer, places[peer.option], tasks)


def try_peer(peer: Peer, place: Path | None, tasks: Sequence[Task]) -> None:
    """Print what one library takes, or why there is nothing to print."""
    label = f"  {peer.name:30}"
    if place is None:
        print(f"{label}left out: no --{peer.option.replace('_', '-')}")
        return
    if not (place / peer.needed).is_file():
        print(f"{label}left out: {place} is no checkout of it, {peer.needed} is missing")
        return
    version = tell_version(place)
    if not has_kind(peer, place, tasks[0].kind):
        print(f"{label}has none ({version})")
    elif lack := peer.find_lack(place):
        print(f"{label}left out: {place} {lack} ({version})")
    else:
        write = peer.write
        assert write is not None
        name = f"{peer.name}, {peer.form}"
        _print(name, tasks, lambda t, folder: write(t, place, folder))
        if peer.name == "NNoM" and tasks[0].kind == "gru":  # one shift for biases of two formats
            plain = [task.without_inner_bias() for task in tasks]
            _print("  inner bias 0", plain, lambda t, folder: write(t, place, folder))
        if peer.name == "TFLM" and all(file.is_file() for file in list_libraries(place, CMSIS)):
            _print(
                "  by CMSIS-NN's kernels", tasks, lambda t, _: write_tflm(t, place, CMSIS)
            )  # which begin every call from a state of zero
        print(f"  {'':30}{version}")


def has_kind(peer: Peer, place: Path, kind: str) -> bool:
    """Tell whether a library's operators have a file named after a kind of layer."""
    files = (f for folder in peer.sources for f in (place / folder).rglob("*"))
    return any(_WORDS[kind].search(f.stem) for f in files if f.suffix in (".c", ".cc", ".h", ".py"))


def tell_version(place: Path) -> str:
    """Return a checkout's version and date, by git."""
    told = []
    for command in (("describe", "--tags", "--always"), ("log", "-1", "--format=%cs")):
        done = subprocess.run(
            ["git", "-C", place, *command], capture_output=True, text=True, check=False
        )
        told.append(done.stdout.strip())
    return ", ".join(filter(None, told)) or "of no known version"


def _print(label: str, tasks: Sequence[Task], write: Callable[[Task, Path], Program]) -> None:
    """Measure a library on all layers and print a row of the table."""
    found = []
    for task in tasks:
        with tempfile.TemporaryDirectory() as scratch:
            found.append(measure(task, write(task, Path(scratch)), Path(scratch)))
    print(f"  {label:30}{render(found)}", flush=True)


def render(found: Sequence[Figures]) -> str:
    """Return a row of the table from a library's figures on each layer."""
    errors = [f.error_pct for f in found]
    columns = (
        f"{median(f.instructions for f in found):.0f}",
        f"{median(f.flash_bytes for f in found):.0f}",
        f"{median(f.ram_bytes for f in found):.0f}",
        f"{max(f.stack_bytes for f in found)}",
        f"{median(errors):.3f}",
        f"{max(errors):.3f}",
    )
    different, numbers = sum(f.different for f in found), sum(f.numbers for f in found)
    host = f"{different} of {numbers} differ" if different else "the same"
    return f"{_line_up(columns)}  host: {host}"


def _line_up(columns: Sequence[str]) -> str:
    return " ".join(f"{c:>{w}}" for c, w in zip(columns, WIDTHS, strict=True))


if __name__ == "__main__":
    main()
