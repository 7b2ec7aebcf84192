"""Adds keys to columns of inputs in the text of zerodrift.toml, and its format; all else stays."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.toml_lines import index_lines

FORMAT_NOTE = "  # of this file: what a code is worth is the same for every unit"
_ROW = re.compile(
    r"(?P<before>\s*[^=#]+=\s*)(?P<value>\{.*\}|\"[^\"]*\"|'[^']*')(?P<after>.*)", re.DOTALL
)


def set_format(text: str, number: int) -> str:
    """Return the text with `format` added at its top, or changed where it is."""
    line = f"format = {number}"
    if re.search(r"^format\s*=\s*\d+", text, re.MULTILINE):
        return re.sub(r"^format\s*=\s*\d+", line, text, count=1, flags=re.MULTILINE)
    mark, rest = ("\ufeff", text[1:]) if text.startswith("\ufeff") else ("", text)
    end = "\r\n" if "\r\n" in rest else "\n"
    return f"{mark}{line}{FORMAT_NOTE}{end}{end}{rest}"


def set_columns(
    text: str, columns: Mapping[str, Mapping[str, object]], path: Path, table: str = "inputs"
) -> str:
    """Return the text with keys of inputs added; a name becomes a table.

    Args:
        text: a valid zerodrift.toml.
        columns: input -> key -> value.
        path: the file, for messages.
        table: the table they are in, `inputs` or `sensor`.

    Raises:
        InputError: an input does not stand on a line of its own.
    """
    rows = text.splitlines(keepends=True)
    lines = index_lines(text.lstrip("\ufeff"))
    wanted = tomllib.loads(text.lstrip("\ufeff"))
    inputs = wanted.get(table, {})
    for name, keys in columns.items():
        given = inputs[name]
        known = {"column": given} if isinstance(given, str) else dict(given)
        inputs[name] = known | dict(keys)
        at = lines.get((table, name), 0) - 1
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
            f"{path}:{lines.get((table, first), 1)}: its layout is not understood well enough "
            f'to edit it; expected [{table}] with one key to a line, such as supply = "supply_V". '
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
