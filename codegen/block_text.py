"""A design's model for its C: every number that a block holds is replaced by its field's name."""

from collections.abc import Mapping
from dataclasses import fields as list_dataclass_fields
from dataclasses import replace

import numpy as np

from zerodrift.blocks.block import HEADER_BYTES, MAGIC, find_size
from zerodrift.blocks.design import FORMAT_OF_BLOCK, BlockDesign
from zerodrift.blocks.fields import C_TYPES, GUARDS, TYPES, FieldPlace, put
from zerodrift.blocks.gru import STREAM
from zerodrift.export.integer_model import Guards, IntegerModel
from zerodrift.operations.arithmetic import INT32_MIN
from zerodrift.operations.c_text import FieldNumber, format_int32, format_int64
from zerodrift.operations.node import IntegerNode

TABLES = ("i16", "u8")
"""Types of fields that the C reads as tables, by an index."""


def mark(design: BlockDesign) -> IntegerModel:
    """Return the design's model with the names of fields in the place of numbers.

    It is for templates alone; nothing can be computed with it.
    """
    by_node: dict[str, list[FieldPlace]] = {}
    for field in design.fields:
        by_node.setdefault(field.place.node, []).append(field.place)
    nodes = tuple(_mark_node(n, by_node.get(n.name, [])) for n in design.model.nodes)
    guards = _mark_guards(design.model.guards)
    return replace(design.model, nodes=nodes, guards=guards)


def _mark_node(node: IntegerNode, places: list[FieldPlace]) -> IntegerNode:
    changed: dict[str, object] = {}
    for place in places:
        if place.attribute == STREAM:
            continue  # a layer's kernel reads it
        if place.name in {table.name for table in node.list_tables()}:
            continue  # read by an index
        if not place.sizes:
            changed[place.attribute] = FieldNumber(1, f"b->{place.name}")
            continue
        count = int(np.prod(place.sizes, dtype=np.int64))
        marks = [FieldNumber(1, f"b->{place.name}[{k}]") for k in range(count)]
        if isinstance(getattr(node, place.attribute), tuple):
            changed[place.attribute] = tuple(marks)
        else:
            marked = np.empty(count, dtype=object)
            marked[:] = marks
            changed[place.attribute] = marked.reshape(place.sizes)
    if not changed:
        return node
    known = {f.name for f in list_dataclass_fields(node)}
    assert changed.keys() <= known
    return replace(node, **changed)  # type: ignore[arg-type]  # by field names


def _mark_guards(guards: Guards) -> Guards:
    def field(name: str) -> FieldNumber:
        return FieldNumber(0, f"b->{name}")

    return replace(
        guards,
        temperature_low=field("temperature_low"),
        temperature_high=field("temperature_high"),
        rate_max=field("rate_max"),
        ranges=tuple(
            (channel, field(f"range_low[{k}]"), field(f"range_high[{k}]"))
            for k, (channel, _, _) in enumerate(guards.ranges)
        ),
    )


def list_held(design: BlockDesign) -> frozenset[str]:
    """Return the nodes whose tables, or a recurrent layer's numbers, lie in the block."""
    tables = {table.name: node.name for node in design.model.nodes for table in node.list_tables()}
    return frozenset(
        f.place.node for f in design.fields if f.place.name in tables or f.place.attribute == STREAM
    )


def widen(design: BlockDesign) -> IntegerModel:
    """Return the design's model with the widest limits that a block may have, for the self-test."""
    widest = {
        field.place: np.full(
            field.place.sizes,
            field.low if field.place.attribute.endswith("low") else field.high,
            dtype=np.int64,
        )
        for field in design.fields
        if field.place.node != GUARDS and field.place.attribute in ("low", "high")
    }
    return put(design.model, widest)


def describe_block(design: BlockDesign) -> Mapping[str, object]:
    """Return the variables of a block's templates."""
    used = HEADER_BYTES + 4
    used += sum(
        int(np.prod(f.place.sizes, dtype=np.int64)) * np.dtype(TYPES[f.place.type]).itemsize
        for f in design.fields
    )
    size = find_size(design)
    types = {f.place.type for f in design.fields}
    return {
        "block_bytes": size,
        "block_padding": size - used,
        "block_format": FORMAT_OF_BLOCK,
        "block_magic": MAGIC,
        "block_types": [kind for kind in TYPES if kind in types],
        "block_norms": any(f.norm for f in design.fields),
        "block_streams": any(f.pairs for f in design.fields),
        "field_types": C_TYPES,
    }


def format_bound(value: int, kind: str) -> str:
    """Return a bound of a field as an argument of its type."""
    if kind == "i64":
        return format_int64(value)
    if kind == "u8":
        return f"{value}u"
    return format_int32(max(value, INT32_MIN))


def multiply(sizes: tuple[int, ...]) -> int:
    """Return how many numbers a field has: 1 without sizes."""
    return int(np.prod(sizes, dtype=np.int64))
