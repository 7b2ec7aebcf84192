"""Kernels in assembly are the specification: from the object code, instruction by instruction.

A layer's kernel, from a program's bytes: one step of it is the specification's.

The model's C is built for a core of each instruction set, or the user's own program is read. Every
kernel in it is run over terms, as bytes say, with any features in their ranges and any state; what
it leaves must be the specification's step. The tables that it reads are the program's own.
"""

import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30, Layers, LayerStep, Numbered
from zerodrift_proof.equality.rules import pack_assembly
from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.image import (
    Image,
    Kernel,
    ProgramError,
    parse_image,
    read_image,
)
from zerodrift_proof.object.machine import LOWEST, Area, ObjectMachine
from zerodrift_proof.object.words import WORD

Ranges = Sequence[tuple[int, int]]


def prove_kernel(
    image: Image, kernel: Kernel, layer: Numbered, ranges: Ranges, relaxing: bool
) -> str:
    """Return where a kernel is no step of a layer; "" where it is one, whatever it is given.

    Args:
        image: the program.
        kernel: where it lies.
        layer: the model's.
        ranges: of each feature, as the model can give it.
        relaxing: towards rest, or in time.
    """
    run = KernelRun(image, kernel, layer, ranges, relaxing)
    try:
        run.machine.call(kernel.at)
    except UndecidedError as error:
        return f"{run.machine.at:#x}: {error}"
    return run.compare()


class KernelRun:
    """A kernel's call: what it is given, and what it must leave."""

    def __init__(
        self, image: Image, kernel: Kernel, layer: Numbered, ranges: Ranges, relaxing: bool
    ) -> None:
        """Set registers and memory as the rules of a call (AAPCS) say."""
        self.machine = machine = ObjectMachine(image)
        self.layer, terms, hidden = layer, machine.terms, layer.hidden
        x = [terms.symbol(f"x[{i}]", low, high) for i, (low, high) in enumerate(ranges)]
        h = [terms.symbol(f"h[{j}]", -H_LIMIT_Q30, H_LIMIT_Q30) for j in range(hidden)]
        c: list[Whole] = []
        if layer.kind == "lstm":
            c = [terms.symbol(f"c[{j}]", -CELL_LIMIT, CELL_LIMIT) for j in range(hidden)]
        self.given = x, h, c
        self.state, self.cell = self._array("h", h), self._array("c", c)
        features = Area("x", self._address("x"), 0, 2 * len(x), 2)
        features.halves = {2 * i: term for i, term in enumerate(x)}
        stack = Area("stack", self._address("stack"), LOWEST, 0, 4, True, 0)
        registers = machine.registers
        registers[0] = terms.constant(kernel.stream)
        registers[1] = machine.memory.give(self.state)
        registers[2] = machine.memory.give(features)
        if layer.kind == "lstm":
            registers[3] = machine.memory.give(self.cell)
            stack.end, stack.words[0] = 4, terms.constant(int(relaxing))
        else:
            registers[3] = terms.constant(0 if relaxing else -1)
        registers[13] = machine.memory.give(stack)
        self.relaxing = relaxing

    def _address(self, name: str) -> Whole:
        return self.machine.terms.symbol(f"address of {name}", 0, WORD - 1)

    def _array(self, name: str, values: Sequence[Whole]) -> Area:
        end = 4 * len(values)
        area = Area(name, self._address(name), 0, end, 4, True, end)
        area.words = {4 * k: term for k, term in enumerate(values)}
        return area

    def compare(self) -> str:
        """Return which number is another than the specification's."""
        machine = self.machine
        wanted = LayerStep(machine.terms, self.layer).run(*self.given, self.relaxing)
        for area, terms in zip((self.state, self.cell), wanted, strict=True):
            for k, term in enumerate(terms):
                found = area.words.get(4 * k)
                if found is None or not self._is_same(found, term):
                    return f"{area.name}[{k}] is another than the specification's"
        return ""

    def _is_same(self, found: Whole, wanted: Whole) -> bool:
        """Return whether a word holds a number, which is known to fit one."""
        exact = self.machine.terms.subtract(found, wanted).exact
        return exact is not None and exact % WORD == 0


ARMV6M, ARMV7EM = 6, 7
"""What the C's ZD_ASSEMBLY says."""


@dataclass(frozen=True)
class ObjectBuild:
    """One way to make object code of the assembly."""

    core: str
    assembly: int
    small: bool = False
    """With the small form of the table of tanh."""
    unaligned: bool = False
    """Whether two features may be read as one word."""

    @property
    def name(self) -> str:
        """As it is told."""
        words = ["small table"] * self.small
        if self.assembly == ARMV7EM and not self.unaligned:
            words.append("aligned")
        return ", ".join([f"object code for {self.core}", *words])

    @property
    def flags(self) -> tuple[str, ...]:
        """What the compiler is told."""
        small = ("-DZD_SMALL",) if self.small else ()
        aligned = self.assembly == ARMV7EM and not self.unaligned
        return (*small, "-mno-unaligned-access") if aligned else small


BUILDS = (
    *(
        ObjectBuild("cortex-m4", ARMV7EM, *two)
        for two in itertools.product((False, True), (True, False))
    ),
    *(ObjectBuild("cortex-m0plus", ARMV6M, small) for small in (False, True)),
)
"""Every text of assembly that the C has."""


class NoCompilerError(Exception):
    """There is no compiler for a core."""


class BuildError(Exception):
    """The C does not compile."""


Builder = Callable[[ObjectBuild], bytes]
"""Builds the model's C, its `settle` and `step` called; returns the linked program."""


@dataclass(frozen=True)
class ShownKernel:
    """A kernel of a program, and whether it is a step of its layer."""

    layer: str
    what: str
    build: str
    why: str
    """Why it is not proven; "" where it is."""


@dataclass
class ProvenKernels:
    """Which layers' assembly is proven, of each way to build it."""

    layers: dict[tuple[int, bool, bool], set[str]] = field(default_factory=dict)
    """(ZD_ASSEMBLY, small, unaligned) -> layers."""

    def add(self, build: ObjectBuild, shown: Sequence[ShownKernel]) -> None:
        """Take over what was shown of a build."""
        found = {one.layer for one in shown} - {one.layer for one in shown if one.why}
        self.layers[build.assembly, build.small, build.unaligned] = found

    def hold(self, defined: Mapping[str, int], layers: Collection[str]) -> bool:
        """Return whether layers are proven of a way through the C's conditions."""
        key = defined.get("ZD_GRU_ASSEMBLY", 0), "ZD_SMALL" in defined, "ZD_UNALIGNED" in defined
        return {*layers} <= self.layers.get(key, set())


def find_assembly(texts: Mapping[str, str], prefix: str, layers: Layers) -> list[str]:
    """Return the layers of which the C has assembly for some core."""
    return [n for n in layers.layers if f"{n}_assembly(" in texts[f"{prefix}.c"]]


def show_builds(
    texts: Mapping[str, str],
    prefix: str,
    layers: Layers,
    build_program: Builder,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[tuple[ObjectBuild, list[ShownKernel]]]:
    """Yield for each build what is shown of the kernels in it.

    Raises:
        NoCompilerError, BuildError: as the builder does.
    """
    if not find_assembly(texts, prefix, layers):
        return
    for build in BUILDS:
        progress(f"proving {build.name}")
        image = parse_image(build.name, build_program(build))
        shown: list[ShownKernel] = []
        for name in layers.layers:
            for kernel in image.find_kernels(name):
                shown.extend(_show_kernel(image, kernel, layers, name, build.name))
        yield build, shown


def check_program(path: Path, source: str) -> None:
    """Raise where a user's program holds no kernel of a model, before anything is proven.

    Args:
        path: the linker's output.
        source: the model's C.

    Raises:
        ProgramError: it is no program for a Cortex-M, is stripped, or holds no kernel of the model.
    """
    names = sorted({*re.findall(r"\b(\w+)_assembly\(", source)})
    if not names:
        raise ProgramError(
            f"{path}: the model has no kernel in assembly; nothing of it is proven from object"
            " code. Leave --elf out: its C is proven."
        )
    image = read_image(path)
    if not any(image.find_kernels(name) for name in names):
        wanted = " or ".join(f"{name}_assembly" for name in names)
        raise ProgramError(
            f"{path}: holds no {wanted} with its table. Its core or its flags take a kernel in C,"
            " or the program does not call the model: build it for Armv6-M, Armv7E-M or Armv8-M"
            " with DSP, without ZD_NO_ASSEMBLY, and keep local symbols (no strip, -s or -Wl,-x)."
        )


def show_program(path: Path, layers: Layers, names: Sequence[str]) -> Iterator[ShownKernel]:
    """Yield what is shown of the kernels in a user's program, which was checked.

    Of several models in one program, it is that whose tables are the model's.

    Args:
        path: the linker's output.
        layers: the model's.
        names: of those that have assembly.
    """
    image = read_image(path)
    for name in names:
        kernels = image.find_kernels(name)
        layer = layers.layers[name]
        own = [k for k in kernels if not _find_difference(image, k, layer)]
        for kernel in own:
            yield from _show_kernel(image, kernel, layers, name, path.name)
        if kernels and not own:
            why = _find_difference(image, kernels[0], layer)
            yield ShownKernel(name, f"{name} in assembly", path.name, why)


def _show_kernel(
    image: Image, kernel: Kernel, layers: Layers, name: str, build: str
) -> Iterator[ShownKernel]:
    for (given, relaxing), ranges in layers.given.items():
        if given == name:
            what = f"{name} in assembly, {'towards rest' if relaxing else 'a step'}"
            why = _prove(image, kernel, layers.layers[name], ranges, relaxing)
            yield ShownKernel(name, what, build, why)


def _prove(image: Image, kernel: Kernel, layer: Numbered, ranges: Ranges, relaxing: bool) -> str:
    return _find_difference(image, kernel, layer) or prove_kernel(
        image, kernel, layer, ranges, relaxing
    )


def _find_difference(image: Image, kernel: Kernel, layer: Numbered) -> str:
    """Return how a kernel's table is another than the model's; "" where it is the same.

    That a kernel computes with other numbers would show in what it leaves; this says why.
    """
    content = image.read(kernel.stream, kernel.stream_bytes)
    if content is None or len(content) % 4:
        return f"{layer.name}_stream is not among the program's constants"
    words = [
        int.from_bytes(content[k : k + 4], "little", signed=True)
        for k in range(0, len(content), 4)
    ]  # fmt: skip
    if pack_assembly(layer) != (words,):
        return (
            f"{layer.name}_stream holds other numbers than model.json: the program was built from"
            " another model or before the last `zerodrift firmware`"
        )
    return ""
