"""How signals get a common format: inputs, products, low-passes, sums. The rules of `align`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.difference import IntegerDifference
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.offset import IntegerOffset
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.sum import IntegerSum

WIDEST = 2**31 - 1
"""Largest coefficient of a row in a block: it is kept in 32 bits."""


@dataclass(frozen=True)
class Aligned:
    """Nodes in one format, and by how many bits each one's results are coarser than they were."""

    nodes: list[IntegerNode]
    coarser: list[int]


def rescale(number: int, bits: int) -> int:
    """Return number * 2^bits, to the nearest integer, halves upwards."""
    return number << bits if bits >= 0 else (number + (1 << (-bits - 1))) >> -bits


def rescale_bias(bias: int, shift: int, to: int) -> int:
    """Return a bias with its rounding half for another shift."""
    return rescale(bias - (1 << shift >> 1), to - shift) + (1 << to >> 1)


def _limit(number: int, bits: int) -> int:
    """Return a limit of a coarser signal; the ends of int32 stay where they are."""
    return number if number in (INT32_MIN, INT32_MAX) else rescale(number, -bits)


def choose_row_shift(rows: Sequence[tuple[int, Sequence[int]]], where: str) -> int:
    """Return the largest shift at which every row's coefficients fit 32 bits.

    Args:
        rows: (shift, coefficients) of each unit.
        where: names the row in messages.
    """
    fits = []
    for shift, coefficients in rows:
        surplus = 0
        while any(abs(rescale(c, -surplus)) > WIDEST for c in coefficients):
            surplus += 1
        fits.append(shift - surplus)
    if min(fits) < 0:
        raise CheckError(f"{where}: the coefficients do not fit 32 bits; use a coarser output unit")
    return min(fits)


def require_same(nodes: Sequence[IntegerNode], coarser: list[list[int]]) -> list[int]:
    """Return by how much the output is coarser: as every input of it is."""
    for node, by in zip(nodes, coarser, strict=True):
        if len(set(by)) > 1:
            raise CheckError(
                f"operation '{node.name}' reads signals whose formats differ in this unit. Give"
                ' it a program of its own (`[firmware] coefficients = "constants"`).'
            )
    return [by[0] if by else 0 for by in coarser]


def equal(a: IntegerNode, b: IntegerNode) -> bool:
    """Return whether two nodes have the same attributes."""
    one, other = a.attributes(), b.attributes()
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)  # type: ignore[arg-type]


def align_input(
    nodes: list[IntegerInput], coarser: list[list[int]], design: IntegerInput | None
) -> Aligned:
    """Return inputs whose codes are shifted by no more than any unit has room for."""
    shift = _choose_least_shift(nodes, design)
    out: list[IntegerNode] = [replace(n, shift=shift) for n in nodes]
    return Aligned(out, [n.shift - shift for n in nodes])


class _Shifted(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def shift(self) -> int: ...


def _choose_least_shift(nodes: Sequence[_Shifted], design: _Shifted | None) -> int:
    shift = min(n.shift for n in nodes) if design is None else design.shift
    _require_shift(nodes[0], [n.shift for n in nodes], shift)
    return shift


def _require_shift(node: _Shifted, shifts: Sequence[int], wanted: int) -> None:
    if any(shift < wanted for shift in shifts):
        raise CheckError(
            f"operation '{node.name}': the unit needs a coarser format than its design has"
            f" (a shift of {min(shifts)}; {wanted} is fixed). Make a new design from all units."
        )


def align_offset(
    nodes: list[IntegerOffset], coarser: list[list[int]], design: IntegerOffset | None
) -> Aligned:
    """Return offsets in the formats of their signals."""
    by = require_same(nodes, coarser)
    out: list[IntegerNode] = [
        replace(n, offset=rescale(n.offset, -d)) for n, d in zip(nodes, by, strict=True)
    ]
    return Aligned(out, by)


def align_clip(
    nodes: list[IntegerClip], coarser: list[list[int]], design: IntegerClip | None
) -> Aligned:
    """Return limits in the formats of their signals."""
    by = require_same(nodes, coarser)
    out: list[IntegerNode] = [
        replace(n, low=_limit(n.low, d), high=_limit(n.high, d))
        for n, d in zip(nodes, by, strict=True)
    ]
    return Aligned(out, by)


def pass_on(
    nodes: list[IntegerDifference], coarser: list[list[int]], design: IntegerDifference | None
) -> Aligned:
    """Return nodes that hold no numbers: their results are as coarse as what they read."""
    return Aligned(list(nodes), require_same(nodes, coarser))


def align_product(
    nodes: list[IntegerProduct], coarser: list[list[int]], design: IntegerProduct | None
) -> Aligned:
    """The factors are coarser by da + db already; the result becomes as coarse as the coarsest."""
    least = [n.shift - sum(by) for n, by in zip(nodes, coarser, strict=True)]
    shift = max(0, *least) if design is None else design.shift
    if any(s > shift for s in least):
        raise CheckError(
            f"operation '{nodes[0].name}': the unit's range is too wide for its design (a shift of"
            f" {max(least)}; {shift} is fixed). Make a new design from all units."
        )
    by = [shift - s for s in least]
    out: list[IntegerNode] = [
        replace(n, shift=shift, low=_limit(n.low, d), high=_limit(n.high, d))
        for n, d in zip(nodes, by, strict=True)
    ]
    return Aligned(out, by)


def align_load(
    nodes: list[IntegerLoad], coarser: list[list[int]], design: IntegerLoad | None
) -> Aligned:
    """Return loads that are shifted by no more than any unit has room for."""
    shift = _choose_least_shift(nodes, design)
    out: list[IntegerNode] = [replace(n, shift=shift) for n in nodes]
    return Aligned(out, [n.shift - shift for n in nodes])


def align_exp2(
    nodes: list[IntegerExp2], coarser: list[list[int]], design: IntegerExp2 | None
) -> Aligned:
    """The exponent is a row of one; results are as coarse as those of the highest octave."""
    first = nodes[0]
    rows = [(n.shift, [n.coefficient << by[0]]) for n, by in zip(nodes, coarser, strict=True)]
    shift = design.shift if design is not None else choose_row_shift(rows, first.name)
    top = max(n.top for n in nodes) if design is None else design.top
    if any(n.top > top for n in nodes):
        raise CheckError(
            f"operation '{first.name}': the unit's powers of two reach octave"
            f" {max(n.top for n in nodes)}; {top} is fixed. Make a new design from all units."
        )
    low = first.low if design is None else design.low
    if any(n.low != low for n in nodes):
        raise CheckError(
            f"operation '{first.name}': the units' exponents have other lower limits. Give the"
            ' unit a program of its own (`[firmware] coefficients = "constants"`).'
        )
    out: list[IntegerNode] = [
        replace(
            n,
            coefficient=rescale(row[0], shift - n.shift),
            bias=rescale_bias(n.bias, n.shift, shift),
            shift=shift,
            top=top,
        )
        for n, (_, row) in zip(nodes, rows, strict=True)
    ]
    return Aligned(out, [top - n.top for n in nodes])


def align_play(
    nodes: list[IntegerPlay], coarser: list[list[int]], design: IntegerPlay | None
) -> Aligned:
    """Return slacks in the formats of their signals."""
    by = require_same(nodes, coarser)
    out: list[IntegerNode] = [
        replace(n, half_width=rescale(n.half_width, -d)) for n, d in zip(nodes, by, strict=True)
    ]
    return Aligned(out, by)


def align_delay(
    nodes: list[IntegerDelay], coarser: list[list[int]], design: IntegerDelay | None
) -> Aligned:
    """Return delays, which need the same number of steps."""
    steps = sorted({n.steps for n in [*nodes, *([] if design is None else [design])]})
    if len(steps) > 1:
        raise CheckError(
            f"operation '{nodes[0].name}': the units' delays end in different steps ({steps}); a"
            " block holds where in its step a delay ends, the program how many steps it has. Hold"
            " the delay in zerodrift.toml, or give the unit a program of its own"
            ' (`[firmware] coefficients = "constants"`).'
        )
    return Aligned(list(nodes), require_same(nodes, coarser))


def align_lowpass(
    nodes: list[IntegerLowpass], coarser: list[list[int]], design: IntegerLowpass | None
) -> Aligned:
    """Return low-passes with the smallest of their shifts."""
    shift = _choose_least_shift(nodes, design)
    out: list[IntegerNode] = [
        replace(n, shift=shift, m_q31=rescale(n.m_q31, shift - n.shift)) for n in nodes
    ]
    return Aligned(out, require_same(nodes, coarser))


def align_lowpass_after(
    nodes: list[IntegerLowpassAfter], coarser: list[list[int]], design: IntegerLowpassAfter | None
) -> Aligned:
    """Return low-passes of a variable step with the smallest of their shifts."""
    shift = _choose_least_shift(nodes, design)
    out: list[IntegerNode] = [
        replace(n, shift=shift, rate_q31=rescale(n.rate_q31, shift - n.shift)) for n in nodes
    ]
    return Aligned(out, require_same(nodes, coarser))


def is_plain(node: IntegerSum) -> bool:
    """Return whether a sum only changes a sign or a format: it is the same in every unit."""
    return all(abs(c) == 1 for c in node.coefficients)


def align_sum(
    nodes: list[IntegerSum], coarser: list[list[int]], design: IntegerSum | None
) -> Aligned:
    """Return sums with the largest shift at which all coefficients fit 32 bits."""
    same = all(equal(nodes[0], n) for n in [*nodes, *([] if design is None else [design])])
    if same and is_plain(nodes[0]) and not any(any(by) for by in coarser):
        return Aligned(list(nodes), [0] * len(nodes))
    rows = [
        (n.shift, [c << d for c, d in zip(n.coefficients, by, strict=True)])
        for n, by in zip(nodes, coarser, strict=True)
    ]
    shift = design.shift if design is not None else choose_row_shift(rows, nodes[0].name)
    out: list[IntegerNode] = [
        replace(
            n,
            coefficients=tuple(rescale(c, shift - n.shift) for c in row),
            bias=rescale_bias(n.bias, n.shift, shift),
            shift=shift,
        )
        for n, (_, row) in zip(nodes, rows, strict=True)
    ]
    return Aligned(out, [0] * len(nodes))
