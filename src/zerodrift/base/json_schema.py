"""The JSON Schema of a dataclass, as `base.records` writes it: types, and what each key means.

Descriptions are the docstrings: the class's own first line, and the text below each field.
"""

import ast
import inspect
import textwrap
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from types import NoneType
from typing import Literal, Union, get_type_hints

from zerodrift.base.records import (
    SCHEMA_KEY,
    Json,
    get_aliases,
    get_schema_name,
    list_fields,
    take_apart,
    to_json,
)

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
