"""Which numbers of a model are stored in a block, under which name and in which type."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.blocks.gru import BIASES, STREAM, count_pairs, put_stream, read_stream
from zerodrift.export.integer_model import Guards, IntegerModel
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense
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
from zerodrift.operations.sum import IntegerSum

TYPES = {"i64": "<i8", "i32": "<i4", "i16": "<i2", "u8": "u1"}
"""A field's type and how its numbers lie in a block."""
C_TYPES = {"i64": "int64_t", "i32": "int32_t", "i16": "int16_t", "u8": "uint8_t"}
GUARDS = "guards"
"""The node under which the limits of flags stand."""


@dataclass(frozen=True)
class FieldPlace:
    """Where a number, or an array of them, stands in a model."""

    node: str
    attribute: str
    type: str
    """One of TYPES."""
    sizes: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """Of the field in the block."""
        return self.attribute if self.node == GUARDS else f"{self.node}_{self.attribute}"


def list_places(models: Sequence[IntegerModel]) -> tuple[FieldPlace, ...]:
    """Return what a block of these units holds; all have the same operations and formats.

    Args:
        models: aligned ones (`align`).
    """
    first = models[0]
    places = [
        FieldPlace(GUARDS, "temperature_low", "i32"),
        FieldPlace(GUARDS, "temperature_high", "i32"),
        FieldPlace(GUARDS, "rate_max", "i32"),
    ]
    if first.guards.ranges:
        ranges = (len(first.guards.ranges),)
        places += [FieldPlace(GUARDS, "range_low", "i32", ranges)]
        places += [FieldPlace(GUARDS, "range_high", "i32", ranges)]
    for k in range(len(first.nodes)):
        places += _list_node([model.nodes[k] for model in models], first)
    return tuple(places)


def _list_node(nodes: Sequence[IntegerNode], model: IntegerModel) -> Iterator[FieldPlace]:
    node = nodes[0]
    if isinstance(node, IntegerInput):
        yield FieldPlace(node.name, "low", "i32")
        yield FieldPlace(node.name, "high", "i32")
        if model.channels[node.channel].bits > 16:
            yield FieldPlace(node.name, "origin", "i32")
    elif isinstance(node, IntegerLoad):
        yield FieldPlace(node.name, "low", "i32")
        yield FieldPlace(node.name, "high", "i32")
    elif isinstance(node, IntegerExp2):
        yield FieldPlace(node.name, "coefficient", "i32")
        yield FieldPlace(node.name, "bias", "i64")
        yield FieldPlace(node.name, "high", "i32")
    elif isinstance(node, IntegerPlay):
        yield FieldPlace(node.name, "half_width", "i32")
    elif isinstance(node, IntegerDelay):
        yield FieldPlace(node.name, "newer_q31", "i32")
    elif isinstance(node, IntegerOffset):
        yield FieldPlace(node.name, "offset", "i32")
    elif isinstance(node, IntegerClip):
        yield FieldPlace(node.name, "low", "i32")
        yield FieldPlace(node.name, "high", "i32")
    elif isinstance(node, IntegerProduct):
        yield from _list_limits(nodes)
    elif isinstance(node, IntegerLowpass):
        yield FieldPlace(node.name, "c_q24", "i32")
        yield FieldPlace(node.name, "m_q31", "i32")
    elif isinstance(node, IntegerLowpassAfter):
        yield FieldPlace(node.name, "rate_q31", "i32")
    elif isinstance(node, IntegerSum):
        if any(n.attributes() != node.attributes() for n in nodes) or any(
            abs(c) != 1 for c in node.coefficients
        ):
            yield FieldPlace(node.name, "coefficients", "i32", (len(node.coefficients),))
            yield FieldPlace(node.name, "bias", "i64")
            yield from _list_limits(nodes)
    elif isinstance(node, IntegerFeatures):
        yield FieldPlace(node.name, "matrix", "i32", (node.width, len(node.inputs)))
        yield FieldPlace(node.name, "bias", "i64", (node.width,))
        yield FieldPlace(node.name, "shift", "u8", (node.width,))
    elif isinstance(node, IntegerGruLayer):
        words = BIASES + 3 * sum(count_pairs(node.gru))
        yield FieldPlace(node.name, STREAM, "i32", (node.width, words))
    elif isinstance(node, IntegerDense):
        yield FieldPlace(node.name, "weights", "i16", (node.weights.size,))
        yield FieldPlace(node.name, "bias", "i32", (node.width,))
        yield FieldPlace(node.name, "shift", "u8", (node.width,))
    elif isinstance(node, IntegerHead):
        yield FieldPlace(node.name, "weights", "i16", (node.weights.size,))
    elif isinstance(node, IntegerDrift):
        rows = (node.width,)
        if node.signals:
            yield FieldPlace(node.name, "coefficients", "i32", (node.width, len(node.signals)))
        if node.head:
            yield FieldPlace(node.name, "head_coefficients", "i32", rows)
        yield FieldPlace(node.name, "bias", "i64", rows)
        yield FieldPlace(node.name, "low", "i32", rows)
        yield FieldPlace(node.name, "high", "i32", rows)


def _list_limits(nodes: Sequence[IntegerNode]) -> Iterator[FieldPlace]:
    ends = [(n.low, n.high) for n in nodes if isinstance(n, IntegerProduct | IntegerSum)]
    if any(limits != (INT32_MIN, INT32_MAX) for limits in ends):
        yield FieldPlace(nodes[0].name, "low", "i32")
        yield FieldPlace(nodes[0].name, "high", "i32")


def read(model: IntegerModel, place: FieldPlace) -> IntArray:
    """Return a model's numbers at a place, in its shape."""
    if place.node == GUARDS:
        told = _read_guards(model.guards, place.attribute)
        return np.array(told, dtype=np.int64).reshape(place.sizes)
    node = next(n for n in model.nodes if n.name == place.node)
    if isinstance(node, IntegerGruLayer):
        return read_stream(node.gru)
    return np.array(getattr(node, place.attribute), dtype=np.int64).reshape(place.sizes)


def _read_guards(guards: Guards, attribute: str) -> int | list[int]:
    if attribute in ("range_low", "range_high"):
        end = 1 if attribute == "range_low" else 2
        return [limits[end] for limits in guards.ranges]
    return int(getattr(guards, attribute))


def put(model: IntegerModel, numbers: Mapping[FieldPlace, IntArray]) -> IntegerModel:
    """Return a model with other numbers at places."""
    by_node: dict[str, dict[str, object]] = {}
    guards: dict[str, IntArray] = {}
    for place, found in numbers.items():
        if place.node == GUARDS:
            guards[place.attribute] = found
        else:
            by_node.setdefault(place.node, {})[place.attribute] = found
    nodes = [_put_node(node, by_node.get(node.name, {})) for node in model.nodes]
    return replace(model, nodes=tuple(nodes), guards=_put_guards(model.guards, guards))


def _put_node(node: IntegerNode, numbers: Mapping[str, object]) -> IntegerNode:
    changed: dict[str, object] = {}
    if isinstance(node, IntegerGruLayer) and STREAM in numbers:
        return replace(node, gru=put_stream(node.gru, np.asarray(numbers[STREAM])))
    for name, found in numbers.items():
        before = getattr(node, name)
        if isinstance(before, np.ndarray):
            changed[name] = np.asarray(found).astype(before.dtype).reshape(before.shape)
        elif isinstance(before, tuple):
            changed[name] = tuple(int(n) for n in np.asarray(found).ravel())
        else:
            changed[name] = int(np.asarray(found))
    return replace(node, **changed) if changed else node  # type: ignore[arg-type]  # by field names


def _put_guards(guards: Guards, numbers: Mapping[str, IntArray]) -> Guards:
    for name, found in numbers.items():
        if name in ("range_low", "range_high"):
            end = 1 if name == "range_low" else 2
            ranges = [list(limits) for limits in guards.ranges]
            for limits, number in zip(ranges, found.tolist(), strict=True):
                limits[end] = number
            guards = replace(guards, ranges=tuple((c, low, high) for c, low, high in ranges))
        elif name == "temperature_low":
            guards = replace(guards, temperature_low=int(found))
        elif name == "temperature_high":
            guards = replace(guards, temperature_high=int(found))
        else:
            guards = replace(guards, rate_max=int(found))
    return guards
