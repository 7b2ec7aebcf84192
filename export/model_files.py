"""Reads an integer model back from its file, and checks everything in it."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.base.records import list_fields
from zerodrift.export.integer_model import (
    FORMAT,
    NEWER_FIELDS,
    OLDER_FORMAT,
    Channel,
    Guards,
    IntegerModel,
    OutputFormat,
)
from zerodrift.export.model_checks import check_model
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.registry import NODE_CLASSES

T = TypeVar("T")
_INTEGER_TYPES = ("int8", "int16", "int32", "int64")


def _array(path: str, body: dict[str, object]) -> NDArray[np.signedinteger]:
    if not {"dtype", "shape", "data"} <= set(body):
        raise InputError(f"{path}: expected an array with dtype, shape and data")
    dtype, shape, data = (body[key] for key in ("dtype", "shape", "data"))
    lengths, entries = _list_integers(shape), _list_integers(data)
    if dtype not in _INTEGER_TYPES or lengths is None or any(n < 0 for n in lengths):
        raise InputError(f"{path}: array of {dtype!r} with shape {shape!r}; expected integers")
    if entries is None or len(entries) != math.prod(lengths):
        count = len(data) if isinstance(data, list) else "no"
        raise InputError(f"{path}: {count} entries do not fill shape {shape}")
    info = np.iinfo(str(dtype))
    if any(v < info.min or v > info.max for v in entries):
        raise InputError(f"{path}: an entry does not fit {dtype}")
    return np.array(entries, dtype=str(dtype)).reshape(lengths)


def _list_integers(value: object) -> list[int] | None:
    """Return a list of integers; None where it is anything else, or holds anything else."""
    if not isinstance(value, list) or not all(type(v) is int for v in value):
        return None
    return value


def _typed(path: str, value: object) -> object:
    if isinstance(value, dict) and "dtype" in value:
        return _array(path, value)
    if isinstance(value, list):
        return tuple(_typed(path, v) for v in value)
    return value


def _build(cls: type[T], path: str, body: object) -> T:
    hints = {field.name: hint for field, hint in list_fields(cls)}
    names = set(hints)
    if not isinstance(body, dict) or not names - {*NEWER_FIELDS} <= set(body) <= names:
        found = sorted(body) if isinstance(body, dict) else type(body).__name__
        raise InputError(f"{path}: expected the fields {sorted(names)}, found {found}")
    return cls(**{k: _read_field(f"{path}.{k}", hints[k], v) for k, v in body.items()})


def _read_field(path: str, hint: object, value: object) -> object:
    """Return a field of a node, which may be a layer, or several."""
    if isinstance(hint, type) and is_dataclass(hint):
        return _build(hint, path, value)
    (item, *_) = get_args(hint) or (None,)
    if isinstance(item, type) and is_dataclass(item) and isinstance(value, dict):
        return _build(item, path, value)
    if isinstance(item, type) and is_dataclass(item) and value and isinstance(value, list):
        return tuple(_build(item, f"{path}[{i}]", v) for i, v in enumerate(value))
    return _typed(path, value)


def _nodes(path: str, bodies: Sequence[object]) -> Iterator[IntegerNode]:
    seen: set[str] = set()
    for i, body in enumerate(bodies):
        where = f"{path}: nodes[{i}]"
        kind = body.get("kind") if isinstance(body, dict) else None
        if not isinstance(body, dict) or kind not in NODE_CLASSES:
            raise InputError(
                f"{where}: unknown kind {kind!r}; expected one of {list(NODE_CLASSES)}"
            )
        node = _build(NODE_CLASSES[kind], where, {k: v for k, v in body.items() if k != "kind"})
        missing = [name for name in node.inputs if name not in seen]
        if missing or node.name in seen:
            raise InputError(f"{where}: '{node.name}' reads {missing}, which are not earlier nodes")
        seen.add(node.name)
        yield node


def load_model(path: Path) -> IntegerModel:
    """Read a model written by `IntegerModel.save`.

    Raises:
        InputError: no such file, not JSON, another format, fields missing or unknown, entries that
            do not fit their type, or a hash that does not match (the file was edited or damaged).
        CheckError: a bound of the arithmetic does not hold.
    """
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no integer model. Run `zerodrift firmware`.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as a model ({error}). Run `zerodrift export`."
        ) from error
    return parse_model(str(path), body)


def parse_model(path: str, body: object) -> IntegerModel:
    """Return the model of a file's content, which is checked as `load_model` says.

    Args:
        path: names the file in messages.
        body: what its JSON holds.
    """
    if not isinstance(body, dict) or body.get("format") not in (OLDER_FORMAT, FORMAT):
        number = body.get("format") if isinstance(body, dict) else None
        found = f"a model of format {number}" if isinstance(number, int) else "no integer model"
        raise InputError(
            f"{path}: {found}; expected format {OLDER_FORMAT} or {FORMAT}, which this version of"
            " zerodrift reads. Run `zerodrift firmware` to build it again, or use the version that"
            " wrote it."
        )
    claimed = body.pop("hash", None)
    try:
        model = IntegerModel(
            name=body["name"],
            sample_period_s=body["sample_period_s"],
            channels=tuple(_build(Channel, f"{path}: channels", c) for c in body["channels"]),
            nodes=tuple(_nodes(path, body["nodes"])),
            outputs=tuple(_build(OutputFormat, f"{path}: outputs", o) for o in body["outputs"]),
            guards=_build(Guards, f"{path}: guards", body["guards"]),
            notes=body["notes"],
            prefix=body.get("prefix", ""),
            guarded=body.get("guarded", False),
            tare=body.get("tare", False),
            variable_step=body.get("variable_step", False),
        )
        found = model.hash
    except KeyError as error:
        raise InputError(
            f"{path}: the field {error} is missing. Run `zerodrift export`."
        ) from error
    except (TypeError, AttributeError, ValueError) as error:
        raise InputError(
            f"{path}: not built like an integer model ({error}). Run `zerodrift export`."
        ) from error
    if not model.nodes or not isinstance(model.nodes[-1], IntegerDrift):
        raise InputError(f"{path}: the last node is not 'drift'. Run `zerodrift export`.")
    if found != claimed:
        raise InputError(
            f"{path}: its hash is {found[:12]}, the file claims {str(claimed)[:12]}; it was"
            " edited or damaged. Run `zerodrift export`."
        )
    check_model(path, model)
    return model
