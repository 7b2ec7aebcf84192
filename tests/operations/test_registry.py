"""Every operation has every meaning, and the registry finds it by its folder."""

import pytest

from zerodrift.operations.node import IntegerNode
from zerodrift.operations.registry import FOLDERS, NODE_CLASSES, OPERATIONS


@pytest.mark.parametrize("kind", sorted(NODE_CLASSES))
def test_an_integer_node_has_all_of_its_meanings(kind: str) -> None:
    node = NODE_CLASSES[kind]
    assert node.kind == kind
    assert node.__module__.split(".")[2] == FOLDERS[kind]
    for face in ("step", "prove", "write_step", "bound_error"):
        assert getattr(node, face) is not getattr(IntegerNode, face), face
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
