"""Reads an integer model back from its file, and checks everything in it."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json
from zerodrift.export.integer_model import FORMAT, OLDER_FORMAT, IntegerModel
from zerodrift.export.model_checks import check_model
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.registry import NODE_CLASSES


def _read_nodes(bodies: object) -> Iterator[IntegerNode]:
    """Yield the nodes, each of the class that its `kind` names."""
    if not isinstance(bodies, list):
        raise ValueError(f"nodes: is {bodies!r:.40}; expected a list")
    seen: set[str] = set()
    for i, body in enumerate(bodies):
        where = f"nodes[{i}]"
        kind = body.get("kind") if isinstance(body, dict) else None
        if not isinstance(kind, str) or kind not in NODE_CLASSES:
            raise ValueError(f"{where}: unknown kind {kind!r}; expected one of {[*NODE_CLASSES]}")
        fields = {key: value for key, value in body.items() if key != "kind"}
        node = from_json(NODE_CLASSES[kind], fields, where, exact=True)
        missing = [name for name in node.inputs if name not in seen]
        if missing or node.name in seen:
            raise ValueError(f"{where}: '{node.name}' reads {missing}, which are not earlier nodes")
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
    claimed = body.get("hash")
    fields = {key: value for key, value in body.items() if key not in ("format", "hash")}
    try:
        nodes = tuple(_read_nodes(body.get("nodes")))
        model = replace(from_json(IntegerModel, {**fields, "nodes": []}, exact=True), nodes=nodes)
        found = model.hash
    except (TypeError, AttributeError, ValueError, RecursionError) as error:
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
