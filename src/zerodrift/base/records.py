"""Frozen dataclasses to JSON values and back, strictly: what does not fit its type is refused.

A field is a key of its own name; one of metadata `OPTIONAL` is left out where it has its default.
"""

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")

PLAIN = {bool: (bool,), int: (int,), float: (float, int), str: (str,), NoneType: (NoneType,)}
"""What JSON may hold where a plain type is expected; true and false are no numbers."""

OPTIONAL = {"optional": True}
"""Metadata of a field that is left out of the JSON where it has its default."""


def to_dict(record: object) -> dict[str, Any]:
    """Return the JSON object of a dataclass."""
    return {
        f.name: to_json(getattr(record, f.name))
        for f in fields(record)  # type: ignore[arg-type]
        if not (f.metadata.get("optional") and getattr(record, f.name) == f.default)
    }


def to_json(value: object) -> Any:
    """Return a dataclass, or a mapping or sequence of such, as JSON values."""
    if is_dataclass(value):
        return to_dict(value)
    if isinstance(value, Mapping):
        return {key: to_json(one) for key, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_json(one) for one in value]
    return value


def from_json(kind: type[T], value: object, where: str = "") -> T:
    """Return JSON values as a type: a dataclass, Mapping[str, ...], tuple, union or plain type.

    Keys that the type does not know are passed over.

    Args:
        kind: what is expected.
        value: as `to_json` gives it.
        where: of the value, for the error.

    Raises:
        ValueError: something is missing or of another type.
    """
    read: T = _read(kind, value, where)
    return read


def _read(kind: Any, value: Any, where: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if kind in PLAIN:
        if type(value) in PLAIN[kind]:
            return value
    elif isinstance(kind, type) and is_dataclass(kind) and isinstance(value, dict):
        read = {}
        for one, hint in _list_fields(kind):
            place = f"{where}.{one.name}" if where else one.name
            if one.name in value:
                read[one.name] = _read(hint, value[one.name], place)
            elif one.default is MISSING:
                raise ValueError(f"{place}: is missing")
        return kind(**read)
    elif origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        (kind,) = (one for one in arguments if one is not NoneType)
        return _read(kind, value, where)
    elif origin is tuple and isinstance(value, list):
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        if len(kinds) == len(value):
            pairs = zip(kinds, value, strict=True)
            return tuple(_read(k, one, f"{where}[{i}]") for i, (k, one) in enumerate(pairs))
    elif origin in (dict, Mapping) and isinstance(value, dict):
        return {key: _read(arguments[1], one, f"{where}[{key!r}]") for key, one in value.items()}
    expected = getattr(kind, "__name__", str(kind))
    raise ValueError(f"{where or 'it'}: is {value!r:.40}; expected {expected}")


@cache
def _list_fields(kind: Any) -> tuple[tuple["Field[Any]", Any], ...]:
    """Return the fields of a dataclass with their types."""
    hints = get_type_hints(kind)
    return tuple((one, hints[one.name]) for one in fields(kind))
