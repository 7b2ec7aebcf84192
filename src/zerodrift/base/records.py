"""Frozen dataclasses to JSON values and back, strictly: values of the wrong type are refused.

A field is a key of its own name. One of metadata `OPTIONAL` is left out where it has its default,
one of metadata `UNWRITTEN` always; of one of metadata `MEASURED`, NaN and infinity, which JSON
lacks, are null. Arrays are lists. A class may have two attributes:

    SCHEMA: ClassVar[str] = "compare/1"      the key `schema`, written first
    ALIASES: ClassVar = ("rmse_heldout",)    properties that are written too: older names
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Literal, TypeAlias, TypeVar, Union, cast, get_args, get_origin, get_type_hints

T = TypeVar("T")

Json: TypeAlias = "dict[str, Json] | list[Json] | str | int | float | bool | None"
"""A JSON value. Read it by `from_json`, not key by key."""

PLAIN = {bool: (bool,), int: (int,), float: (float, int), str: (str,), NoneType: (NoneType,)}
"""What JSON may hold where a plain type is expected; true and false are no numbers."""

OPTIONAL = {"optional": True}
"""Metadata of a field that is left out of the JSON where it has its default."""
UNWRITTEN = {"unwritten": True}
"""Metadata of a field that is never in the JSON and has a default: signals behind figures, say."""
MEASURED = {"measured": True}
"""Metadata of a float, or a mapping to floats, that may be NaN or infinite: null in the JSON, and
NaN where it is read."""
SCHEMA_KEY = "schema"


def to_dict(record: object) -> dict[str, Json]:
    """Return the JSON object of a dataclass."""
    kind = type(record)
    schema = get_schema_name(kind)
    told: dict[str, Json] = {SCHEMA_KEY: schema} if schema else {}
    told |= {
        f.name: _blank(to_json(getattr(record, f.name)), f)
        for f in fields(record)  # type: ignore[arg-type]
        if not f.metadata.get("unwritten")
        and not (f.metadata.get("optional") and getattr(record, f.name) == f.default)
    }
    return told | {name: _null(to_json(getattr(record, name))) for name in get_aliases(kind)}


def _blank(value: Json, one: "Field[object]") -> Json:
    return _null(value) if one.metadata.get("measured") else value


def _null(value: Json) -> Json:
    """Return a number that JSON lacks as null, in a mapping too."""
    if isinstance(value, dict):
        return {key: _null(one) for key, one in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_array(kind: object) -> bool:
    """Return whether this is NumPy's array, which need not be imported to know."""
    return getattr(kind, "__module__", "") == "numpy" and getattr(kind, "__name__", "") == "ndarray"


def get_schema_name(kind: type) -> str:
    """Return what the key `schema` holds for a class; "" where it has none."""
    return str(vars(kind).get("SCHEMA", ""))


def get_aliases(kind: type) -> tuple[str, ...]:
    """Return the properties of a class that are written beside its fields."""
    return tuple(getattr(kind, "ALIASES", ()))


def to_json(value: object) -> Json:
    """Return a dataclass, or a mapping or sequence of such, as JSON values."""
    if is_dataclass(value):
        return to_dict(value)
    if isinstance(value, Mapping):
        return {str(key): to_json(one) for key, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_json(one) for one in value]
    if isinstance(value, (set, frozenset)):
        return [to_json(one) for one in sorted(value)]
    if _is_array(type(value)):
        found: Json = value.tolist()  # type: ignore[attr-defined]
        return found
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def from_json(kind: type[T], value: object, where: str = "") -> T:
    """Return JSON values as a type: a dataclass, Mapping[str, ...], tuple, union or plain type.

    Keys that the type does not have are ignored.

    Args:
        kind: what is expected.
        value: as `to_json` gives it.
        where: of the value, for the error.

    Raises:
        ValueError: something is missing or of another type.
    """
    return cast(T, _read(kind, value, where))


def _read(kind: object, value: object, where: str) -> object:
    """Return a value as a type, which may be an alias such as `tuple[int, ...]`."""
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and kind in PLAIN:
        if type(value) in PLAIN[kind]:
            return value
    elif isinstance(kind, type) and is_dataclass(kind) and isinstance(value, dict):
        return _read_record(kind, value, where)
    elif origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        choices = [one for one in arguments if one is not NoneType]
        fitting = [one for one in choices[:-1] if one in PLAIN and type(value) in PLAIN[one]]
        fitting += [one for one in choices if get_origin(one) is tuple and isinstance(value, list)]
        fitting += [one for one in choices[::-1] if is_dataclass(one) and isinstance(value, dict)]
        return _read(fitting[0] if fitting else choices[-1], value, where)
    elif origin is Literal:
        if value in arguments:
            return value
    elif origin is tuple and isinstance(value, list):
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        if len(kinds) == len(value):
            pairs = zip(kinds, value, strict=True)
            return tuple(_read(k, one, f"{where}[{i}]") for i, (k, one) in enumerate(pairs))
    elif origin in (dict, Mapping) and isinstance(value, dict):
        return {key: _read(arguments[1], one, f"{where}[{key!r}]") for key, one in value.items()}
    elif origin is frozenset and isinstance(value, list):
        return frozenset(_read(arguments[0], one, where) for one in value)
    elif _is_array(origin):
        return _read_array(value, where)
    elif kind is object:
        return value
    expected = getattr(kind, "__name__", str(kind))
    raise ValueError(f"{where or 'it'}: is {value!r:.40}; expected {expected}")


def _read_array(value: object, where: str) -> object:
    """Return lists of numbers as an array of doubles."""
    import numpy as np

    try:
        if isinstance(value, list):
            return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where or 'it'}: {error}") from error
    raise ValueError(f"{where or 'it'}: is {value!r:.40}; expected a list of numbers")


def _read_record(kind: type[T], value: dict[str, object], where: str) -> T:
    read: dict[str, object] = {}
    for one, hint in list_fields(kind):
        place = f"{where}.{one.name}" if where else one.name
        if one.metadata.get("unwritten"):
            continue
        if one.name in value:
            found = value[one.name]
            is_none = found is None and NoneType in get_args(hint)
            if one.metadata.get("measured") and not is_none:
                found = _restore(found)
            read[one.name] = _read(hint, found, place)
        elif one.default is MISSING and one.default_factory is MISSING:
            raise ValueError(f"{place}: is missing")
    return kind(**read)


def _restore(value: object) -> object:
    """Return null as NaN, in a mapping too."""
    if isinstance(value, dict):
        return {key: _restore(one) for key, one in value.items()}
    return math.nan if value is None else value


def list_fields(kind: type) -> tuple[tuple["Field[object]", object], ...]:
    """Return the fields of a dataclass with their types."""
    return _list_fields(kind)


@cache
def _list_fields(kind: type) -> tuple[tuple["Field[object]", object], ...]:
    hints = get_type_hints(kind)
    return tuple((one, hints[one.name]) for one in fields(kind))
