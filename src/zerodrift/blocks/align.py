"""Many units' integer models in one fixed-point format: the same shifts, the same sizes.

A unit's integers represent q * scale. Where the units' shifts differ, a common one is chosen and
coefficients are rescaled, rounded once; that costs about one of their thirty bits. Where a signal
itself gets coarser by 2^d (only after a product, whose shift is its scale), d is passed on to all
nodes that read it. Rows of matrices keep their own shifts, which are stored in the block.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar, cast

from zerodrift.base.errors import CheckError
from zerodrift.blocks.align_rows import align_dense, align_drift, align_features, align_head
from zerodrift.blocks.align_signals import (
    Aligned,
    align_clip,
    align_delay,
    align_exp2,
    align_input,
    align_load,
    align_lowpass,
    align_lowpass_after,
    align_offset,
    align_play,
    align_product,
    align_sum,
    equal,
    pass_on,
)
from zerodrift.blocks.clips import share_clips
from zerodrift.blocks.gru import align_layers, find_obstacle, refine
from zerodrift.blocks.rounding import visit
from zerodrift.export.integer_model import IntegerModel
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
    IntegerLoad: _rule(align_load),
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
