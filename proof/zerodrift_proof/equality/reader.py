"""The C of a firmware folder as a compiler of C99 sees it: words, macros replaced.

No macro of a compiler or a processor is defined but those that are given. A model's own files may
ask for none of these (`directives`); the runtime's do, and its text is known by its hash.
Source: C99, 6.10 (preprocessing). Needs the standard library only.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from zerodrift_proof.equality.directives import OwnFile, refuse
from zerodrift_proof.equality.syntax import PTokens
from zerodrift_proof.equality.tokens import (
    NAME,
    NUMBER,
    SIGN,
    TEXT,
    Line,
    RefusedError,
    Token,
    split,
)

PRECEDENCE = {"||": 1, "&&": 2, "==": 3, "!=": 3, "<": 4, ">": 4, "<=": 4, ">=": 4}
DEEPEST = 64
KEPT = frozenset({"ZD_CLAIM", "ZD_OBSERVE", "ZD_QUIET"})
"""Macros for which the parser has a rule."""
SYSTEM = ("stdint.h", "stddef.h")
"""Headers of C whose types and limits are known here."""
RUNTIME_ID = "ZD_RUNTIME_ID"
FIRST = "zd_runtime.h"
"""The file of the runtime in which its choices stand."""


@dataclass(frozen=True)
class Macro:
    """A macro and what it becomes; parameters are None for one without brackets."""

    parameters: tuple[str, ...] | None
    body: tuple[str, ...]


@dataclass
class Preprocessor:
    """Reads a file and what it includes."""

    texts: Mapping[str, str]
    prefix: str
    """Of the model."""
    macros: dict[str, Macro]
    with_runtime: bool
    """Whether the runtime's files are read where they are included."""
    found: PTokens = field(default_factory=PTokens)
    _inside: list[str] = field(default_factory=list)

    def read(self, name: str) -> None:
        """Take a file's tokens.

        Raises:
            RefusedError: something without a rule, or that does not compile.
        """
        if len(self._inside) > DEEPEST:
            raise RefusedError(f"{name}: includes itself")
        lines = split_checked(self.texts[name], name, self.prefix)
        self._inside.append(name)
        words: list[tuple[str, str]] = []
        states: list[tuple[bool, bool]] = []  # whether this arm is read, whether one was
        for line in lines:
            if line[0].text != "#":
                if all(active for active, _ in states):
                    words += [(token.text, token.place) for token in line]
                continue
            directive = line[1].text if len(line) > 1 else ""
            if directive in ("if", "ifdef", "ifndef", "elif", "else", "endif"):
                self._branch(directive, line, states)
            elif all(active for active, _ in states):
                self._expand(words)
                words = []
                self._direct(directive, line)
        if states:
            raise refuse(lines[-1], "an #if without #endif")
        self._expand(words)
        self._inside.pop()

    def _branch(self, word: str, line: Line, states: list[tuple[bool, bool]]) -> None:
        if word in ("if", "ifdef", "ifndef"):
            outside = all(active for active, _ in states)
            true = outside and self._holds(word, line)
            states.append((true, true or not outside))
            return
        if not states:
            raise refuse(line, f"#{word} without #if")
        _, taken = states.pop()
        if word != "endif":
            true = not taken and (word == "else" or self._holds("if", line))
            states.append((true, taken or true))

    def _holds(self, word: str, line: Line) -> bool:
        if word != "if":
            if len(line) != 3 or line[2].kind != NAME:
                raise refuse(line, f"#{word}")
            return (line[2].text in self.macros) == (word == "ifdef")
        return bool(PCondition(self.macros, [token.text for token in line[2:]], line).read())

    def _direct(self, word: str, line: Line) -> None:
        if word == "include":
            self._include(line)
        elif word == "define":
            self._define(line)
        elif word == "error":
            raise refuse(line, f"does not compile: {' '.join(t.text for t in line[2:])}")
        else:
            raise refuse(line, f"#{word}")

    def _include(self, line: Line) -> None:
        own = len(line) == 3 and line[2].kind == TEXT
        file = line[2].text.strip('"') if own else "".join(t.text for t in line[3:-1])
        if not own:
            if file not in SYSTEM or file in self.texts:
                raise refuse(line, f"<{file}> is none of C's headers that are known here")
        elif file not in self.texts or not (is_runtime(file) or file == f"{self.prefix}.h"):
            raise refuse(line, f"{file} is no file of the runtime or the model")
        elif self.with_runtime or not is_runtime(file):
            self.read(file)

    def _define(self, line: Line) -> None:
        name, rest = line[2].text, [token.text for token in line[3:]]
        if name in KEPT:
            return
        parameters: tuple[str, ...] | None = None
        if len(line) > 3 and line[3].text == "(" and not line[3].spaced:
            end = rest.index(")")
            parameters = tuple(t for t in rest[1:end] if t != ",")
            rest = rest[end + 1 :]
        if self._is_linker_name(name, rest):
            return
        if name in self.macros and self.macros[name] != Macro(parameters, tuple(rest)):
            raise refuse(line, f"{name} is defined again, as something else")
        self.macros[name] = Macro(parameters, tuple(rest))

    def _is_linker_name(self, name: str, body: Sequence[str]) -> bool:
        """Whether a macro of the runtime gives the linker's name of the same thing.

        It ends with the runtime's own identity; a model's files define no such macro.
        """
        identity = self.macros.get(RUNTIME_ID)
        if not name.startswith("zd_") or identity is None or len(identity.body) != 1:
            return False
        return list(body) == [f"{name}_{identity.body[0].removeprefix('0x')}"]

    def _expand(self, words: list[tuple[str, str]]) -> None:
        for word, place in self._replace(words, frozenset()):
            self.found.words.append(word)
            self.found.places.append(place)

    def _replace(
        self, words: list[tuple[str, str]], hidden: frozenset[str]
    ) -> list[tuple[str, str]]:
        out: list[tuple[str, str]] = []
        at = 0
        while at < len(words):
            word, place = words[at]
            macro = self.macros.get(word) if word not in hidden else None
            at += 1
            if macro is None:
                out.append((word, place))
                continue
            body = [(w, place) for w in macro.body]
            if macro.parameters is not None:
                if at >= len(words) or words[at][0] != "(":
                    out.append((word, place))
                    continue
                arguments, at = _split_arguments(words, at + 1, place)
                if len(arguments) != len(macro.parameters):
                    raise RefusedError(f"{place}: {word} of {len(arguments)} arguments")
                given = dict(zip(macro.parameters, arguments, strict=True))
                body = [
                    pair
                    for w, p in body
                    for pair in (self._replace(given[w], hidden) if w in given else [(w, p)])
                ]
            out += self._replace(body, hidden | {word})
        return out


def _split_arguments(
    words: list[tuple[str, str]], at: int, place: str
) -> tuple[list[list[tuple[str, str]]], int]:
    """Return the arguments of a macro, and where it ends."""
    arguments: list[list[tuple[str, str]]] = [[]]
    depth = 1
    while at < len(words):
        word = words[at][0]
        at += 1
        depth += (word in "([{") - (word in ")]}") if len(word) == 1 else 0
        if depth == 0:
            return arguments, at
        if word == "," and depth == 1:
            arguments.append([])
        else:
            arguments[-1].append(words[at - 1])
    raise RefusedError(f"{place}: a macro without its bracket")


@dataclass
class PCondition:
    """What stands behind #if."""

    macros: Mapping[str, Macro]
    words: list[str]
    line: Line

    def read(self) -> int:
        """Return its value."""
        value = self._compound(0)
        if self.words:
            raise self._error()
        return value

    def _error(self) -> RefusedError:
        return refuse(self.line, "a condition without a rule")

    def _take(self, expected: str = "") -> str:
        if not self.words or (expected and self.words[0] != expected):
            raise self._error()
        return self.words.pop(0)

    def _single(self, depth: int = 0) -> int:
        word = self._take()
        if word == "!":
            return int(not self._single())
        if word == "(":
            value = self._compound(0)
            self._take(")")
            return value
        if word == "defined":
            bracket = self.words[:1] == ["("]
            name = self._take("(") and self._take() if bracket else self._take()
            if bracket:
                self._take(")")
            return int(name in self.macros)
        if word in ("UINT32_C", "INT32_C"):
            return self._single()
        if word[0].isdigit():
            return read_integer(word)
        macro = self.macros.get(word)
        if macro is None:
            return 0  # as C takes an unknown name
        if macro.parameters is not None or depth > DEEPEST or not macro.body:
            raise self._error()
        self.words = [*macro.body, *self.words]
        return self._single(depth + 1)

    def _compound(self, floor: int) -> int:
        left = self._single()
        while self.words and PRECEDENCE.get(self.words[0], 0) > floor:
            operator = self._take()
            right = self._compound(PRECEDENCE[operator])
            left = int(
                {
                    "||": bool(left or right),
                    "&&": bool(left and right),
                    "==": left == right,
                    "!=": left != right,
                    "<": left < right,
                    ">": left > right,
                    "<=": left <= right,
                    ">=": left >= right,
                }[operator]
            )
        return left


@lru_cache(maxsize=64)
def split_checked(text: str, file: str, prefix: str) -> tuple[Line, ...]:
    """Return the lines of a file; of a model's own one, each that begins with # is one of those
    that the generator writes.

    Raises:
        RefusedError: something that it never writes.
    """
    lines = split(text, file, is_runtime(file))
    if not is_runtime(file):
        OwnFile(file, prefix, lines).check()
    return lines


def is_runtime(name: str) -> bool:
    """Return whether a file is one of the runtime, the text of which is known by its hash."""
    return name.startswith("zd_")


def read_integer(word: str) -> int:
    """Return the number of a literal that ends with u or with nothing.

    Raises:
        RefusedError: it is written otherwise.
    """
    if not re.fullmatch(r"(?:0|[1-9][0-9]*|0x[0-9A-Fa-f]+)u?", word):
        raise RefusedError(f"'{word}' is no whole number as generator and runtime write it")
    return int(word.removesuffix("u"), 0)


def preprocess(
    texts: Mapping[str, str], prefix: str, defined: Mapping[str, str], with_runtime: bool = True
) -> PTokens:
    """Return the tokens of a model's source and all that it includes.

    Args:
        texts: file name -> content, of the model's files and the runtime's.
        prefix: of the model.
        defined: what the build defines.
        with_runtime: whether the runtime's files are read too; else its structs alone are.

    Raises:
        RefusedError: something without a rule, or that does not compile.
    """
    given = {**defined, "NULL": "0"}
    macros = {name: Macro(None, tuple(_list_words(body))) for name, body in given.items()}
    reader = Preprocessor(texts, prefix, macros, with_runtime)
    for token in [] if with_runtime else list_structs(texts):
        reader.found.words.append(token.text)
        reader.found.places.append(token.place)
    reader.read(f"{prefix}.c")
    reader.found.macros = {
        name: list(macro.body) for name, macro in macros.items() if macro.parameters is None
    }
    return reader.found


class _Chooser(Preprocessor):
    """Finds which lines are read, and replaces no macro."""

    def _expand(self, words: list[tuple[str, str]]) -> None:
        self.found.places += [place for _, place in words]


def choose_lines(
    texts: Mapping[str, str], prefix: str, defined: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the places of the words of a model's own files that a build reads."""
    macros = {name: Macro(None, (body,)) for name, body in defined.items()}
    reader = _Chooser(texts, prefix, macros, with_runtime=False)
    reader.read(f"{prefix}.c")
    return tuple(reader.found.places)


def _list_words(text: str) -> Iterable[str]:
    return [token.text for line in split(f"{text}\n", "the build", True) for token in line]


def list_asked(text: str, file: str) -> set[str]:
    """Return the names that the conditions of a file ask for."""
    return {
        token.text
        for line in split(text, file, is_runtime(file))
        if line[0].text == "#" and line[1].text in ("if", "elif", "ifdef", "ifndef")
        for token in line[2:]
        if token.kind == NAME
    }


def read_numbers(texts: Mapping[str, str], names: Iterable[str]) -> dict[str, str]:
    """Return macros that zd_runtime.h defines as one number, once and behind no choice.

    Raises:
        RefusedError: one that it does not define so.
    """
    found: dict[str, list[str]] = {name: [] for name in names}
    for line in split(texts[FIRST], FIRST, True):
        if _is_definition(line) and line[2].text in found:
            found[line[2].text] += [token.text for token in line[3:]]
    for name, words in found.items():
        if len(words) != 1:
            raise RefusedError(f"{FIRST}: {name} is not one number")
    return {name: words[0] for name, words in found.items()}


def _is_definition(line: Line) -> bool:
    words = [token.text for token in line[:2]]
    return words == ["#", "define"] and len(line) > 3 and line[3].kind in (NUMBER, SIGN)


def list_structs(texts: Mapping[str, str]) -> list[Token]:
    """Return the tokens of the structs that the runtime defines."""
    found: list[Token] = []
    for name in sorted(filter(is_runtime, texts)):
        tokens = [t for line in split(texts[name], name, True) if line[0].text != "#" for t in line]
        for at, token in enumerate(tokens):
            if token.text == "typedef" and tokens[at + 1].text == "struct":
                end = next(k for k in range(at, len(tokens)) if tokens[k].text == "}")
                found += tokens[at : end + 3]
    return found
