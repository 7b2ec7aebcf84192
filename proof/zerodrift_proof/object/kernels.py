"""A layer's kernel, from a program's bytes: one step of it is the specification's."""

from collections.abc import Sequence

from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30, LayerStep, Numbered
from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.image import Image, Kernel
from zerodrift_proof.object.machine import ObjectMachine
from zerodrift_proof.object.memory import LOWEST, Area
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
