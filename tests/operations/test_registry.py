"""Every operation has every meaning, and the registry finds it by its folder."""

import pytest

from zerodrift.operations.node import IntegerNode
from zerodrift.operations.registry import FOLDERS, NODE_CLASSES, OPERATIONS

BEFORE = {"conversion": ("convert", "prove", "write", "list_tables")}
"""Kinds that stand before the graph, and their meanings: they are given codes, no nodes' values."""
UNBOUNDED = ("join", "layer_norm")
"""Kinds without a rule of error, which say so: of networks with branches, and where an error of
nearly equal numbers is taken times 1 / sqrt(epsilon), nothing is proven."""


@pytest.mark.parametrize("kind", sorted(NODE_CLASSES))
def test_an_integer_node_has_all_of_its_meanings(kind: str) -> None:
    node = NODE_CLASSES[kind]
    assert node.kind == kind
    assert node.__module__.split(".")[2] == FOLDERS[kind]
    ruled = () if kind in UNBOUNDED else ("bound_error",)
    for face in BEFORE.get(kind, ("step", "prove", "write_step", *ruled)):
        assert getattr(node, face) is not getattr(IntegerNode, face, None), face
    stateful = node.rest is not IntegerNode.rest
    for face in ("write_rest", "list_state"):
        assert (getattr(node, face) is not getattr(IntegerNode, face)) == stateful, face
    settles = node.settle is not IntegerNode.settle
    assert (node.write_settle is not IntegerNode.write_settle) == settles


def test_an_operation_is_found_under_its_own_name() -> None:
    assert {name: operation.name for name, operation in OPERATIONS.items()} == {
        name: name for name in OPERATIONS
    }
    assert {"lowpass", "product", "play"} <= set(OPERATIONS)
