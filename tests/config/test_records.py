"""Dataclasses come back from JSON as they were, and nothing of another type is let in."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Optional, TypeVar, Union

import numpy as np
import pytest
from numpy.typing import NDArray

from zerodrift.base.records import OPTIONAL, from_json, take_apart, to_dict


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


@dataclass(frozen=True)
class Arrays:
    floats: NDArray[np.float64]
    codes: NDArray[np.int16] | NDArray[np.int8]
    scales: NDArray[np.int32] | None = None


def test_arrays_come_back_with_their_type() -> None:
    for scales in (None, np.arange(6, dtype=np.int32).reshape(2, 3)):
        for codes in (np.int16, np.int8):
            arrays = Arrays(np.array([[1.5, 2.0]]), np.array([[1, -2]], codes), scales)
            told = json.loads(json.dumps(to_dict(arrays)))
            assert told["floats"] == [[1.5, 2.0]]
            read = from_json(Arrays, told, exact=True)
            for one in ("floats", "codes", "scales"):
                np.testing.assert_array_equal(getattr(read, one), getattr(arrays, one), strict=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dtype": "int64"}, "codes: array of 'int64'.*expected integers of type int8"),
        ({"shape": [3]}, "codes: 2 entries do not fill shape"),
        ({"shape": [-2]}, "codes: array of 'int16' with shape"),
        ({"data": [1, 2**15]}, "codes: an entry does not fit int16"),
        ({"data": [1, True]}, "codes: 2 entries do not fill shape"),
        ({"data": 3}, "codes: no entries do not fill shape"),
    ],
)
def test_array_of_integers_of_another_form_is_refused(change: dict[str, Any], words: str) -> None:
    told = to_dict(Arrays(np.zeros(2), np.zeros(2, np.int16)))
    assert isinstance(told["codes"], dict)
    with pytest.raises(ValueError, match=words):
        from_json(Arrays, {**told, "codes": {**told["codes"], **change}})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"more": 1}, "it has 'more' too"),
        ({"sound": ...}, "it lacks 'sound'"),
        ({"leaves": {"a": {"name": "x", "values": []}}}, r"leaves\['a'\].*it lacks 'pair'"),
        ({"leaves": {"a": {"name": "x", "values": [float("inf")], "pair": None}}}, "is inf"),
    ],
)
def test_exact_reading_refuses_what_is_never_written(change: dict[str, Any], words: str) -> None:
    body = {k: v for k, v in {**to_dict(TREE), **change}.items() if v is not ...}
    with pytest.raises(ValueError, match=words):
        from_json(Tree, body, exact=True)
    if "sound" in body:
        from_json(Tree, body)


def test_annotations_mean_the_same_in_every_spelling() -> None:
    typing_extensions = pytest.importorskip("typing_extensions")
    one = TypeVar("one", bound=np.generic)
    body = np.ndarray[tuple[Any, ...], np.dtype[one]]  # type: ignore[valid-type]
    alias = typing_extensions.TypeAliasType("alias", body, type_params=(one,))
    number = typing_extensions.TypeAliasType("number", int)
    assert take_apart(alias[np.int16]) == take_apart(NDArray[np.int16]) == (np.ndarray, (np.int16,))
    assert take_apart(number) == take_apart(int) == (int, ())
    for optional in (int | None, Optional[int], Union[int, None]):  # noqa: UP007, UP045
        assert take_apart(optional) == (Union, (int, type(None)))
    assert take_apart(dict[str, int]) == take_apart(Mapping[str, int]) == (Mapping, (str, int))


def test_an_annotation_keeps_its_own_order() -> None:
    """`X | None` equals `None | X`: whoever asks first must not decide for the other."""
    assert take_apart(int | None)[1] == (int, type(None))
    assert take_apart(None | int)[1] == (type(None), int)
