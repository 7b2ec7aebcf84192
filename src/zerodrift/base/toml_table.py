"""A table of a TOML file, read key by key with checks whose errors name file and line."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError, nearest

KeyPath = tuple[str | int, ...]

# The line of each key of a TOML text, for messages about it.

_KEY_PART = re.compile(r"""\s*("(?:[^"\\]|\\.)*"|'[^']*'|[A-Za-z0-9_-]+)\s*""")
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"' + r"|'[^']*'")


def index_lines(text: str) -> dict[KeyPath, int]:
    """Return the 1-based line of every table and key of a valid TOML text.

    A table in an array carries its position: the second `[[effect]]` is `("effect", 1)` and its
    kind is `("effect", 1, "kind")`. Keys within an inline table are not indexed; `find_line` then
    gives the line of the table.
    """
    lines: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
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


def find_line(lines: Mapping[KeyPath, int], path: KeyPath) -> int:
    """Return the line of `path`, or of the nearest table around it; 1 when none is known."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return 1


def _split_key(text: str) -> KeyPath:
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


# A table of a TOML file, read key by key with checks whose errors name file and line.

LARGEST = 1e300


@dataclass(frozen=True)
class TomlTable:
    """A table of the file: its values, and their lines."""

    file: Path
    lines: dict[tuple[str | int, ...], int]
    """Line of every key of the file, from `index_lines`."""
    key: tuple[str | int, ...]
    """Names from the file's root to this table: `("outputs", "Fz")`."""
    values: Mapping[str, object]

    def line(self, key: str | None = None) -> int:
        """Return the line of `key`, or of the table's own header."""
        return find_line(self.lines, self.key if key is None else (*self.key, key))

    def error(self, key: str | None, message: str) -> InputError:
        """Return the error about `key` of this table, or about the table itself."""
        return InputError(f"{self.file}:{self.line(key)}: {message}")

    def label(self, key: str) -> str:
        """Return how a user writes this key: `[sensor] name`."""
        names = [part for part in self.key if isinstance(part, str)]
        return f"[{'.'.join(names)}] {key}" if names else f"[{key}]"

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Raise InputError for the first key that is not among `known`, naming the nearest."""
        names = tuple(known)
        for key in self.values:
            if key not in names:
                hint = nearest(key, names) or "."
                raise self.error(
                    key,
                    f"unknown key {self.label(key)}{hint} Expected one of {', '.join(names)}; "
                    "correct it or take it out.",
                )

    def expect(self, key: str, expected: str) -> InputError:
        """Return the error for a value that is missing, or not what was expected."""
        if key not in self.values:
            return self.error(None, f"{self.label(key)} is missing; expected {expected}.")
        return self.error(key, f"{self.label(key)} is {self.values[key]!r}; expected {expected}.")

    def table(self, key: str, known: Iterable[str] | None, optional: bool = False) -> "TomlTable":
        """Return the sub-table `key`; empty when it is left out and optional."""
        found = self.values.get(key)
        if found is None and not optional:
            raise self.error(
                None,
                f"table [{key}] is missing; expected one. `zerodrift init` shows how it looks.",
            )
        if found is not None and not isinstance(found, dict):
            name = ".".join(str(part) for part in (*self.key, key))
            raise self.expect(key, f"a table, written [{name}]")
        inner = TomlTable(self.file, self.lines, (*self.key, key), found or {})
        if known is not None:
            inner.refuse_unknown(known)
        return inner

    def text(self, key: str) -> str:
        """Return a text that is not empty."""
        value = self.values.get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.expect(key, "text in quotes, not empty")
        if "\0" in value:
            raise self.expect(key, "text without a NUL character")
        return value

    def texts(self, key: str, optional: bool = False) -> tuple[str, ...]:
        """Return a list of texts that is not empty; empty only when it is left out and optional."""
        value = self.values.get(key)
        if value is None and optional:
            return ()
        items = value if isinstance(value, list) else []
        if not items or not all(isinstance(i, str) and i.strip() and "\0" not in i for i in items):
            raise self.expect(key, 'a list of texts, not empty, such as ["logs/chamber_*.csv"]')
        return tuple(items)

    def number(self, key: str, expected: str) -> float:
        """Return a finite number; `expected` says in an error what it should have been."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.expect(key, expected)
        # Refuses NaN and infinity, and whole numbers that no float can hold.
        if not abs(value) < LARGEST:
            raise self.expect(key, f"{expected}, finite")
        return float(value)

    def positive(self, key: str) -> float:
        """Return a finite number above zero."""
        value = self.number(key, "a number > 0")
        if value <= 0:
            raise self.expect(key, "a number > 0")
        return value

    def integer(self, key: str, low: int, high: int | None = None) -> int:
        """Return a whole number from `low` to `high`, both included."""
        value = self.values.get(key)
        span = f"a whole number >= {low}" if high is None else f"a whole number {low} to {high}"
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.expect(key, span)
        if value < low or (high is not None and value > high):
            raise self.expect(key, span)
        return value

    def flag(self, key: str) -> bool:
        """Return true or false; false when the key is left out."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            raise self.expect(key, "true or false")
        return value

    def choice(self, key: str, known: tuple[str, ...], default: str) -> str:
        """Return one of the known texts, or the default when the key is left out."""
        value = self.values.get(key, default)
        if value not in known:
            raise self.expect(key, f"one of {', '.join(known)}{nearest(str(value), known)}")
        return str(value)
