"""Holds what a command printed against its JSON Schema in docs/reference/schemas."""

import json
from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "docs/reference/schemas"
TYPES = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "null": (type(None),),
}
KNOWN = {
    *("$schema", "$defs", "$ref", "title", "description", "type", "properties", "required"),
    *("additionalProperties", "items", "prefixItems", "minItems", "maxItems", "anyOf", "enum"),
    "const",
}
"""The keywords that the schemas use and that are checked here."""


@cache
def load_schema(name: str) -> dict[str, Any]:
    """Return the schema that a record's key `schema` names."""
    schema = json.loads((FOLDER / f"{name.split('/', maxsplit=1)[0]}.json").read_text("utf-8"))
    assert schema["properties"]["schema"] == {"const": name}
    return schema


def validate(record: dict[str, Any]) -> None:
    """Raise AssertionError where a record is not as its schema says, undeclared keys included."""
    schema = load_schema(record["schema"])
    _check(record, schema, schema["title"], schema)


def _check(value: Any, schema: dict[str, Any], where: str, root: dict[str, Any]) -> None:
    assert set(schema) <= KNOWN, (where, set(schema) - KNOWN)
    if "$ref" in schema:
        _check(value, root["$defs"][schema["$ref"].rsplit("/", 1)[1]], where, root)
    if "anyOf" in schema:
        errors = []
        for choice in schema["anyOf"]:
            try:
                _check(value, choice, where, root)
                break
            except AssertionError as error:
                errors.append(str(error))
        else:
            raise AssertionError(f"{where}: none of {errors}")
    if "const" in schema:
        assert value == schema["const"], where
    if "enum" in schema:
        assert value in schema["enum"], where
    if "type" in schema:
        names = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
        allowed = tuple(kind for name in names for kind in TYPES[name])
        is_right = isinstance(value, allowed) and (bool in allowed or not isinstance(value, bool))
        assert is_right, f"{where}: {value!r:.60} is no {schema['type']}"
    if isinstance(value, dict):
        _check_object(value, schema, where, root)
    if isinstance(value, list) and "anyOf" not in schema:
        items = schema.get("prefixItems")
        assert items is None or len(items) == len(value), where
        for i, one in enumerate(value):
            _check(one, items[i] if items else schema.get("items", {}), f"{where}[{i}]", root)


def _check_object(
    value: dict[str, Any], schema: dict[str, Any], where: str, root: dict[str, Any]
) -> None:
    missing = set(schema.get("required", ())) - set(value)
    assert not missing, f"{where}: lacks {missing}"
    for key, one in value.items():
        inner = schema.get("properties", {}).get(key, schema.get("additionalProperties"))
        assert inner is not None or "$ref" in schema or "anyOf" in schema, f"{where}: {key}"
        if inner is not None:
            _check(one, inner, f"{where}.{key}", root)
