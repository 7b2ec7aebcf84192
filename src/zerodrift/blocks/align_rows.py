"""How rows get a common format: features, dense layers, head, answer. Rules of `align`."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.blocks.align_signals import Aligned, choose_row_shift, rescale, rescale_bias
from zerodrift.operations.arithmetic import INT16_MAX
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.node import IntegerNode

ROW_BIAS = 2**29
"""A dense row's bias is at most this, and its weights reach 2^31 - 1 less it: a row that needs
more gets a shift of one less."""
SHARED_BITS = 6
"""All outputs have one shift where none loses more bits of its coefficients' 31 by it: their rows
are then a loop where the C is compiled for size, in a third of the flash."""


def align_features(
    nodes: list[IntegerFeatures], coarser: list[list[int]], design: IntegerFeatures | None
) -> Aligned:
    """Rows keep their shifts; missing ones are zero."""
    width = _choose_width(nodes, design)
    out: list[IntegerNode] = []
    for node, by in zip(nodes, coarser, strict=True):
        matrix = node.matrix.astype(object) * np.array([1 << d for d in by], dtype=object)
        rows, biases, shifts = [], [], []
        for row, bias, shift in zip(matrix.tolist(), node.bias.tolist(), node.shift, strict=True):
            to = choose_row_shift([(shift, row)], node.name)
            rows.append([rescale(c, to - shift) for c in row])
            biases.append(rescale_bias(bias, shift, to))
            shifts.append(to)
        pad = width - node.width
        filled = np.array(rows + [[0] * len(by)] * pad, dtype=np.int32).reshape(width, len(by))
        out.append(
            replace(
                node,
                matrix=filled,
                bias=np.array(biases + [0] * pad, dtype=np.int64),
                shift=(*shifts, *[0] * pad),
            )
        )
    return Aligned(out, [0] * len(nodes))


def _choose_width(nodes: Sequence[IntegerNode], design: IntegerNode | None) -> int:
    width = max(n.width for n in nodes)
    if design is None:
        return width
    if width > design.width:
        raise CheckError(
            f"operation '{nodes[0].name}': the unit has {width} rows, its design"
            f" {design.width}. Make a new design from all units, or limit `hidden`."
        )
    return design.width


def align_dense(
    nodes: list[IntegerDense], coarser: list[list[int]], design: IntegerDense | None
) -> Aligned:
    """Rows keep their shifts; missing ones, and weights of missing inputs, are zero."""
    first = nodes[0]
    if any(n.activation != "tanh" for n in nodes):
        raise CheckError(
            f"operation '{first.name}': a layer with '{first.activation}' cannot stand in a block"
            ' yet. Use tanh, or a program per unit (`[firmware] coefficients = "constants"`).'
        )
    width = _choose_width(nodes, design)
    columns = max(n.weights.shape[1] for n in (*nodes, *([] if design is None else [design])))
    out: list[IntegerNode] = []
    for node in nodes:
        rows, biases, shifts = [], [], []
        for row, bias, shift in zip(
            node.weights.tolist(), node.bias.tolist(), node.shift, strict=True
        ):
            to = shift
            while shift - to < 2 and to > 0 and not fits_row(row, bias, shift, to):
                to -= 1
            if not fits_row(row, bias, shift, to):
                raise CheckError(f"operation '{node.name}': a row does not fit 32 bits")
            rows.append([rescale(w, to - shift) for w in row] + [0] * (columns - len(row)))
            biases.append(rescale_bias(bias, shift, to))
            shifts.append(to)
        pad = width - node.width
        out.append(
            replace(
                node,
                weights=np.array(rows + [[0] * columns] * pad, dtype=np.int16),
                bias=np.array(biases + [0] * pad, dtype=np.int32),
                shift=(*shifts, *[0] * pad),
            )
        )
    return Aligned(out, [0] * len(nodes))


def most_norm(magnitude: int, bias: int = 0) -> int:
    """Return the largest L1 norm of a row of 32-bit sums over inputs up to a magnitude."""
    return (2**31 - 1 - bias) // magnitude


def fits_row(row: Sequence[int], bias: int, shift: int, to: int) -> bool:
    """Return whether a dense row fits the split of its 32 bits at another shift."""
    norm = sum(abs(rescale(w, to - shift)) for w in row)
    return (
        abs(rescale_bias(bias, shift, to)) <= ROW_BIAS
        and norm <= most_norm(2**15, ROW_BIAS)
        and max(map(abs, row), default=0) <= INT16_MAX
    )


def align_head(
    nodes: list[IntegerHead], coarser: list[list[int]], design: IntegerHead | None
) -> Aligned:
    """Return heads of one width; weights of missing inputs are zero."""
    columns = max(n.weights.shape[1] for n in (*nodes, *([] if design is None else [design])))
    out: list[IntegerNode] = [replace(n, weights=_pad_columns(n.weights, columns)) for n in nodes]
    return Aligned(out, [0] * len(nodes))


def _pad_columns(matrix: NDArray[np.int16], columns: int) -> NDArray[np.int16]:
    return np.pad(matrix, ((0, 0), (0, columns - matrix.shape[1])))


def align_drift(
    nodes: list[IntegerDrift], coarser: list[list[int]], design: IntegerDrift | None
) -> Aligned:
    """Return answers with one shift per output, or one for all where that costs little."""
    shifts = []
    scaled = []
    for node, by in zip(nodes, coarser, strict=True):
        signals = by[:-1] if node.head else by
        matrix = node.coefficients.astype(object)
        scaled.append(matrix * np.array([1 << d for d in signals], dtype=object))
    for k in range(nodes[0].width):
        rows = [
            (n.shift[k], [*matrix[k].tolist(), int(n.head_coefficients[k])])
            for n, matrix in zip(nodes, scaled, strict=True)
        ]
        own = choose_row_shift(rows, f"drift[{k}]")
        shifts.append(own if design is None else design.shift[k])
    if design is None and max(shifts) - min(shifts) <= SHARED_BITS:
        shifts = [min(shifts)] * len(shifts)
    out: list[IntegerNode] = []
    for node, matrix in zip(nodes, scaled, strict=True):
        by_row = [to - s for to, s in zip(shifts, node.shift, strict=True)]
        out.append(
            replace(
                node,
                coefficients=np.array(
                    [
                        [rescale(c, d) for c in r]
                        for r, d in zip(matrix.tolist(), by_row, strict=True)
                    ],
                    dtype=np.int64,
                ).reshape(node.coefficients.shape),
                head_coefficients=np.array(
                    [
                        rescale(int(c), d)
                        for c, d in zip(node.head_coefficients, by_row, strict=True)
                    ],
                    dtype=np.int64,
                ),
                bias=np.array(
                    [
                        rescale_bias(int(b), s, to)
                        for b, s, to in zip(node.bias, node.shift, shifts, strict=True)
                    ],
                    dtype=np.int64,
                ),
                shift=tuple(shifts),
            )
        )
    return Aligned(out, [0] * len(nodes))
