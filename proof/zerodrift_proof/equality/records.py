"""JSON values as frozen dataclasses, strictly: the fields are the keys, and each has its type."""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

Row: TypeAlias = tuple[int, ...]
Table: TypeAlias = tuple[Row, ...]
Cube: TypeAlias = tuple[Table, ...]
"""Whole numbers by one, two and three indices; in the file lists, or an array with its shape."""
T = TypeVar("T")


def read_record(kind: type[T], body: object, where: str) -> T:
    """Return a JSON object as a dataclass.

    Args:
        kind: of fields that are int, float, str, bool, records, tuples of these, or any of them or
            None; a field of type object takes whatever stands there.
        body: as JSON has it.
        where: it stands, for messages.

    Raises:
        ValueError: a key is missing, unknown, or holds something else.
    """
    assert is_dataclass(kind)
    if not isinstance(body, Mapping):
        raise ValueError(f"{where}: is {body!r:.40}; expected an object")
    hints = get_type_hints(kind)
    known = {one.name: one for one in fields(kind)}
    unknown = sorted(body.keys() - known.keys())
    needed = {n for n, one in known.items() if one.default is MISSING}
    missing = sorted(needed - body.keys())
    if unknown or missing:
        raise ValueError(f"{where}: has keys {unknown} that are unknown, and lacks {missing}")
    return kind(**{name: _read(hints[name], body[name], f"{where}.{name}") for name in body})


def _read(kind: object, value: object, where: str) -> object:
    if kind is object:
        return value
    if get_origin(kind) in (Union, UnionType):
        if value is None and NoneType in get_args(kind):
            return None
        (kind,) = (one for one in get_args(kind) if one is not NoneType)
    if kind is float and type(value) in (int, float):
        return value
    if isinstance(kind, type) and is_dataclass(kind):
        return read_record(kind, value, where)
    if get_origin(kind) is tuple:
        return _read_rows(get_args(kind), value, where)
    if type(value) is not kind:
        raise ValueError(f"{where}: is {value!r:.40}; expected {getattr(kind, '__name__', kind)}")
    return value


def _read_rows(kinds: tuple[object, ...], value: object, where: str) -> tuple[object, ...]:
    rows = _unfold(value, where) if isinstance(value, Mapping) else value
    if not isinstance(rows, list):
        raise ValueError(f"{where}: is {value!r:.40}; expected a list")
    if kinds[1:] == (...,):
        kinds = kinds[:1] * len(rows)
    if len(kinds) != len(rows):
        raise ValueError(f"{where}: has {len(rows)} entries; expected {len(kinds)}")
    return tuple(
        _read(kind, one, f"{where}[{i}]")
        for i, (kind, one) in enumerate(zip(kinds, rows, strict=True))
    )


def _unfold(array: Mapping[str, object], where: str) -> list[object]:
    """Return an array, an object of type, shape and numbers row by row, as nested lists."""
    shape, rows = array.get("shape"), array.get("data")
    count = 1
    if not isinstance(shape, list) or not isinstance(rows, list) or not shape:
        raise ValueError(f"{where}: is no array with shape and data")
    for size in shape:
        if type(size) is not int or size < 0:
            raise ValueError(f"{where}: has the shape {shape}")
        count *= size
    if len(rows) != count:
        raise ValueError(f"{where}: has {len(rows)} numbers; the shape {shape} has {count}")
    nested: list[object] = rows
    for size in shape[:0:-1]:
        nested = [nested[k : k + size] for k in range(0, len(nested), size)] if size else []
    return nested
