"""The characters, lines and words of a generated model's C, by a whitelist.

What the generator never writes is refused here with file, line and column, before anything is
replaced or left out (docs/reference/generated-c.md). A compiler can therefore find no other words
in the text than those that are found here. Shares no code with the generator and needs the
standard library only.
"""

import re
from bisect import bisect_right
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import overload

from zerodrift_proof.certificate.values import NotUnderstoodError

TOKEN = re.compile(
    r'"(?:[^"\\\n]|\\n)*"|\.?\d(?:[eEpP][+-]|[\w.])*|[A-Za-z_]\w*'
    r"|%:%:|\.\.\.|<<=|>>=|->|\+\+|--|<<|>>|&&|\|\||##|<:|:>|<%|%>|%:|::|[-+*/%&|^<>=!]=|\S",
    re.ASCII,
)
"""Words as C cuts them, the longest first; what is never written is found, and then refused."""
OPERATORS = frozenset("()[]{},;.?:=+-*/%&|<>") | frozenset(
    {"->", "++", "<<", ">>", "<=", ">=", "==", "!=", "&&", "||", "+=", "&=", "|="}
)
INTEGER = re.compile(r"(0|[1-9][0-9]*|0x[0-9A-F]+)(u?)")
WORD = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*")
CAPITALS = re.compile(r"[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*")
LINE_OF_ASSEMBLY = re.compile(r'"[^"\\]*(?:\\n)?"')
COMMENT = re.compile(r'//|/\*.*?\*/|"(?:[^"\\\n]|\\n)*"', re.S)

WRITTEN = frozenset(
    {"const", "else", "for", "if", "return", "sizeof", "static", "struct", "typedef", "void"}
) | {"volatile", "__asm", "__attribute__"}
"""The words of C that the generator writes, beside names of types."""
NEVER = frozenset(
    re.findall(
        r"\w+",
        "auto break case char continue default do double enum extern float goto inline int long"
        " register restrict short signed switch union unsigned while"
        " alignas alignof bool constexpr false nullptr static_assert thread_local true typeof"
        " typeof_unqual asm wchar_t"
        " and and_eq bitand bitor compl not not_eq or or_eq xor xor_eq",
    )
)
"""Words of C99 to C23, of GNU's C, and C++'s spellings of operators, that it never writes."""
PREDEFINED = frozenset({"i386", "linux", "unix"})
"""Macros that GCC and Clang define in small letters where they are not told -std=c99."""
STANDARD = frozenset(
    [f"{u}INT{n}_{end}" for u in ("", "U") for n in (8, 16, 32, 64) for end in ("MIN", "MAX")]
    + ["INT64_C", "UINT32_C", "UINT64_C", "NULL"]
) - {f"UINT{n}_MIN" for n in (8, 16, 32, 64)}
"""Macros of stdint.h and stddef.h that it writes."""
NAMES_OF_TABLES = (
    "ZD_TANH_OFFSET_NAME",
    "ZD_TANH_SLOPE_NAME",
    "ZD_TANH_HALF_OFFSET_NAME",
    "ZD_TANH_HALF_SLOPE_NAME",
    "ZD_SIGMOID_OFFSET_NAME",
)
"""Macros of the runtime: what a table is called where the linker sees it."""
SIZES = ("ZD_PAIR_SCRATCH", "ZD_ROW_VECTORS", "ZD_ROW_UNITS", "ZD_COLUMN_UNITS", "ZD_COLUMN_PAIRS")
"""Macros of the runtime that give an array's size; their arguments are integers."""
OF_RUNTIME = frozenset(
    {*NAMES_OF_TABLES, *SIZES, "ZD_CLAIM", "ZD_OBSERVE", "ZD_IN_REGISTER"}
    | {"ZD_GRU_RELAX_STEPS", "ZD_GRU_H_LIMIT_Q30", "ZD_LSTM_CELL_LIMIT"}
)
"""Macros of the runtime, and of the source itself, that it writes in code."""


def parse_integer(token: str) -> tuple[int, bool, int]:
    """Return a literal's number as C reads it, whether it is unsigned, and its count of l: none.

    Raises:
        NotUnderstoodError: the generator writes no such integer.
    """
    found = INTEGER.fullmatch(token)
    if not found:
        raise NotUnderstoodError(f"'{token}': {_explain_number(token)}")
    return int(found[1], 0), bool(found[2]), 0


@dataclass(frozen=True)
class SourceLine:
    """A line that holds anything but comments."""

    name: str
    """Of the file."""
    number: int
    text: str
    """Comments are blanks here; nothing blank is at the end."""

    def place(self, column: int = 1) -> str:
        """Return file:line:column."""
        return f"{self.name}:{self.number}:{column}"

    def refuse(self, why: str, column: int = 1) -> NotUnderstoodError:
        """Return what to raise where a line is not what the generator writes."""
        return NotUnderstoodError(f"{self.place(column)}: {why}")

    def locate(self, index: int) -> str:
        """Return file:line:column of its word of this index."""
        starts = [found.start() + 1 for found in TOKEN.finditer(self.text)]
        return self.place(starts[min(index, len(starts) - 1)])


@dataclass
class WordSpots:
    """Where words stand: each has a number, those of a line one after the other."""

    lines: list[SourceLine] = field(default_factory=list)
    firsts: list[int] = field(default_factory=list)
    count: int = 0

    def add(self, line: SourceLine, words: int) -> range:
        """Return the numbers of a line's words."""
        self.lines.append(line)
        self.firsts.append(self.count)
        self.count += words
        return range(self.count - words, self.count)

    def place(self, spot: int) -> str:
        """Return file:line:column of a word."""
        at = bisect_right(self.firsts, spot) - 1
        return self.lines[at].locate(spot - self.firsts[at])


@dataclass
class ModelTokens:
    """Words of header and source, with the model's macros replaced."""

    words: list[str] = field(default_factory=list)
    spots: list[int] = field(default_factory=list)
    """The place of each word, as `where` knows it."""
    where: WordSpots = field(default_factory=WordSpots)
    macros: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """The header's macros, by name."""

    @property
    def places(self) -> Sequence[str]:
        """file:line:column of each word; told apart only when asked."""
        return _TokenPlaces(self.spots, self.where)


class _TokenPlaces(Sequence[str]):
    def __init__(self, spots: list[int], where: WordSpots) -> None:
        self._spots, self._where = spots, where

    def __len__(self) -> int:
        return len(self._spots)

    @overload
    def __getitem__(self, at: int) -> str: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[str]: ...
    def __getitem__(self, at: int | slice) -> str | Sequence[str]:
        if isinstance(at, slice):
            return [self._where.place(spot) for spot in self._spots[at]]
        return self._where.place(self._spots[at])


def read_lines(text: str, name: str) -> list[SourceLine]:
    """Return the lines of a file that hold anything, comments left out.

    Args:
        text: of the file.
        name: of the file.

    Raises:
        NotUnderstoodError: a character or a comment that the generator does not write.
    """
    for pattern, why in _REFUSED:
        if found := pattern.search(text):
            raise _refuse_at(text, name, found.start(), why)
    if not text.endswith("\n"):
        raise _refuse_at(text, name, len(text), "the last line has no end")
    blank = COMMENT.sub(lambda found: _blank(found, text, name), text)
    for pattern, why in _REFUSED_IN_CODE:
        if found := pattern.search(blank):
            raise _refuse_at(text, name, found.start(), why)
    lines = enumerate(blank.split("\n"), 1)
    return [SourceLine(name, number, line.rstrip()) for number, line in lines if line.strip()]


_REFUSED = (
    (re.compile(r"[^\n -~]"), "a character other than printable ASCII, a blank and a line's end"),
    (re.compile(r"\?\?"), "'??' may begin a trigraph; the generator writes none"),
    (re.compile(r"\\(?!n)"), r"a backslash other than in '\n'; no line is continued"),
)
_REFUSED_IN_CODE = (
    (re.compile(r"'"), "a character constant; the generator writes none"),
    (re.compile(r"/[*]"), "a comment without an end"),
    (re.compile(r"[*]/"), "the end of a comment that did not begin"),
)


def _refuse_at(text: str, name: str, at: int, why: str) -> NotUnderstoodError:
    before = text[:at]
    return SourceLine(name, before.count("\n") + 1, "").refuse(why, at - before.rfind("\n"))


def _blank(found: re.Match[str], text: str, name: str) -> str:
    """Return blanks for a comment, and a string as it is."""
    told = found[0]
    if told[0] == '"':
        return told
    start, end = found.span()
    if told == "//":
        raise _refuse_at(text, name, start, "a comment by '//'; the generator writes none")
    inside = told[2:-2]
    if not re.match(r"[*]?[ \n]", inside) or not inside.endswith((" ", "\n")):
        raise _refuse_at(
            text, name, start, "a comment begins with '/* ' or '/** ', ends with ' */'"
        )
    if (at := inside.find("/*")) >= 0:
        raise _refuse_at(text, name, start + 2 + at, "a comment begins within a comment")
    if (at := inside.find("\\")) >= 0:
        raise _refuse_at(text, name, start + 2 + at, "a backslash in a comment")
    if text[end : text.find("\n", end)].strip():
        raise _refuse_at(text, name, end, "something after a comment on its line")
    several = told.count("\n")
    if several and text[text.rfind("\n", 0, start) + 1 : start].strip():
        raise _refuse_at(text, name, start, "a comment of several lines after something else")
    return re.sub(r"[^\n]", " ", told) if several else " " * len(told)


def read_words(lines: Iterable[SourceLine], allowed: Collection[str]) -> list[list[str]]:
    """Return the words of each line of code.

    Args:
        lines: of code; no directive.
        allowed: macros that may stand here beside those of the runtime and the standard headers.

    Raises:
        NotUnderstoodError: a word that the generator does not write.
    """
    lines = list(lines)
    found = [TOKEN.findall(line.text) for line in lines]
    whys = {word: _explain(word, allowed) for word in set[str]().union(*found)}
    if any(whys.values()):
        places = ((n, k, word) for n, w in enumerate(found) for k, word in enumerate(w))
        number, index, word = next((n, k, word) for n, k, word in places if whys[word])
        raise NotUnderstoodError(f"{lines[number].locate(index)}: '{word}': {whys[word]}")
    return found


def _explain(word: str, allowed: Collection[str]) -> str | None:
    """Return why a word is refused; None where the generator writes it."""
    first = word[0]
    if first.isdigit() or (first == "." and len(word) > 1 and word[1].isdigit()):
        return None if INTEGER.fullmatch(word) else _explain_number(word)
    if word in OPERATORS or word in WRITTEN:
        return None
    if first == '"':
        return None if LINE_OF_ASSEMBLY.fullmatch(word) else "a string that is no line of assembly"
    if first.isupper():
        if word in STANDARD or word in OF_RUNTIME or word in allowed:
            return None
        return "a macro that is not known here"
    if word in PREDEFINED:
        return "a macro of compilers that know more than C99"
    if word in NEVER:
        return "a word of C or C++ that the generator does not write"
    if WORD.fullmatch(word):
        return None
    if first == "_" or first.isalpha():
        return "a name that the generator does not make: small letters, digits and single '_' are"
    return "no operator that the generator writes"


def _explain_number(word: str) -> str:
    return (
        "no integer that the generator writes: decimal, or 0x with capitals, then u or nothing"
        if word[0] != "0" or not word.isdigit()
        else "an octal integer; the generator writes none"
    )
