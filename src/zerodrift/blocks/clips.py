"""Limits that only some units need: where a unit's range lies within a limit, its model has none.

A design has one program, so that the other units get the limit too, as wide as the number's type,
which changes no value.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.node import IntegerNode

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
