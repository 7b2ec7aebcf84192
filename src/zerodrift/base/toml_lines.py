"""The line of each key of a TOML text, for messages about it."""

import re
from collections.abc import Mapping

Path = tuple[str | int, ...]

_KEY_PART = re.compile(r"""\s*("(?:[^"\\]|\\.)*"|'[^']*'|[A-Za-z0-9_-]+)\s*""")
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"' + r"|'[^']*'")


def index_lines(text: str) -> dict[Path, int]:
    """Return the 1-based line of every table and key of a valid TOML text.

    A table in an array carries its position: the second `[[effect]]` is `("effect", 1)` and its
    kind is `("effect", 1, "kind")`. Keys within an inline table are not indexed; `find_line` then
    gives the line of the table.
    """
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    depth = 0
    closing = ""
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw
        if closing:
            _, found, line = line.partition(closing)
            if not found:
                continue
            closing = ""
        elif depth == 0:
            stripped = line.strip()
            if stripped.startswith("["):
                is_array = stripped.startswith("[[")
                table = _split_key(stripped[2:] if is_array else stripped[1:])
                if is_array:
                    position = counts.get(table, 0)
                    counts[table] = position + 1
                    table = (*table, position)
                lines[table] = number
                continue
            key = _split_key(stripped)
            if key:
                for length in range(1, len(key) + 1):
                    lines.setdefault((*table, *key[:length]), number)
        change, closing = _measure_value(line)
        depth += change
    return lines


def find_line(lines: Mapping[Path, int], path: Path) -> int:
    """Return the line of `path`, or of the nearest table around it; 1 when none is known."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return 1


def _split_key(text: str) -> Path:
    """Return the parts of the dotted key that `text` begins with; empty for a blank or comment."""
    parts: list[str | int] = []
    position = 0
    while match := _KEY_PART.match(text, position):
        part = match.group(1)
        parts.append(part[1:-1] if part[0] in "\"'" else part)
        position = match.end()
        if position >= len(text) or text[position] != ".":
            break
        position += 1
    return tuple(parts)


def _measure_value(line: str) -> tuple[int, str]:
    """Return by how much `line` deepens the brackets, and the delimiter of a string left open."""
    for delimiter in ('"""', "'''"):
        before, found, after = line.partition(delimiter)
        if found and "#" not in _QUOTED.sub("", before):
            _, closed, rest = after.partition(delimiter)
            if not closed:
                return 0, delimiter
            line = before + rest
    bare = _QUOTED.sub("", line).partition("#")[0]
    depth = sum(bare.count(bracket) for bracket in "[{")
    depth -= sum(bare.count(bracket) for bracket in "]}")
    return depth, ""
