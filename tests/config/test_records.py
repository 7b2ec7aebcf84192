"""Dataclasses come back from JSON as they were, and nothing of another type is let in."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest

from zerodrift.base.records import OPTIONAL, from_json, to_dict


@dataclass(frozen=True)
class Leaf:
    name: str
    values: tuple[float, ...]
    pair: tuple[int, str] | None = None


@dataclass(frozen=True)
class Tree:
    count: int
    sound: bool
    leaves: Mapping[str, Leaf]
    note: str = field(default="", metadata=OPTIONAL)


TREE = Tree(2, True, {"a": Leaf("x", (1.5, 2), (3, "y")), "b": Leaf("z", ())})


@pytest.mark.parametrize("tree", [TREE, Tree(0, False, {}, "kept")])
def test_record_comes_back_as_it_was(tree: Tree) -> None:
    assert from_json(Tree, json.loads(json.dumps(to_dict(tree)))) == tree


def test_keys_stand_in_the_order_of_the_fields_and_an_optional_default_is_left_out() -> None:
    assert list(to_dict(TREE)) == ["count", "sound", "leaves"]
    assert list(to_dict(Tree(0, False, {}, "kept"))) == ["count", "sound", "leaves", "note"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": True}, "count: is True; expected int"),
        ({"count": 2.0}, "count: is 2.0; expected int"),
        ({"count": "2"}, "count: is '2'; expected int"),
        ({"sound": 1}, "sound: is 1; expected bool"),
        ({"leaves": []}, "leaves: is \\[\\]; expected"),
        ({"leaves": {"a": {"name": "x"}}}, r"leaves\['a'\].values: is missing"),
        ({"leaves": {"a": {"name": "x", "values": ["1"]}}}, r"values\[0\]: is '1'; expected float"),
        ({"leaves": {"a": {"name": "x", "values": [], "pair": [1]}}}, "pair: is"),
        ({"leaves": {"a": None}}, "is None; expected Leaf"),
        ({"note": None}, "note: is None; expected str"),
    ],
)
def test_value_of_another_type_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        from_json(Tree, {**to_dict(TREE), **change})
