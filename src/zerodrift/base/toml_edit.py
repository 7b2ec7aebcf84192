"""Edits the text of zerodrift.toml: effects, channels and logs; all else stays as it is."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.toml_table import index_lines

# Adds keys to columns of inputs in the text of zerodrift.toml, and its format; all else stays.

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


# Names one more log under [logs] in the text of zerodrift.toml; all else stays.


def add_log(text: str, name: str, *, path: Path = Path("zerodrift.toml")) -> str:
    """Return the text with one more log at the end of `[logs] train`.

    Args:
        text: a valid zerodrift.toml.
        name: of the log, relative to the project, with `/`.
        path: the file, for messages.

    Raises:
        InputError: `train` is no list that can be edited.
    """
    plain = text.lstrip("\ufeff")
    table = tomllib.loads(plain)
    line = index_lines(plain).get(("logs", "train"))
    refused = InputError(
        f"{path}: [logs] train cannot be edited; expected a list of its own, train = [...]. Add "
        f'"{name}" to it by hand.'
    )
    if line is None:
        raise refused
    rows = plain.splitlines(keepends=True)
    begin = sum(len(row) for row in rows[: line - 1])
    end = _find_end(plain, plain.index("=", begin) + 1)
    if end is None:
        raise refused
    value = json.dumps(name, ensure_ascii=False)
    if end[0]:
        inner = plain[: end[1]].rstrip()
        comma = {"[": "", ",": " "}.get(inner[-1], ", ")
        edited = f"{inner}{comma}{value}{plain[end[1] :]}"
    else:
        edited = _add_row(plain, end[1], value)
    logs = dict(table.get("logs", {}))
    logs["train"] = [*logs.get("train", ()), name]
    try:
        is_so = tomllib.loads(edited) == {**table, "logs": logs}
    except tomllib.TOMLDecodeError:
        is_so = False
    if not is_so:
        raise refused
    return text[: len(text) - len(plain)] + edited


def _find_end(text: str, begin: int) -> tuple[bool, int] | None:
    """Return whether a value is on the line of an array's closing bracket, and where that is."""
    depth, at, first = 0, begin, None
    while at < len(text):
        char = text[at]
        if char in "\"'":
            close = text.find(char, at + 1)
            while char == '"' and close > 0 and text[close - 1] == "\\":
                close = text.find(char, close + 1)
            if close < 0:
                return None
            at = close
        elif char == "#":
            at = text.find("\n", at)
            if at < 0:
                return None
        elif char == "[":
            first = at if first is None else first
            depth += 1
        elif char == "]":
            depth -= 1
            if depth == 0 and first is not None:
                return bool(text[text.rfind("\n", 0, at) + 1 : at].strip()), at
        elif first is None and not char.isspace():
            return None
        at += 1
    return None


def _add_row(text: str, end: int, value: str) -> str:
    """Return the text with a value on a row of its own before a closing bracket.

    The last value's row may end in a comment, before which a comma has to stand.
    """
    before = text[:end].rstrip()
    rows = before.split("\n")
    last, mark = rows[-1], ""
    hash_at = last.rfind("#")
    if hash_at >= 0 and last[:hash_at].count('"') % 2 == 0:
        last, mark = last[:hash_at].rstrip(), "  " + last[hash_at:]
    indent = last[: len(last) - len(last.lstrip())] or "    "
    if last.strip() and not last.endswith((",", "[")):
        last += ","
    if last.endswith("["):
        indent = "    "
    end_of_line = "\r\n" if "\r\n" in text else "\n"
    closing = end_of_line + text[text.rfind("\n", 0, end) + 1 : end]
    kept = "\n".join([*rows[:-1], last + mark])
    return f"{kept}{end_of_line}{indent}{value},{closing}{text[end:]}"


# Adds an `[[effect]]` table to the text of zerodrift.toml, takes one out, or names a file of
# effects there; all else stays.
#
# The text is edited line by line: a library that rewrites the document moves the comment above the
# next table, and tables that stand apart, to other places. The result is read back and compared, so
# that an edit either does exactly what was asked or is refused.

_TABLES = "[[effect]] tables with one key to a line. Edit the effects by hand"
_FILES = re.compile(
    r"(?P<before>\s*files\s*=\s*\[[^\]#]*?)(?P<after>\s*\]\s*(?:#.*)?)\Z", re.DOTALL
)
_VALUE = re.compile(r"(?P<before>\s*[^=]+=\s*)[^#]*?(?P<after>\s*(?:#.*)?)\Z", re.DOTALL)


def add_effect(
    text: str,
    kind: str,
    held: Mapping[str, float] | None = None,
    options: Mapping[str, str] | None = None,
    *,
    path: Path = Path("zerodrift.toml"),
) -> str:
    """Return the text with one more `[[effect]]`, after the last one.

    Args:
        text: a valid zerodrift.toml.
        kind: the effect's name.
        held: parameters to hold at a value.
        options: text options, such as `signal`.
        path: the file, for messages.

    Raises:
        InputError: the effects stand in an inline array, which is not edited.
    """
    table: dict[str, object] = {"kind": kind, **(options or {}), **(held or {})}
    rows = text.splitlines(keepends=True)
    end = _find_line_end(rows)
    block = ["[[effect]]" + end]
    block += [f"{key} = {_write_value(value)}{end}" for key, value in table.items()]
    blocks = _find_blocks(text, path)
    if blocks:
        at = blocks[-1][1]
        before, after = rows[:at], rows[at:]
        if before and not before[-1].endswith("\n"):
            before[-1] += end
        block = [end, *block]
    else:
        at = _find_model_tables(text)
        before, after = rows[:at], rows[at:]
        if before and not before[-1].endswith("\n"):
            before[-1] += end
        block = [end, *block] if not after else [*block, end]
    edited = "".join([*before, *block, *after])
    effects = [*_read_effects(text), table]
    return _confirm_effects(text, edited, effects, path)


def add_plugin(text: str, name: str, *, path: Path = Path("zerodrift.toml")) -> str:
    """Return the text with one more file under `[plugins] files`.

    Args:
        text: a valid zerodrift.toml.
        name: of the file, as it is to stand there.
        path: zerodrift.toml, for messages.

    Raises:
        InputError: the files stand in another form than a list on one line.
    """
    wanted = tomllib.loads(text.lstrip("\ufeff"))
    is_there = "plugins" in wanted
    table = wanted.setdefault("plugins", {})
    has_files = bool(table.get("files"))
    table["files"] = [*table.get("files", []), name]
    rows = text.splitlines(keepends=True)
    end = _find_line_end(rows)
    if rows and not rows[-1].endswith("\n"):
        rows[-1] += end
    lines = index_lines(text.lstrip("\ufeff"))
    if not is_there:
        rows += [end, f"[plugins]{end}", f"files = [{_write_value(name)}]{end}"]
    elif ("plugins", "files") not in lines:
        rows.insert(lines.get(("plugins",), 1), f"files = [{_write_value(name)}]{end}")
    else:
        at = lines[("plugins", "files")] - 1
        parts = _FILES.match(rows[at])
        if parts is not None:
            comma = ", " if has_files else ""
            before = parts["before"].rstrip().removesuffix(",")
            rows[at] = f"{before}{comma}{_write_value(name)}{parts['after']}"
    expected = f"[plugins] with its files in a list on one line. Name {name} there by hand"
    return _confirm("".join(rows), wanted, path, expected)


def set_parameters(
    text: str, position: int, held: Mapping[str, float], *, path: Path = Path("zerodrift.toml")
) -> str:
    """Return the text with parameters of its `[[effect]]` at `position` held at other values.

    Raises:
        InputError: the effects stand in an inline array, or a value is not on its key's line.
    """
    rows = text.splitlines(keepends=True)
    end = _find_line_end(rows)
    start, stop = _find_blocks(text, path)[position]
    lines = index_lines(text.lstrip("\ufeff"))
    new = []
    for key, value in held.items():
        if ("effect", position, key) in lines:
            at = lines[("effect", position, key)] - 1
            parts = _VALUE.match(rows[at])
            if parts is not None:
                rows[at] = f"{parts['before']}{_write_value(value)}{parts['after']}"
        else:
            new.append(f"{key} = {_write_value(value)}{end}")
    last = max(n for n in lines.values() if start < n <= stop)
    if new and not rows[last - 1].endswith("\n"):
        rows[last - 1] += end
    edited = "".join([*rows[:last], *new, *rows[last:]])
    effects = _read_effects(text)
    effects[position] = {**effects[position], **held}
    return _confirm_effects(text, edited, effects, path)


def remove_effect(text: str, position: int, *, path: Path = Path("zerodrift.toml")) -> str:
    """Return the text without its `[[effect]]` at `position`, counted from 0.

    The comment above the table stays; comments inside it go with it.

    Raises:
        InputError: the effects stand in an inline array, which is not edited.
    """
    rows = text.splitlines(keepends=True)
    start, stop = _find_blocks(text, path)[position]
    while start > 0 and not rows[start - 1].strip():
        start -= 1
    edited = "".join(rows[:start] + rows[stop:])
    effects = _read_effects(text)
    del effects[position]
    return _confirm_effects(text, edited, effects, path)


def _find_line_end(rows: list[str]) -> str:
    return "\r\n" if any(row.endswith("\r\n") for row in rows) else "\n"


def _write_value(value: object) -> str:
    """Return a TOML value; JSON's strings and Python's shortest floats are TOML's too."""
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return json.dumps(value, ensure_ascii=False)


def _read_effects(text: str) -> list[dict[str, object]]:
    return list(tomllib.loads(text.lstrip("\ufeff")).get("effect", []))


def _find_blocks(text: str, path: Path) -> list[tuple[int, int]]:
    """Return (first row, row after the last) of each `[[effect]]` table, rows from 0."""
    lines = index_lines(text.lstrip("\ufeff"))
    rows = text.splitlines()
    count = len(_read_effects(text))
    starts = [lines[("effect", i)] - 1 for i in range(count) if ("effect", i) in lines]
    if len(starts) != count:
        raise InputError(
            f"{path}:{lines.get(('effect',), 1)}: the effects stand in an inline array, which is "
            "not edited; write each of them as a table, [[effect]] with its keys below."
        )
    # Only headers begin with a bracket at a line that holds a table or key of its own.
    headers = sorted({n - 1 for n in lines.values() if rows[n - 1].lstrip().startswith("[")})
    blocks = []
    for start in starts:
        limit = next((row for row in headers if row > start), len(rows))
        last = max(n - 1 for n in lines.values() if start <= n - 1 < limit)
        blocks.append((start, _end_block(rows, last, limit)))
    return blocks


def _end_block(rows: list[str], last_key: int, limit: int) -> int:
    """Return the row after a table that ends before row `limit`.

    A value may go on over several lines; a comment right below the last key belongs to the table,
    unless it continues to the next table's header, whose comment it then is.
    """
    stop = limit
    while stop > last_key + 1 and (not rows[stop - 1].strip() or _is_comment(rows[stop - 1])):
        stop -= 1
    below = stop
    while below < limit and rows[below].strip():
        below += 1
    return stop if below == limit and limit < len(rows) else below


def _is_comment(row: str) -> bool:
    return row.lstrip().startswith("#")


def _find_model_tables(text: str) -> int:
    """Return the row before which the first effect goes: [network] with its comment, or the end."""
    lines = index_lines(text.lstrip("\ufeff"))
    rows = text.splitlines()
    for table in ("network", "quantization", "firmware", "plugins"):
        if (table,) in lines:
            row = lines[(table,)] - 1
            while row > 0 and _is_comment(rows[row - 1]):
                row -= 1
            return row
    return len(rows)


def _confirm_effects(text: str, edited: str, effects: list[dict[str, object]], path: Path) -> str:
    """Return `edited` if it differs from `text` in its effects alone, and there as asked."""
    wanted = tomllib.loads(text.lstrip("\ufeff"))
    wanted["effect"] = effects
    if not effects:
        del wanted["effect"]
    return _confirm(edited, wanted, path, _TABLES)


def _confirm(edited: str, wanted: dict[str, object], path: Path, expected: str) -> str:
    """Return `edited` if it holds what is wanted, and nothing else."""
    try:
        found = tomllib.loads(edited.lstrip("\ufeff"))
    except tomllib.TOMLDecodeError:
        found = {}
    if found != wanted:
        raise InputError(
            f"{path}: its layout is not understood well enough to edit it; expected {expected}."
        )
    return edited
