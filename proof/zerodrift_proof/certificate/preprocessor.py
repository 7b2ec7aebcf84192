"""The preprocessor's lines of a generated model: a few known ones in known places, no others.

Every way that a build can take through them is read (docs/reference/generated-c.md). No condition
is evaluated but those that the generator writes, by what the runtime makes of a build; any other
is refused with file, line and column. Shares no code with the generator and needs the standard
library only.
"""

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from zerodrift_proof.certificate.lexer import (
    NEVER,
    PREDEFINED,
    WORD,
    WRITTEN,
    ModelTokens,
    SourceLine,
    WordSpots,
    read_lines,
    read_words,
)
from zerodrift_proof.certificate.values import FaultError, NotUnderstoodError

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
