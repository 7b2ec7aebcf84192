"""Names one more log under [logs] in the text of zerodrift.toml; all else stays."""

import json
import tomllib
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.toml_lines import index_lines


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
