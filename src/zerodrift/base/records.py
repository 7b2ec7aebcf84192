"""Frozen dataclasses as JSON: written and read strictly, sealed by a hash, and their schema."""

import ast
import hashlib
import inspect
import json
import math
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cache
from numbers import Integral
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Literal,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


# Frozen dataclasses to JSON values and back, strictly: values of the wrong type are refused.
#
# A field is a key of its own name. One of metadata `OPTIONAL` is left out where it has its default,
# one of metadata `UNWRITTEN` always; of one of metadata `MEASURED`, NaN and infinity, which JSON
# lacks, are null. Arrays of floats are lists; those of integers are objects of `dtype`, `shape` and
# `data`, since their width is part of what they say. A class may have two attributes:
#
#     SCHEMA: ClassVar[str] = "compare/1"      the key `schema`, written first
#     ALIASES: ClassVar = ("rmse_heldout",)    properties that are written too: older names

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
ARRAY_KEYS = {"dtype", "shape", "data"}
"""Of an array of integers."""


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


def is_array(kind: object) -> bool:
    """Return whether this is NumPy's array, which need not be imported to know."""
    return getattr(kind, "__module__", "") == "numpy" and getattr(kind, "__name__", "") == "ndarray"


_apart: dict[int, tuple[object, tuple[object, tuple[object, ...]]]] = {}
"""Identity of an annotation -> the annotation, which so stays alive, and what it is made of."""


def take_apart(kind: object) -> tuple[object, tuple[object, ...]]:
    """Return what an annotation is made of, in whichever way it is spelt and in its own order.

    All that read annotations of fields ask here.

    Returns:
        (origin, arguments): (Union, choices), (Literal, values), (tuple, types), (Mapping, (key,
        value)), (frozenset, (type,)) or (ndarray, (scalar type,)); of a class (class, ()).
    """
    # by identity: `X | None` equals `None | X`, and a cache would answer with the first one's order
    known = _apart.get(id(kind))
    if known is None:
        known = _apart[id(kind)] = (kind, _take_apart(kind))
    return known[1]


def _take_apart(kind: object) -> tuple[object, tuple[object, ...]]:
    origin, arguments = get_origin(kind), get_args(kind)
    meant = getattr(origin or kind, "__value__", None)
    if meant is not None:  # `type NDArray[T] = ...`, as NumPy writes it since 2.5
        return take_apart(meant[arguments] if arguments else meant)
    if is_array(origin):
        return origin, get_args(arguments[1])
    same = {UnionType: Union, dict: Mapping, None: kind}
    return same.get(origin, origin), arguments


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
    if is_array(type(value)):
        return _write_array(cast("NDArray[np.generic]", value))
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Integral):  # NumPy's
        return int(value)
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def _write_array(array: "NDArray[np.generic]") -> Json:
    """Return an array; one of integers with its type."""
    listed: Json = array.tolist()
    if array.dtype.kind != "i":
        return listed
    return {
        "dtype": array.dtype.name,
        "shape": list(array.shape),
        "data": array.ravel().tolist(),
    }


def from_json(kind: type[T], value: object, where: str = "", *, exact: bool = False) -> T:
    """Return JSON values as a type: a dataclass, Mapping[str, ...], tuple, union or plain type.

    Args:
        kind: what is expected.
        value: as `to_json` gives it.
        where: of the value, for the error.
        exact: nothing is let in that `to_json` does not write: no key that the type does not have
            (else ignored), no field left out that has a default, no number that is not finite.

    Raises:
        ValueError: something is missing or of another type.
    """
    return cast(T, _read(kind, value, where, exact))


def _read(kind: object, value: object, where: str, exact: bool) -> object:
    """Return a value as a type, which may be an alias such as `tuple[int, ...]`."""
    origin, arguments = take_apart(kind)
    if isinstance(origin, type) and origin in PLAIN:
        is_finite = not isinstance(value, float) or math.isfinite(value)
        if type(value) in PLAIN[origin] and (is_finite or not exact):
            return value
    elif isinstance(origin, type) and is_dataclass(origin) and isinstance(value, dict):
        return _read_record(origin, value, where, exact)
    elif origin is Union:
        return _read(_choose(arguments, value), value, where, exact)
    elif origin is Literal:
        if value in arguments:
            return value
    elif origin is tuple and isinstance(value, list):
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        if len(kinds) == len(value):
            pairs = zip(kinds, value, strict=True)
            return tuple(_read(k, one, f"{where}[{i}]", exact) for i, (k, one) in enumerate(pairs))
    elif origin is Mapping and isinstance(value, dict):
        of = arguments[1]
        return {key: _read(of, one, f"{where}[{key!r}]", exact) for key, one in value.items()}
    elif origin is frozenset and isinstance(value, list):
        return frozenset(_read(arguments[0], one, where, exact) for one in value)
    elif is_array(origin):
        return _read_array(arguments[0], value, where)
    elif origin is object:
        return value
    expected = getattr(origin, "__name__", str(kind))
    raise ValueError(f"{where or 'it'}: is {value!r:.40}; expected {expected}")


def _choose(choices: tuple[object, ...], value: object) -> object:
    """Return which type of a union a value is of, by its form; the last one that is not None where
    it is of none, so that the error names that."""
    others = [one for one in choices if one is not NoneType]
    if value is None and NoneType in choices:
        return NoneType
    plain = [one for one in others[:-1] if isinstance(one, type) and one in PLAIN]
    fitting: list[object] = [one for one in plain if type(value) in PLAIN[one]]
    if isinstance(value, list):
        fitting += [one for one in others if take_apart(one)[0] is tuple]
    elif isinstance(value, dict):
        fitting += [one for one in others[::-1] if is_dataclass(one)]
        fitting += [one for one in others if _is_array_of(one, value.get("dtype"))]
    return fitting[0] if fitting else others[-1]


def _is_array_of(kind: object, dtype: object) -> bool:
    origin, arguments = take_apart(kind)
    return is_array(origin) and getattr(arguments[0], "__name__", None) == dtype


def _read_array(scalar: object, value: object, where: str) -> object:
    """Return an array of doubles from lists of numbers, or one of integers from its object."""
    import numpy as np

    if isinstance(scalar, type) and issubclass(scalar, np.signedinteger):
        return _read_integers(scalar, value, where)
    try:
        if isinstance(value, list):
            return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where or 'it'}: {error}") from error
    raise ValueError(f"{where or 'it'}: is {value!r:.40}; expected a list of numbers")


def _read_integers(scalar: "type[np.signedinteger]", value: object, where: str) -> object:
    """Return an array of integers whose type, shape and entries are as stated and fit."""
    import numpy as np

    if not isinstance(value, dict) or not set(value) >= ARRAY_KEYS:
        raise ValueError(f"{where}: is {value!r:.40}; expected an array with dtype, shape and data")
    dtype, shape, data = (value[key] for key in ("dtype", "shape", "data"))
    if dtype != scalar.__name__ or not _are_integers(shape) or any(n < 0 for n in shape):
        raise ValueError(
            f"{where}: array of {dtype!r} with shape {shape!r:.40}; expected integers of type "
            f"{scalar.__name__}"
        )
    if not _are_integers(data) or len(data) != math.prod(shape):
        count = len(data) if isinstance(data, list) else "no"
        raise ValueError(f"{where}: {count} entries do not fill shape {shape}")
    info = np.iinfo(scalar)
    if any(v < info.min or v > info.max for v in data):
        raise ValueError(f"{where}: an entry does not fit {dtype}")
    return np.array(data, dtype=scalar).reshape(shape)


def _are_integers(value: object) -> bool:
    return isinstance(value, list) and all(type(one) is int for one in value)


def _read_record(kind: type[T], value: dict[str, object], where: str, exact: bool) -> T:
    written = {one.name: one for one, _ in list_fields(kind) if not one.metadata.get("unwritten")}
    if exact:
        _check_keys(written, value, where)
    read: dict[str, object] = {}
    for one, hint in list_fields(kind):
        place = f"{where}.{one.name}" if where else one.name
        if one.name not in written:
            continue
        if one.name in value:
            found = value[one.name]
            is_none = found is None and NoneType in take_apart(hint)[1]
            if one.metadata.get("measured") and not is_none:
                found = _restore(found)
            read[one.name] = _read(hint, found, place, exact)
        elif one.default is MISSING and one.default_factory is MISSING:
            raise ValueError(f"{place}: is missing")
    return kind(**read)


def _check_keys(
    written: Mapping[str, "Field[object]"], value: dict[str, object], where: str
) -> None:
    """Raise where a record has other keys than those that are written."""
    needed = [key for key, one in written.items() if not one.metadata.get("optional")]
    lacks = [key for key in needed if key not in value]
    beside = [key for key in value if key not in written]
    if lacks or beside:
        told = [f"lacks {', '.join(map(repr, lacks))}"] * bool(lacks)
        told += [f"has {', '.join(map(repr, beside))} too"] * bool(beside)
        raise ValueError(
            f"{where or 'it'}: expected the fields {sorted(written)}; it {' and '.join(told)}"
        )


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


# JSON files that carry a hash of themselves: what does not match is damaged or was edited.

SEAL = "sha256"


def render_sealed(body: Mapping[str, object]) -> bytes:
    """Return the file of a JSON object, its hash last; the same object gives the same bytes.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    whole = {**body, SEAL: _hash(body)}
    return (json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


@dataclass(frozen=True)
class _Mark:
    """The key `format` of a file."""

    format: int | str | None = None


def read_format(content: bytes) -> int | str | None:
    """Return the format that a JSON file names; None where it names none.

    Raises:
        ValueError: it is no JSON object.
    """
    return from_json(_Mark, json.loads(content)).format


def read_sealed(content: bytes) -> dict[str, Json]:
    """Return the object of a sealed file, without its hash.

    Raises:
        ValueError: it is no JSON object, has no hash, or the hash does not match.
    """
    try:
        body = json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(body, dict) or SEAL not in body:
        raise ValueError("it carries no hash of itself")
    if body.pop(SEAL) != _hash(body):
        raise ValueError("its hash is not its own: it was edited or damaged")
    return body


def _hash(body: Mapping[str, object]) -> str:
    text = json.dumps(body, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


# The JSON Schema of a dataclass, as `base.records` writes it: types, and what each key means.
#
# Descriptions are the docstrings: the class's own first line, and the text below each field.

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PLAIN_NAMES = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}

Definitions = dict[str, Json]


def describe_schema(kind: type) -> dict[str, Json]:
    """Return the JSON Schema of what `to_dict` makes of a dataclass.

    Keys that a later version adds are valid; those of this version must be there.
    """
    definitions: Definitions = {}
    body = _describe_record(kind, definitions)
    schema: dict[str, Json] = {"$schema": DIALECT, "title": get_schema_name(kind) or kind.__name__}
    schema |= body
    if definitions:
        schema["$defs"] = dict(sorted(definitions.items()))
    return schema


def _describe_record(kind: type, definitions: Definitions) -> dict[str, Json]:
    texts = read_field_texts(kind)
    name = get_schema_name(kind)
    properties: dict[str, Json] = {SCHEMA_KEY: {"const": name}} if name else {}
    required: list[Json] = [SCHEMA_KEY] if name else []
    for one, hint in list_fields(kind):
        if one.metadata.get("unwritten"):
            continue
        schema = _describe(hint, definitions)
        if one.metadata.get("measured"):
            schema = _allow_null(schema)
        properties[one.name] = _annotate(schema, texts.get(one.name, ""))
        if not one.metadata.get("optional"):
            required.append(one.name)
    for alias in get_aliases(kind):
        getter = getattr(kind, alias).fget
        hint = get_type_hints(getter).get("return")
        text = " ".join((inspect.getdoc(getter) or "").split())
        properties[alias] = _annotate(_allow_null(_describe(hint, definitions)), text)
        required.append(alias)
    text = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
    return {
        "type": "object",
        "description": text,
        "properties": properties,
        "required": required,
    }


def _allow_null(schema: dict[str, Json]) -> dict[str, Json]:
    """Return the schema of numbers that may not be finite, in a mapping too."""
    if schema == {"type": "number"}:
        return {"type": ["number", "null"]}
    inner = schema.get("additionalProperties")
    if isinstance(inner, dict):
        return {**schema, "additionalProperties": _allow_null(inner)}
    choices = schema.get("anyOf")
    if isinstance(choices, list):
        allowed: list[Json] = [_allow_null(c) for c in choices if isinstance(c, dict)]
        return {**schema, "anyOf": allowed}
    return schema


def _annotate(schema: dict[str, Json], text: str) -> dict[str, Json]:
    return {**schema, "description": text} if text else schema


def _describe(hint: object, definitions: Definitions) -> dict[str, Json]:
    """Return the schema of a type; dataclasses are named under `$defs`."""
    origin, arguments = take_apart(hint)
    if isinstance(origin, type) and origin in PLAIN_NAMES:
        return {"type": PLAIN_NAMES[origin]}
    if isinstance(origin, type) and is_dataclass(origin):
        if origin.__name__ not in definitions:
            definitions[origin.__name__] = None  # it may hold itself
            definitions[origin.__name__] = _describe_record(origin, definitions)
        return {"$ref": f"#/$defs/{origin.__name__}"}
    if origin is Union:
        return {"anyOf": [_describe(one, definitions) for one in arguments]}
    if origin is Literal:
        return {"enum": [to_json(one) for one in arguments]}
    if origin is frozenset:
        return {"type": "array", "items": _describe(arguments[0], definitions)}
    if origin is tuple:
        if arguments[1:] == (...,):
            return {"type": "array", "items": _describe(arguments[0], definitions)}
        count = len(arguments)
        items: list[Json] = [_describe(one, definitions) for one in arguments]
        return {"type": "array", "prefixItems": items, "minItems": count, "maxItems": count}
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _describe(arguments[1], definitions)}
    raise TypeError(f"{hint} has no schema")


@cache
def read_field_texts(kind: type) -> Mapping[str, str]:
    """Return field -> the text below it in the class's source, those of its bases included."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        if is_dataclass(one):
            found |= _read_own_texts(one)
    return found


def _read_own_texts(kind: type) -> dict[str, str]:
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    found: dict[str, str] = {}
    field = ""
    for node in tree.body if isinstance(tree, ast.ClassDef) else ():
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            field = node.target.id
        elif field and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            found[field] = " ".join(str(node.value.value).split())
            field = ""
        else:
            field = ""
    return found
