"""Many units' integer models in one fixed-point format: the same shifts, the same sizes.

A unit's integers represent q * scale. Where the units' shifts differ, a common one is chosen and
coefficients are rescaled, rounded once; that costs about one of their thirty bits. Where a signal
itself gets coarser by 2^d (only after a product, whose shift is its scale), d is passed on to all
nodes that read it. Rows of matrices keep their own shifts, which are stored in the block.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.blocks.gru import align_layers, find_obstacle, refine, visit
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, INT32_MIN
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense, IntegerFeatureDense
from zerodrift.operations.difference import IntegerDifference
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.offset import IntegerOffset
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.recurrent import IntegerRecurrent
from zerodrift.operations.sum import IntegerSum

# How signals get a common format: inputs, products, low-passes, sums. The rules of `align`.

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


InputOrLoad = TypeVar("InputOrLoad", IntegerInput, IntegerLoad)


def align_input(
    nodes: list[InputOrLoad], coarser: list[list[int]], design: InputOrLoad | None
) -> Aligned:
    """Return inputs or loads that are shifted by no more than any unit has room for."""
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


# How rows get a common format: features, dense layers, head, answer. Rules of `align`.

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


# Limits that only some units need: where a unit's range lies within a limit, its model has none.
#
# A design has one program, so that the other units get the limit too, as wide as the number's type,
# which changes no value.

Readers = frozenset[int]


@dataclass(frozen=True)
class _Shape:
    """A model with its limits apart."""

    plain: tuple[IntegerNode, ...]
    """Its nodes but the limits."""
    reads: tuple[tuple[int, ...], ...]
    """Of each of them the numbers of those that it reads, be it through a limit."""
    clips: Mapping[tuple[int, Readers], IntegerClip]
    """(what is limited, who reads it limited) -> the limit."""


def share_clips(
    models: Sequence[IntegerModel], design: IntegerModel | None = None
) -> list[IntegerModel]:
    """Return the models with each limit that any of them, or their design, has.

    Models that differ in more than that come back as they are, as do models that do not differ.

    Args:
        models: of units; one at least.
        design: of the format that they are to have; what it lacks is not added to it.
    """
    alike = [*models, design] if design is not None else list(models)
    if len({tuple((n.name, n.inputs) for n in model.nodes) for model in alike}) == 1:
        return list(models)
    shapes = [_take_apart(model) for model in alike]
    found = [shape for shape in shapes if shape is not None]
    if len(found) < len(shapes):
        return list(models)
    first = found[-1] if design is not None else max(found, key=lambda shape: len(shape.clips))
    kinds = [[node.kind for node in shape.plain] for shape in found]
    if any(kind != kinds[0] for kind in kinds) or any(s.reads != first.reads for s in found):
        return list(models)
    wanted = dict(first.clips)
    if design is None:
        for shape in found:
            for (source, readers), node in shape.clips.items():
                name = f"{first.plain[source].name}_{node.kind}"
                wanted.setdefault((source, readers), replace(node, name=name))
    if any(shape.clips.keys() - wanted.keys() for shape in found):
        return list(models)
    if len({source for source, _ in wanted}) < len(wanted):
        return list(models)
    return [
        replace(model, nodes=_put_together(shape, first, wanted))
        for model, shape in zip(models, found, strict=False)
    ]


def _take_apart(model: IntegerModel) -> _Shape | None:
    """Return a model's shape; None where a limit reads a limit."""
    plain = tuple(node for node in model.nodes if not isinstance(node, IntegerClip))
    clips = {node.name: node for node in model.nodes if isinstance(node, IntegerClip)}
    number = {node.name: k for k, node in enumerate(plain)}
    if any(clip.inputs[0] in clips for clip in clips.values()):
        return None
    reads = tuple(
        tuple(number[clips[name].inputs[0] if name in clips else name] for name in node.inputs)
        for node in plain
    )
    found = {
        (
            number[clip.inputs[0]],
            frozenset(k for k, node in enumerate(plain) if name in node.inputs),
        ): clip
        for name, clip in clips.items()
    }
    return _Shape(plain, reads, found) if len(found) == len(clips) else None


def _put_together(
    shape: _Shape, names: _Shape, wanted: Mapping[tuple[int, Readers], IntegerClip]
) -> tuple[IntegerNode, ...]:
    """Return a unit's nodes under the names of the design, with all limits."""
    nodes: list[IntegerNode] = []
    limited = {(source, k): clip for (source, readers), clip in wanted.items() for k in readers}
    for k, node in enumerate(shape.plain):
        inputs = tuple(
            limited[source, k].name if (source, k) in limited else names.plain[source].name
            for source in shape.reads[k]
        )
        nodes.append(replace(node, name=names.plain[k].name, inputs=inputs))
        for (source, readers), clip in wanted.items():
            if source == k:
                own = shape.clips.get((source, readers))
                low, high = (own.low, own.high) if own is not None else (INT32_MIN, INT32_MAX)
                here = (names.plain[k].name,)
                nodes.append(IntegerClip(clip.name, here, low, high))
    return tuple(nodes)


# Many units' integer models in one fixed-point format: the same shifts, the same sizes.

Node = TypeVar("Node", bound=IntegerNode)


def align(
    models: Sequence[IntegerModel], design: IntegerModel | None = None, margin: float = 0.0
) -> list[IntegerModel]:
    """Return the models in one format.

    Args:
        models: of units of one design; one at least.
        design: a model of the format that they are to have; None: the finest that all can have.
        margin: without a design, by how much a later unit's recurrent weights may be larger as a
            share, if there is but one unit; the more there are, the less room is left.

    Raises:
        CheckError: they are not of one design, or do not fit its format; says what differs.
    """
    models = share_clips(models, design)
    _require_alike([*models, design] if design is not None else list(models))
    coarser: list[dict[str, int]] = [{} for _ in models]
    aligned: list[list[IntegerNode]] = [[] for _ in models]
    for place, first in enumerate(models[0].nodes):
        units = [model.nodes[place] for model in models]
        wanted = design.nodes[place] if design is not None else None
        by = [[known[name] for name in first.inputs] for known in coarser]
        found = (
            _align_recurrent(models, units, wanted, margin)
            if isinstance(first, IntegerRecurrent)
            else _align_nodes(units, by, wanted)
        )
        for unit, node in enumerate(found.nodes):
            aligned[unit].append(node)
            coarser[unit][node.name] = found.coarser[unit]
    warm_up = max(model.guards.warm_up_steps for model in models)
    if design is not None:
        if warm_up > design.guards.warm_up_steps:
            raise CheckError(
                f"the unit warms up over {warm_up} steps, its design over"
                f" {design.guards.warm_up_steps}. Make a new design from all units."
            )
        warm_up = design.guards.warm_up_steps
    return [
        replace(model, nodes=tuple(nodes), guards=replace(model.guards, warm_up_steps=warm_up))
        for model, nodes in zip(models, aligned, strict=True)
    ]


def _require_alike(models: Sequence[IntegerModel]) -> None:
    """Refuse models whose programs could not be one.

    Raises:
        CheckError: names what differs and what to do.
    """
    first = models[0]
    for model in models[1:]:
        for what, one, other in (
            ("sample period", first.sample_period_s, model.sample_period_s),
            ("kind of step", first.variable_step, model.variable_step),
            ("inputs", first.channels, model.channels),
            ("outputs", first.outputs, model.outputs),
            ("guard of the state", first.guarded, model.guarded),
            (
                "inputs with a range",
                [c for c, _, _ in first.guards.ranges],
                [c for c, _, _ in model.guards.ranges],
            ),
        ):
            if one != other:
                raise CheckError(
                    f"units of one design need the same {what}; found {one} and {other}. State"
                    " the codes (`raw`, `lsb`, `range`) in the column's table, and the same in all."
                )
        shapes = [[(n.kind, n.name, n.inputs) for n in m.nodes] for m in (first, model)]
        if shapes[0] != shapes[1]:
            where = next(
                (
                    f"{a[0]} '{a[1]}' and {b[0]} '{b[1]}'"
                    for a, b in zip(*shapes, strict=False)
                    if a != b
                ),
                f"{len(shapes[0])} and {len(shapes[1])} operations",
            )
            raise CheckError(
                f"units of one design need the same operations; found {where}. Their effects or"
                " the lags of their networks differ: hold what differs in zerodrift.toml, or give"
                ' the unit a program of its own (`[firmware] coefficients = "constants"`).'
            )


def _align_nodes(
    nodes: list[IntegerNode], coarser: list[list[int]], design: IntegerNode | None
) -> Aligned:
    rule = RULES.get(type(nodes[0]))
    if rule is not None:
        return rule(nodes, coarser, design)
    for node in [*nodes, *([] if design is None else [design])]:
        if node is not nodes[0] and not equal(nodes[0], node):
            raise CheckError(
                f"operation '{node.name}' ({node.kind}) differs between units, and a block cannot"
                " hold its numbers yet. Hold its parameters in zerodrift.toml, or give the unit a"
                ' program of its own (`[firmware] coefficients = "constants"`).'
            )
    if any(by != coarser[0] or any(by) for by in coarser):
        raise CheckError(
            f"operation '{nodes[0].name}' ({nodes[0].kind}) reads a signal whose format differs"
            " between units. Give the unit a program of its own"
            ' (`[firmware] coefficients = "constants"`).'
        )
    return Aligned(nodes, [0] * len(nodes))


def _align_recurrent(
    models: Sequence[IntegerModel],
    nodes: list[IntegerNode],
    design: IntegerNode | None,
    margin: float,
) -> Aligned:
    """Bring GRUs to one shift per gate; what no block can hold is refused.

    For a design's format each unit's rows are rounded together; to find it they need not be.
    """
    layers: list[IntegerGruLayer] = []
    for node in [*nodes, *([] if design is None else [design])]:
        why = find_obstacle(node)
        if why or not isinstance(node, IntegerGruLayer):
            raise CheckError(
                f"operation '{node.name}' ({node.kind}): {why}. Or use [network] kind = \"gru\" or"
                ' "lag_bank", or a program per unit (`[firmware] coefficients = "constants"`).'
            )
        layers.append(node)
    if len({layer.window for layer in layers}) > 1:
        raise CheckError(
            f"operation '{nodes[0].name}': units of one design need the same `memory`; found"
            f" windows of {sorted({layer.window for layer in layers})}."
        )
    own = layers[: len(nodes)]
    wanted = layers[-1].gru if design is not None else None
    room = margin / len(own)
    grus = align_layers([n.gru for n in own], nodes[0].name, wanted, room)
    if design is not None:
        grus = [
            gru if gru.shift == n.gru.shift else refine(n.gru, gru, visit(model, n))
            for model, n, gru in zip(models, own, grus, strict=True)
        ]
    out: list[IntegerNode] = [replace(n, gru=gru) for n, gru in zip(own, grus, strict=True)]
    return Aligned(out, [0] * len(nodes))


Rule = Callable[[list[IntegerNode], list[list[int]], IntegerNode | None], Aligned]


def _rule(of: Callable[[list[Node], list[list[int]], Node | None], Aligned]) -> Rule:
    return cast(Rule, of)  # it is called with nodes of its own type alone


RULES: dict[type[IntegerNode], Rule] = {
    IntegerInput: _rule(align_input),
    IntegerLoad: _rule(align_input),
    IntegerExp2: _rule(align_exp2),
    IntegerPlay: _rule(align_play),
    IntegerDelay: _rule(align_delay),
    IntegerOffset: _rule(align_offset),
    IntegerClip: _rule(align_clip),
    IntegerDifference: _rule(pass_on),
    IntegerProduct: _rule(align_product),
    IntegerLowpass: _rule(align_lowpass),
    IntegerLowpassAfter: _rule(align_lowpass_after),
    IntegerSum: _rule(align_sum),
    IntegerFeatures: _rule(align_features),
    IntegerDense: _rule(align_dense),
    IntegerFeatureDense: _rule(align_dense),
    IntegerHead: _rule(align_head),
    IntegerDrift: _rule(align_drift),
}
