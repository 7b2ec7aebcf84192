"""The C of a firmware folder, runtime included, as a plain C99 compiler sees it: tokens.

No macro of a compiler or a processor is defined but those that are given: what is read is the text
for a target without extensions. Needs the standard library only.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from zerodrift.verify.c_reader import COMMENT, TOKEN, Tokens, parse_integer
from zerodrift.verify.c_values import FaultError, NotUnderstoodError

KEPT = frozenset({"ZD_CLAIM"})
"""Macros with parameters for which the parser has a rule."""
PRECEDENCE = {"||": 1, "&&": 2, "==": 3, "!=": 3, "<": 4, ">": 4, "<=": 4, ">=": 4}
DEEPEST = 64


@dataclass(frozen=True)
class Macro:
    """A macro and what it becomes; parameters are None for one without brackets."""

    parameters: tuple[str, ...] | None
    body: tuple[str, ...]


@dataclass
class Preprocessor:
    """Reads a file and what it includes."""

    texts: Mapping[str, str]
    macros: dict[str, Macro]
    found: Tokens = field(default_factory=Tokens)
    _inside: list[str] = field(default_factory=list)

    def read(self, name: str) -> None:
        """Take a file's tokens.

        Raises:
            NotUnderstoodError: a directive without a rule.
            FaultError: it does not compile.
        """
        if len(self._inside) > DEEPEST:
            raise NotUnderstoodError(f"{name}: includes itself")
        self._inside.append(name)
        words: list[tuple[str, str]] = []
        states: list[tuple[bool, bool]] = []  # whether this arm is read, whether one was
        for place, tokens in split(self.texts[name], name):
            if tokens[0] != "#":
                if all(active for active, _ in states):
                    words += [(token, place) for token in tokens]
                continue
            directive = tokens[1] if len(tokens) > 1 else ""
            if directive in ("if", "ifdef", "ifndef", "elif", "else", "endif"):
                self._branch(directive, tokens[2:], states, place)
            elif all(active for active, _ in states):
                self._expand(words)
                words = []
                self._direct(directive, tokens[2:], place)
        if states:
            raise NotUnderstoodError(f"{name}: an #if without #endif")
        self._expand(words)
        self._inside.pop()

    def _branch(
        self, word: str, tokens: Sequence[str], states: list[tuple[bool, bool]], place: str
    ) -> None:
        if word in ("if", "ifdef", "ifndef"):
            outside = all(active for active, _ in states)
            true = outside and self._holds(word, tokens, place)
            states.append((true, true or not outside))
            return
        if not states:
            raise NotUnderstoodError(f"{place}: #{word} without #if")
        _, taken = states.pop()
        if word != "endif":
            true = not taken and (word == "else" or self._holds("if", tokens, place))
            states.append((true, taken or true))

    def _holds(self, word: str, tokens: Sequence[str], place: str) -> bool:
        if word != "if":
            if len(tokens) != 1:
                raise NotUnderstoodError(f"{place}: #{word}")
            return (tokens[0] in self.macros) == (word == "ifdef")
        return bool(CCondition(self.macros, list(tokens), place).read())

    def _direct(self, word: str, tokens: Sequence[str], place: str) -> None:
        if word == "include":
            file = "".join(tokens).strip('"<>')
            if file in self.texts:
                self.read(file)
            elif file not in ("stdint.h", "stddef.h"):
                raise NotUnderstoodError(f"{place}: {file} is no file of the folder")
        elif word == "define":
            self._define(tokens, place)
        elif word == "error":
            raise FaultError(f"{place}: does not compile: {' '.join(tokens)}")
        else:
            raise NotUnderstoodError(f"{place}: #{word}")

    def _define(self, tokens: Sequence[str], place: str) -> None:
        name, rest = tokens[0], list(tokens[1:])
        if name in KEPT:
            return
        bracketed = re.search(rf"\b{name}\(", self._line(place)) is not None
        parameters: tuple[str, ...] | None = None
        if bracketed:
            end = rest.index(")")
            parameters = tuple(t for t in rest[1:end] if t != ",")
            rest = rest[end + 1 :]
        if len(rest) == 1 and re.fullmatch(rf"{name}_[0-9a-f]{{8}}", rest[0]):
            return  # the linker's name of the same thing
        macro = Macro(parameters, tuple(rest))
        if self.macros.setdefault(name, macro) != macro:
            raise FaultError(f"{place}: {name} is defined twice")

    def _line(self, place: str) -> str:
        name, _, number = place.rpartition(":")
        return self.texts[name].split("\n")[int(number) - 1]

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
                    raise FaultError(f"{place}: {word} of {len(arguments)} arguments")
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
    raise NotUnderstoodError(f"{place}: a macro without its bracket")


@dataclass
class CCondition:
    """What stands behind #if."""

    macros: Mapping[str, Macro]
    words: list[str]
    place: str

    def read(self) -> int:
        """Return its value."""
        value = self._compound(0)
        if self.words:
            raise self._error()
        return value

    def _error(self) -> NotUnderstoodError:
        return NotUnderstoodError(f"{self.place}: a condition of the preprocessor")

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
            return parse_integer(word)[0]
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


def split(text: str, name: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the lines that hold anything, as place and tokens; continued ones as one."""
    if "??" in text or not text.isascii():
        raise NotUnderstoodError(f"{name}: a trigraph or a letter beyond ASCII")

    def blank(match: re.Match[str]) -> str:
        return match[0] if match[0][0] == '"' else " " + "\n" * match[0].count("\n")

    begun: list[str] = []
    for number, line in enumerate(COMMENT.sub(blank, text).split("\n"), 1):
        begun += TOKEN.findall(line)
        if begun and begun[-1] == "\\":
            begun.pop()
            continue
        if begun:
            yield f"{name}:{number}", begun
            begun = []


def preprocess(texts: Mapping[str, str], start: str, defined: Mapping[str, str]) -> Tokens:
    """Return the tokens of a file and all that it includes.

    Args:
        texts: file name -> content.
        start: the file to begin with.
        defined: what the build defines.

    Raises:
        NotUnderstoodError: something without a rule.
        FaultError: it does not compile.
    """
    given = {**defined, "NULL": "0"}
    macros = {n: Macro(None, tuple(TOKEN.findall(body))) for n, body in given.items()}
    reader = Preprocessor(texts, macros)
    reader.read(start)
    reader.found.macros = {
        name: list(macro.body) for name, macro in macros.items() if macro.parameters is None
    }
    return reader.found
