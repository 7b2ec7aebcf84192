"""The characters, lines and words of a generated model's C, and its preprocessor, by a whitelist.

The characters, lines and words of a generated model's C, by a whitelist.

What the generator never writes is refused here with file, line and column, before anything is
replaced or left out (docs/reference/generated-c.md). A compiler can therefore find no other words
in the text than those that are found here.

Every way that a build can take through them is read (docs/reference/generated-c.md). No condition
is evaluated but those that the generator writes, by what the runtime makes of a build; any other is
refused with file, line and column.
"""

import itertools
import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import overload

from zerodrift_proof.certificate.values import FaultError, NotUnderstoodError

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


SWITCHES: dict[str, tuple[int | None, ...]] = {
    "ZD_KERNEL": (0, 1, 2, 3),
    "ZD_GRU_ASSEMBLY": (None, 6, 7),
    "ZD_ASSEMBLY": (None, 6, 7),
    "ZD_SMALL": (None, 1),
    "ZD_UNALIGNED": (None, 1),
}
"""What zd_runtime.h may define for a build, and as what; None: not at all, or as 0."""
KERNELS = ("PORTABLE", "PAIRS", "ROWS", "COLUMNS")
PAIRS, ROWS, COLUMNS = range(1, len(KERNELS))
Build = Mapping[str, int]
"""What a build defines of SWITCHES."""
CONDITIONS: dict[str, Callable[[Build], bool]] = {
    "ZD_KERNEL == ZD_KERNEL_PAIRS": lambda build: build.get("ZD_KERNEL") == PAIRS,
    "ZD_KERNEL == ZD_KERNEL_ROWS": lambda build: build.get("ZD_KERNEL") == ROWS,
    "ZD_KERNEL == ZD_KERNEL_COLUMNS": lambda build: build.get("ZD_KERNEL") == COLUMNS,
    "(ZD_KERNEL == ZD_KERNEL_PAIRS) && defined(ZD_GRU_ASSEMBLY)": lambda build: (
        build.get("ZD_KERNEL") == PAIRS and "ZD_GRU_ASSEMBLY" in build
    ),
    "defined(ZD_GRU_ASSEMBLY)": lambda build: "ZD_GRU_ASSEMBLY" in build,
    "ZD_GRU_ASSEMBLY == 6": lambda build: build.get("ZD_GRU_ASSEMBLY") == 6,
    "ZD_ASSEMBLY == 6": lambda build: build.get("ZD_ASSEMBLY") == 6,
    "ZD_ASSEMBLY == 7": lambda build: build.get("ZD_ASSEMBLY") == 7,
    "ZD_ASSEMBLY != 0": lambda build: "ZD_ASSEMBLY" in build,
    "defined(ZD_SMALL)": lambda build: "ZD_SMALL" in build,
    "!defined(ZD_SMALL)": lambda build: "ZD_SMALL" not in build,
    "defined(ZD_UNALIGNED)": lambda build: "ZD_UNALIGNED" in build,
}
"""Every condition that may stand after #if or #elif in a model's source, and when it holds."""
CLAIM = "#define ZD_CLAIM(name, holds) typedef char name[(holds) ? 1 : -1]"
OBSERVE, QUIET = "#define ZD_OBSERVE(values, count)", "#define ZD_QUIET(on)"
IN_CPLUSPLUS = (("#ifdef __cplusplus", 'extern "C" {', "#endif"), ("#ifdef __cplusplus", "}"))
NUMBER = r"0|[1-9][0-9]{0,18}"
ANY32 = rf"UINT32_C\(({NUMBER})\)"
FORMS = {
    "FORMAT|CODE_ID|CHANNELS|OUTPUTS": rf"({NUMBER})",
    "FORCED": "1",
    "MODEL_HASH": '"[0-9a-f]{64}"',
    "MANIFEST": r'"manifest\.json"',
    "MODEL_ID|SAMPLE_PERIOD_US|DESIGN_ID|DESIGN_ID_2|BLOCK_FORMAT": ANY32,
    "FLAG_(?:WARMING_UP|TEMPERATURE_RANGE|RATE_RANGE|CLAMPED|DAMAGED)": ANY32,
    "FLAG_(?:INPUT_RANGE|NO_READING|TARED)": ANY32,
    "FAULT_(?:REPLAY|TABLES|BLOCK)": ANY32,
    "BLOCK_(?:CUT|FOREIGN|DESIGN|DAMAGED|OUTSIDE)": ANY32,
    "BLOCK_BYTES": rf"({NUMBER})u",
}
"""The header's macros after the model's prefix, and their form; those of outputs come in pairs."""
NO_CODE = re.compile(r"_(?:H|MODEL_HASH|MANIFEST|FORCED)$")
"""Macros that no code may name: they are no numbers."""
STANDARD_MACROS = re.compile(
    r"U?INT(?:8|16|32|64|MAX|PTR|_(?:LEAST|FAST)(?:8|16|32|64))?_(?:MIN|MAX|C|WIDTH)"
    r"|U?(?:CHAR|SHRT|LONG|LLONG)_(?:MIN|MAX|WIDTH)|S(?:CHAR|IZE)_(?:MIN|MAX|WIDTH)|CHAR_BIT"
    r"|(?:SSIZE|PTRDIFF|SIG_ATOMIC|WCHAR|WINT)_(?:MIN|MAX|WIDTH)"
)
"""Of the headers that model and runtime include; none of them becomes another number."""


@dataclass(frozen=True)
class BuildWay:
    """One way through all conditions, and the builds that take it."""

    defined: Build
    """What the first of them defines, as far as the model's conditions ask."""
    builds: tuple[Build, ...]
    """All that each of them defines."""

    @property
    def name(self) -> str:
        """What a build of this kind defines."""
        words = []
        for macro, value in self.defined.items():
            if macro == "ZD_KERNEL":
                words.append(f"ZD_KERNEL_{KERNELS[value]}")
            else:
                words.append(macro if value == 1 else f"{macro} {value}")
        return ", ".join(words)


@dataclass
class CodeStretch:
    """Words of code with no condition between them."""

    words: list[str] = field(default_factory=list)
    spots: list[int] = field(default_factory=list)


@dataclass
class CodeBranch:
    """#if to #endif: what holds, and what stands there; () without a condition is #else's."""

    arms: list[tuple[str, "list[CodeStretch | CodeBranch]"]] = field(default_factory=list)


def list_builds() -> Iterator[Build]:
    """Yield what zd_runtime.h can define, `-DZD_KERNEL=...` and `-DZD_SMALL` at will.

    ZD_ASSEMBLY follows from the others: it is ZD_GRU_ASSEMBLY's where the kernel is that of pairs.
    """
    for values in itertools.product(*SWITCHES.values()):
        build = {n: v for n, v in zip(SWITCHES, values, strict=True) if v is not None}
        follows = build.get("ZD_GRU_ASSEMBLY") if build.get("ZD_KERNEL") == PAIRS else None
        if build.get("ZD_ASSEMBLY") == follows:
            yield build


def read_ways(
    texts: Mapping[str, str], prefix: str, known: Mapping[str, int]
) -> list[tuple[BuildWay, ModelTokens]]:
    """Return every different text that the preprocessor can make of header and source.

    Args:
        texts: file name -> content.
        prefix: of the model.
        known: macros of the runtime that are numbers.

    Raises:
        NotUnderstoodError: something that the generator does not write, with file, line, column.
        FaultError: header, source and runtime do not belong together: it does not compile.
    """
    where = WordSpots()
    header = read_header(texts[f"{prefix}.h"], prefix, where)
    files = {name for name in texts if name.startswith("zd_") and name.endswith(".h")}
    source = _ModelSource(texts[f"{prefix}.c"], prefix, header, known, files)
    body = source.read()
    found: dict[tuple[int, ...], list[Build]] = {}
    for build in list_builds():
        found.setdefault(tuple(_choose(body, build)), []).append(build)
    ways = []
    for choices, builds in found.items():
        defined = {name: value for name, value in builds[0].items() if name in source.asked}
        tokens = ModelTokens(list(header.words), list(header.spots), where, header.macros)
        _take(body, iter(choices), tokens)
        ways.append((BuildWay(defined, tuple(builds)), tokens))
    return ways


def _choose(items: "list[CodeStretch | CodeBranch]", build: Build) -> Iterator[int]:
    """Yield which arm of each #if a build takes, in order; the number of arms for none."""
    for item in items:
        if isinstance(item, CodeBranch):
            arms = enumerate(item.arms)
            at = next((k for k, (c, _) in arms if not c or CONDITIONS[c](build)), len(item.arms))
            yield at
            if at < len(item.arms):
                yield from _choose(item.arms[at][1], build)


def _take(
    items: "list[CodeStretch | CodeBranch]", choices: Iterator[int], tokens: ModelTokens
) -> None:
    """Add the words of the arms that are chosen."""
    for item in items:
        if isinstance(item, CodeStretch):
            tokens.words += item.words
            tokens.spots += item.spots
        elif (at := next(choices)) < len(item.arms):
            _take(item.arms[at][1], choices, tokens)


class _LineTaker:
    """Stands before a line and takes what follows."""

    def __init__(self, text: str, name: str) -> None:
        self.lines, self.at = read_lines(text, name), 0
        self._end = SourceLine(name, text.count("\n") + 1, "")

    def look(self, ahead: int = 0) -> SourceLine:
        """Return a line and stay."""
        at = self.at + ahead
        return self.lines[at] if at < len(self.lines) else self._end

    def take(self, *expected: str) -> None:
        """Go on over lines that are known to the letter."""
        for text in expected:
            if self.look().text != text:
                found = self.look().text[:60] or "nothing more"
                raise self.look().refuse(f"'{found}' where '{text}' is written")
            self.at += 1

    def take_form(self, pattern: str, example: str) -> re.Match[str]:
        """Go on over a line of a known form, and return what it matched."""
        found = re.fullmatch(pattern, self.look().text)
        if not found:
            told = self.look().text[:60] or "nothing more"
            raise self.look().refuse(f"'{told}' where '{example}' is written")
        self.at += 1
        return found

    def take_code(self) -> list[SourceLine]:
        """Return the lines up to the next directive."""
        start = self.at
        while self.at < len(self.lines) and self.look().text[0] != "#":
            self.at += 1
        return self.lines[start : self.at]


@dataclass
class ModelHeader:
    """What a model's header gives the source."""

    words: list[str]
    spots: list[int]
    where: WordSpots
    macros: dict[str, list[str]]

    def add(
        self, lines: list[SourceLine], to: "CodeStretch | ModelHeader", further: frozenset[str]
    ) -> None:
        """Add the words of lines of code, macros replaced by what they stand for.

        Args:
            lines: of code.
            to: where the words go.
            further: macros that may stand here and are not replaced.
        """
        usable = {name for name in self.macros if not NO_CODE.search(name)}
        for line, words in zip(lines, read_words(lines, usable | further), strict=True):
            spots = self.where.add(line, len(words))
            if usable.isdisjoint(words):
                to.words += words
                to.spots += spots
                continue
            for word, spot in zip(words, spots, strict=True):
                put = self.macros.get(word, [word])
                to.words += put
                to.spots += [spot] * len(put)


def check_prefix(prefix: str) -> None:
    """Raise NotUnderstoodError unless a prefix is one that the generator makes.

    It is part of every name of the model, and so decides which names those can be.
    """
    plain = WORD.fullmatch(prefix) and prefix not in NEVER | WRITTEN | PREDEFINED
    if not plain or prefix == "zd" or prefix.startswith("zd_"):
        raise NotUnderstoodError(f"'{prefix}' is no prefix of a model's names")


def read_header(text: str, prefix: str, where: WordSpots) -> ModelHeader:
    """Return the macros and the words of a model's header.

    Args:
        text: of the header.
        prefix: of the model.
        where: is told where the words stand.

    Raises:
        NotUnderstoodError: a line that the generator does not write, or does not write there.
    """
    check_prefix(prefix)
    upper = prefix.upper()
    lines, header = _LineTaker(text, f"{prefix}.h"), ModelHeader([], [], where, {f"{upper}_H": []})
    lines.take(f"#ifndef {upper}_H", f"#define {upper}_H")
    if lines.look().text == "#include <stddef.h>":
        lines.at += 1
    lines.take("#include <stdint.h>", *IN_CPLUSPLUS[0])
    end = (*IN_CPLUSPLUS[1], "#endif", "#endif")
    while lines.look().text != end[0]:
        line = lines.look()
        if line.text.startswith("#"):
            _define(lines, header.macros, prefix)
        elif not line.text:
            break
        else:
            header.add(lines.take_code(), header, frozenset())
    lines.take(*end)
    if lines.look().text:
        raise lines.look().refuse("something after the header's last #endif")
    return header


def _define(lines: _LineTaker, macros: dict[str, list[str]], prefix: str) -> None:
    """Take a macro, or the two of an output."""
    line, own = lines.look(), f"{prefix.upper()}_"
    found = re.fullmatch(rf"#define ({own}(\w+)) (\S.*)", line.text)
    if not found:
        raise line.refuse(f"'{line.text[:60]}' where '#define {own}... VALUE' is written")
    name, short, value = found.groups()
    if name in macros:
        raise line.refuse(f"{name} is defined a second time", 9)
    if STANDARD_MACROS.fullmatch(name):
        raise line.refuse(f"{name} is a macro of a standard header", 9)
    scale = rf"#define {name}_LSB_PER_UNIT ({NUMBER})"
    if of_output := re.fullmatch(scale, lines.look(1).text):
        if not re.fullmatch(NUMBER, value):
            raise line.refuse(f"'{value[:40]}' is no index of an output", found.start(3) + 1)
        if f"{name}_LSB_PER_UNIT" in macros:
            raise lines.look(1).refuse(f"{name}_LSB_PER_UNIT is defined a second time", 9)
        macros[name], macros[f"{name}_LSB_PER_UNIT"] = [value], [of_output[1]]
        lines.at += 2
        return
    lines.at += 1
    if short == "SAVED_BYTES":
        if value != f"(16u + sizeof({prefix}_state_t))":
            raise line.refuse(f"'{value[:40]}' is no length of a saved state", found.start(3) + 1)
        macros[name] = ["(", "16u", "+", "sizeof", "(", f"{prefix}_state_t", ")", ")"]
        return
    form = next((form for names, form in FORMS.items() if re.fullmatch(names, short)), None)
    if form is None:
        raise line.refuse(f"{name} is no macro of a model's header", 9)
    told = re.fullmatch(form, value)
    number = told[1] if told and told.groups() else "0"
    if not told or int(number) >= 2**32:
        raise line.refuse(f"'{value[:40]}' is no value of {name}", found.start(3) + 1)
    as_macro = value.startswith("UINT32_C")
    macros[name] = ["UINT32_C", "(", number, ")"] if as_macro else [value]


class _ModelSource:
    """Reads a model's source."""

    def __init__(
        self, text: str, prefix: str, header: ModelHeader, known: Mapping[str, int], files: set[str]
    ) -> None:
        self._lines, self._prefix, self._header = _LineTaker(text, f"{prefix}.c"), prefix, header
        self._known, self._files = known, files
        self._claims = False
        self._further = frozenset[str]()
        self.asked: set[str] = set()
        """The switches that conditions ask for."""

    def read(self) -> "list[CodeStretch | CodeBranch]":
        """Return what stands after the files that it includes and the tests that they fit."""
        lines = self._lines
        lines.take(f'#include "{self._prefix}.h"', '#include "zd_runtime.h"')
        included = {"zd_runtime.h"}
        while lines.look().text.startswith("#include"):
            line = lines.look()
            file = lines.take_form(r'#include "(zd_\w+\.h)"', '#include "zd_....h"')[1]
            if file not in self._files or file in included:
                raise line.refuse(f"{file} is not in the certificate, or is included twice", 10)
            included.add(file)
        own = f"{self._prefix.upper()}_CODE_ID"
        given = self._header.macros.get(own, [""])[0]
        self._require(own, rf"{NUMBER}", int(given) if given else None)
        self._require("ZD_RUNTIME_FORMAT", NUMBER, self._known.get("ZD_RUNTIME_FORMAT"))
        self._require("ZD_RUNTIME_ID", "0x[0-9a-f]{8}", self._known.get("ZD_RUNTIME_ID"))
        lines.take("#ifndef ZD_OBSERVE", OBSERVE)
        if lines.look().text == QUIET:
            lines.at += 1
            self._further = frozenset({"ZD_QUIET"})
        lines.take("#endif")
        body = self._read_items(inside=False)
        if lines.look().text:
            raise lines.look().refuse(f"{lines.look().text[:60]} without #if")
        return body

    def _require(self, name: str, form: str, number: int | None) -> None:
        """#if NAME != N, #error "...", #endif: it does not compile with another number."""
        lines = self._lines
        line = lines.look()
        told = lines.take_form(rf"#if {name} != ({form})", f"#if {name} != NUMBER")[1]
        error = lines.look()
        lines.take_form(r'#error "[A-Za-z0-9_.:, ]+"', '#error "..."')
        lines.take("#endif")
        if number is None or int(told, 0) != number:
            raise FaultError(f"{line.place()}: does not compile: {error.text}")

    def _read_items(self, *, inside: bool) -> "list[CodeStretch | CodeBranch]":
        """Return what stands up to the end, or up to the #elif, #else or #endif of this branch."""
        lines, items = self._lines, list[CodeStretch | CodeBranch]()
        while text := lines.look().text:
            word = text.split(" ", 1)[0]
            if word == "#if":
                items.append(self._read_branch())
            elif word in ("#elif", "#else", "#endif"):
                return items
            elif text == CLAIM and not inside and not self._claims:
                self._claims = True
                lines.at += 1
            elif word.startswith("#"):
                raise lines.look().refuse(
                    f"'{text[:60]}': no directive that the generator writes here"
                )
            else:
                stretch = CodeStretch()
                self._header.add(lines.take_code(), stretch, self._further)
                items.append(stretch)
        return items

    def _read_branch(self) -> CodeBranch:
        lines, branch = self._lines, CodeBranch()
        begun = lines.look()
        word = "#if"
        while word != "#endif":
            line = lines.look()
            word, _, condition = line.text.partition(" ")
            if word in ("#if", "#elif"):
                if condition not in CONDITIONS:
                    column = len(word) + 2
                    raise line.refuse(f"no rule for the condition '{condition[:60]}'", column)
                self.asked |= {name for name in SWITCHES if re.search(rf"\b{name}\b", condition)}
            elif line.text not in ("#else", "#endif"):
                raise (line if line.text else begun).refuse("an #if without #endif")
            closed = bool(branch.arms) and not branch.arms[-1][0]
            if closed and word != "#endif":
                raise line.refuse(f"'{line.text[:60]}' after #else")
            lines.at += 1
            if word != "#endif":
                branch.arms.append((condition, self._read_items(inside=True)))
        return branch
