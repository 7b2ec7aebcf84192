"""A layer normalisation, which stands for itself (integer-layers.md, section 4).

What the C of a model hands it, with which constants, and what it does with the results is shown.
That its own C, in zd_layer_norm.h, is the specification is tested bit by bit against the
reference, not proven. The numbers here are computed from the specification's text alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isqrt

from zerodrift_proof.equality.machine import TermMachine
from zerodrift_proof.equality.memory import AddressOf, Found, Instance
from zerodrift_proof.equality.rules import as_place, exact, list_numbers
from zerodrift_proof.equality.terms import Opaque, Terms, UndecidedError, Whole

NORM_TESTED = "its C was compared with the reference bit by bit; it is not derived"
"""Why it is told as tested."""


@dataclass(frozen=True)
class Normalisation:
    """The numbers of a layer normalisation."""

    align: tuple[int, ...]
    gain: tuple[int, ...]
    shift: tuple[int, ...]
    bias: tuple[int, ...]
    epsilon: int

    @property
    def root(self) -> int:
        """sqrt(M) in Q26, downwards."""
        return isqrt(len(self.align) << 52)


def list_norm_constants(count: int) -> tuple[int, int, int]:
    """Return reciprocal, its shift and root for so many numbers."""
    shift = 26 + count.bit_length()
    return (2**shift + count // 2) // count, shift, isqrt(count << 52)


def compute_norm(norm: Normalisation, x: Sequence[int]) -> list[int]:
    """Return the results for int16 copies."""
    count = len(x)
    reciprocal, mean_shift, root = list_norm_constants(count)
    v = [_round(n * 4096, by) for n, by in zip(x, norm.align, strict=True)]
    mean = _round(sum(v) * reciprocal, mean_shift)
    squares = norm.epsilon + sum((n - mean) ** 2 for n in v)
    doublings = (62 - squares.bit_length()) // 2 * 2
    a = squares << doublings >> 32
    r = 1143535043 - (652298158 * a >> 30)
    for _ in range(4):
        r = r * (1610612736 - ((r * r >> 29) * a >> 30)) >> 30
    scale = r * root >> 29
    found = []
    rows = zip(v, norm.gain, norm.shift, norm.bias, strict=True)
    for n, gain, shift, bias in rows:
        part = _round((n - mean) * scale, 31 - doublings // 2)
        found.append(_round(part * gain, shift) + bias)
    return found


def _round(x: int, by: int) -> int:
    return (x + (1 << by >> 1)) >> by


def say_norm(terms: Terms, norm: Normalisation, x: Sequence[Whole]) -> list[Whole]:
    """Return the results, each a function of all copies and of the layer's numbers."""
    row = terms.row(x)

    def make(i: int) -> Opaque:
        product = (norm.root + 8) * abs(norm.gain[i]) + (1 << norm.shift[i] >> 1)
        most = (product >> norm.shift[i]) + 1 + abs(norm.bias[i])
        return Opaque(
            f"{i} of {norm}", lambda _: (-most, most), lambda given: compute_norm(norm, given)[i]
        )

    return [terms.call(make(i), x, row) for i in range(len(x))]


def run_norm(told: Callable[[str], None]) -> Callable[[TermMachine, list[Found]], Found]:
    """Return the rule of `zd_layer_norm`; `told` is given the name of each layer."""

    def rule(machine: TermMachine, arguments: list[Found]) -> Found:
        address, x, y, width = arguments
        if not isinstance(address, AddressOf) or address.of.type != "zd_layer_norm_t":
            raise UndecidedError("no constants of a layer normalisation")
        count, norm = exact(width), _read(address.of)
        if any(len(row) != count for row in (norm.align, norm.gain, norm.shift, norm.bias)):
            raise UndecidedError(f"{address.of.name}: its tables do not have {count} numbers")
        given = machine.cells(as_place(x, "int16_t"), count)
        place = as_place(y, "int32_t")
        first = place.at.exact
        if first is None or first + count > len(place.block.cells):
            raise UndecidedError(f"where in {place.block.name} is written")
        for k, value in enumerate(say_norm(machine.terms, norm, given)):
            machine.write(place.block, first + k, value)
        told(address.of.name.removesuffix("_p"))
        return None

    return rule


def _read(constants: Instance) -> Normalisation:
    rows = [tuple(list_numbers(constants, n)) for n in ("align", "gain", "shift", "bias")]
    epsilon, *single = (
        _read_number(constants, name) for name in ("epsilon", "reciprocal", "mean_shift", "root")
    )
    if tuple(single) != list_norm_constants(len(rows[0])):
        raise UndecidedError(f"{constants.name}: its constants are not those of its width")
    return Normalisation(rows[0], rows[1], rows[2], rows[3], epsilon)


def _read_number(constants: Instance, name: str) -> int:
    (cell,) = constants.fields[name].cells
    if not isinstance(cell, Whole) or cell.exact is None:
        raise UndecidedError(f"{constants.name}.{name} is not known")
    return cell.exact
