"""Adds keys to the columns of `[inputs]` in the text of zerodrift.toml; all else stays."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.toml_lines import index_lines

_ROW = re.compile(
    r"(?P<before>\s*[^=#]+=\s*)(?P<value>\{.*\}|\"[^\"]*\"|'[^']*')(?P<after>.*)", re.DOTALL
)


def set_columns(text: str, columns: Mapping[str, Mapping[str, object]], path: Path) -> str:
    """Return the text with keys of inputs added; a name becomes a table.

    Args:
        text: a valid zerodrift.toml.
        columns: input -> key -> value.
        path: the file, for messages.

    Raises:
        InputError: an input does not stand on a line of its own.
    """
    rows = text.splitlines(keepends=True)
    lines = index_lines(text.lstrip("\ufeff"))
    wanted = tomllib.loads(text.lstrip("\ufeff"))
    inputs = wanted.get("inputs", {})
    for name, keys in columns.items():
        given = inputs[name]
        table = {"column": given} if isinstance(given, str) else dict(given)
        inputs[name] = table | dict(keys)
        at = lines.get(("inputs", name), 0) - 1
        match = _ROW.fullmatch(rows[at]) if at >= 0 else None
        if match is not None:
            told = ", ".join(f"{key} = {_write(v)}" for key, v in inputs[name].items())
            rows[at] = f"{match['before']}{{ {told} }}{match['after']}"
    edited = "".join(rows)
    try:
        read = tomllib.loads(edited.lstrip("\ufeff"))
    except tomllib.TOMLDecodeError:
        read = {}
    if read != wanted:
        first = next(iter(columns))
        raise InputError(
            f"{path}:{lines.get(('inputs', first), 1)}: its layout is not understood well enough "
            'to edit it; expected [inputs] with one key to a line, such as supply = "supply_V". '
            f"Write {_describe(columns)} by hand."
        )
    return edited


def _describe(columns: Mapping[str, Mapping[str, object]]) -> str:
    return "; ".join(
        f"{name} with " + ", ".join(f"{key} = {_write(v)}" for key, v in keys.items())
        for name, keys in columns.items()
    )


def _write(value: object) -> str:
    """Return a TOML value; JSON's strings and Python's shortest floats are TOML's too."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_write(v)}" for key, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_write, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
