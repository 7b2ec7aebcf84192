"""The C of a firmware folder as a compiler of C99 sees it: characters, lines with #, words.

Characters of C to tokens, for the proof: what the generator never writes is refused.

Refused in a model's own files, each with file, line and column: characters beyond ASCII's printed
ones, tabs and carriage returns; trigraphs, digraphs and joined lines; character constants, string
prefixes and escapes but \\n; comments to the end of a line, and comments within comments; numbers
with another suffix than u, octal ones and fractions. A compiler that reads such text may see other
tokens than these rules do. The runtime's files, whose text is known by its hash, may join lines and
hold character constants as well.

Source: C99, 5.1.1.2 (phases of translation) and 6.4.

The lines of a model's own files that begin with #: those that the generator writes, no others.

A compiler defines macros that no list is complete of, so a condition may ask for the generator's
own alone. Macros that are defined belong to the model and stand for one number or text; each is
defined once. What C++ alone sees, and what the test harness alone defines, is one fixed text.

No macro of a compiler or a processor is defined but those that are given. A model's own files may
ask for none of these; the runtime's do, and its text is known by its hash. Source:
C99, 6.10 (preprocessing).
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache

from zerodrift_proof.equality.syntax import PTokens

NAME, NUMBER, TEXT, CHARACTER, SIGN = "name", "number", "text", "character", "sign"
SIGNS = (
    *("<<=", ">>=", "->", "++", "--", "<<", ">>", "<=", ">=", "==", "!=", "&&", "||"),
    *("+=", "-=", "*=", "|=", "&=", "^="),
    *"{}[]();,.&*+-~!/%<>^|?:=#",
)
"""Punctuators that the generator and the runtime write."""
REFUSED = ("%:%:", "...", "<:", ":>", "<%", "%>", "%:", "##", "/=", "%=")
"""Punctuators of C99 that they do not; digraphs among them."""
TRIGRAPH = re.compile(r"\?\?[=/'()!<>-]")
JOINED = re.compile(r"\\[ \t\f\v\r]*\n")
"""gcc and clang join lines over spaces behind the backslash, too."""
INTEGER = re.compile(r"(?:0|[1-9][0-9]*|0x[0-9A-Fa-f]+)u?")


def _any_of(signs: Sequence[str]) -> str:
    return "|".join(re.escape(sign) for sign in sorted(signs, key=len, reverse=True))


SCANNER = re.compile(
    r"(?P<line>\n)|(?P<space> +)|(?P<joined>\\\n)|(?P<rest>//)|(?P<comment>/\*.*?\*/)|(?P<open>/\*)"
    rf"|(?P<{NAME}>[A-Za-z_][A-Za-z0-9_]*)"
    rf"|(?P<{NUMBER}>\.?[0-9](?:[eEpP][+-]|[A-Za-z0-9_.])*)"
    rf'|(?P<{TEXT}>"(?:[ !#-\[\]-~]|\\n)*")'
    rf"|(?P<{CHARACTER}>'[ -&(-\[\]-~]')"
    rf"|(?P<refused>{_any_of(REFUSED)})"
    rf"|(?P<{SIGN}>{_any_of(SIGNS)})",
    re.S,
)
QUOTE = "'"
STRANGE = {
    QUOTE: "a character constant",
    '"': "a text that does not end on its line, or with an escape other than \\n",
    "\\": "a backslash",
    "\t": "a tab",
    "\r": "a carriage return",
}


AGAIN = (
    "The generator never writes this, so that the proof has no rule for it: run `zerodrift"
    " firmware` again"
)


class RefusedError(Exception):
    """The C holds something that the generator never writes; nothing is claimed of it."""


@dataclass(frozen=True, slots=True)
class Token:
    """A token of C, and where it stands."""

    kind: str
    """name | number | text | character | sign."""
    text: str
    place: str
    """file:line:column; line and column count from 1."""
    spaced: bool = True
    """Whether white space or a comment stands before it."""


Line = tuple[Token, ...]


class Scanner:
    """Splits one file."""

    def __init__(self, text: str, file: str, known: bool) -> None:
        """Stand at the beginning of a text.

        Args:
            text: of the file, each line's end as it is stored.
            file: its name, for places.
            known: whether it is a file of the runtime.
        """
        self._text, self._file, self._known = text, file, known
        self._row, self._begin = 1, 0

    def split(self) -> Iterator[Line]:
        """Yield the lines that hold a token; of lines that are joined, the whole.

        Raises:
            RefusedError: a character or token that is never written.
        """
        self._refuse_anywhere()
        found: list[Token] = []
        at, spaced = 0, True
        while at < len(self._text):
            match = SCANNER.match(self._text, at)
            if match is None:
                raise self._error(at, self._name_strange(at))
            kind, word = str(match.lastgroup), match[0]
            if kind in (NAME, NUMBER, TEXT, CHARACTER, SIGN):
                self._check(kind, word, at)
                place = f"{self._file}:{self._row}:{at - self._begin + 1}"
                found.append(Token(kind, word, place, spaced))
                spaced = False
            else:
                spaced = True
                self._check_between(kind, word, at)
                if kind == "line" and found:
                    yield tuple(found)
                    found = []
            rows = word.count("\n") if kind in ("line", "comment", "joined") else 0
            if rows:
                self._row, self._begin = self._row + rows, at + word.rindex("\n") + 1
            at = match.end()
        if found or (self._text and self._text[-1] != "\n"):
            raise self._error(len(self._text), "the file does not end with a line")

    def _refuse_anywhere(self) -> None:
        """Refuse what is replaced before there are comments and texts."""
        for pattern, what in ((TRIGRAPH, "a trigraph"), (JOINED, "a line joined with the next")):
            for match in pattern.finditer(self._text):
                if pattern is TRIGRAPH or not self._known:
                    raise self._error(match.start(), what)
        for at, letter in enumerate(self._text) if not self._text.isascii() else ():
            if not letter.isascii():
                raise self._error(at, f"{letter!r}, a letter beyond ASCII")
        if strange := re.search(r"[^\n -~]", self._text):
            at = strange.start()
            raise self._error(at, STRANGE.get(self._text[at], "a control character"))

    def _check(self, kind: str, word: str, at: int) -> None:
        if kind == NAME and self._text[at + len(word) : at + len(word) + 1] in ("'", '"'):
            raise self._error(at, f"'{word}' before a quotation mark")
        if self._known:
            return
        if kind == CHARACTER:
            raise self._error(at, STRANGE[QUOTE])
        if kind == NUMBER and not INTEGER.fullmatch(word):
            raise self._error(at, f"'{word}' is no whole number as the generator writes it")

    def _check_between(self, kind: str, word: str, at: int) -> None:
        if kind == "rest":
            raise self._error(at, "a comment to the end of the line")
        if kind == "open":
            raise self._error(at, "a comment that does not end")
        if kind == "refused":
            raise self._error(at, f"'{word}'")
        if kind == "comment" and ("/*" in word[2:] or JOINED.search(word)):
            raise self._error(at, "a comment within a comment, or a joined line in one")

    def _name_strange(self, at: int) -> str:
        letter = self._text[at]
        return STRANGE.get(letter, f"'{letter}'")

    def _error(self, at: int, what: str) -> RefusedError:
        row = self._text.count("\n", 0, at) + 1
        column = at - (self._text.rfind("\n", 0, at) + 1) + 1
        return RefusedError(f"{self._file}:{row}:{column}: {what}. {AGAIN}")


@lru_cache(maxsize=64)
def split(text: str, file: str, known: bool) -> tuple[Line, ...]:
    """Return the lines of a file that hold a token.

    Args:
        text: of the file.
        file: its name, for places.
        known: whether it is a file of the runtime, the text of which is known by its hash.

    Raises:
        RefusedError: a character or token that is never written; with file, line and column.
    """
    return tuple(Scanner(text, file, known).split())


HEADER = (
    "# include < stdint . h >",
    "# include < stddef . h >",
    "# ifdef __cplusplus",
    "# endif",
    "# ifndef P_H",
    "# define P_H",
    r"# define P_\w+ (?:Nu?|UINT32_C \( N \)|S|\( Nu \+ sizeof \( p_state_t \) \))",
)
"""Patterns of the header's lines: N is a number, Nu one with a u, S a text, P and p the prefix."""
SOURCE = (
    "# include S",
    "# error S",
    r"# if (?:P_CODE_ID|ZD_RUNTIME_FORMAT|ZD_RUNTIME_ID) != Nx?",
    "# ifndef ZD_OBSERVE",
    r"# define ZD_OBSERVE \( values , count \)",
    r"# define ZD_QUIET \( on \)",
    r"# define ZD_CLAIM \( name , holds \) typedef char name \[ \( holds \) \? N : - N \]",
    r"# (?:if|elif) ZD_KERNEL == ZD_KERNEL_(?:PAIRS|ROWS|COLUMNS)",
    r"# (?:if|elif) ZD_ASSEMBLY (?:==|!=) N",
    r"# if ZD_GRU_ASSEMBLY == N",
    r"# if \( ZD_KERNEL == ZD_KERNEL_PAIRS \) && defined \( ZD_GRU_ASSEMBLY \)",
    r"# if (?:! )?defined \( (?:ZD_SMALL|ZD_UNALIGNED|ZD_GRU_ASSEMBLY) \)",
    "# else",
    "# endif",
)
"""The same of the source."""
CPLUSPLUS = ('extern "C" {', "}")
CLAIM = ("typedef", "char", "name", "[", "(", "holds", ")", "?", "1", ":", "-", "1", "]")
FUNCTIONS = ("ZD_OBSERVE", "ZD_QUIET", "ZD_CLAIM")
"""Macros with parameters."""


class Behind(Enum):
    """What a condition asks for, which tells what may stand between it and its #endif."""

    GUARD = "#ifndef PREFIX_H"
    CPLUSPLUS = "#ifdef __cplusplus"
    """One of two lines."""
    OBSERVE = "#ifndef ZD_OBSERVE"
    """Macros of the test harness, as they are without it."""
    NUMBER = "a number of the runtime or the header"
    """#error, and nothing else."""
    WAY = "a way to build"
    """Anything; #elif and #else too."""


@dataclass
class Group:
    """The lines between a condition and its #endif."""

    behind: Behind
    lines: int = 0
    """Without those of conditions."""
    ended: bool = False
    """Whether #else was."""


class OwnFile:
    """A file of the model: its lines of tokens."""

    def __init__(self, name: str, prefix: str, lines: tuple[Line, ...]) -> None:
        """Stand before the first line.

        Args:
            name: of the file.
            prefix: of the model.
            lines: of the file.
        """
        self._name, self._prefix, self._lines = name, prefix, lines
        self._groups: list[Group] = []
        self._open: list[str] = []
        """The word before each round bracket that is open."""
        self._before = ""
        self._defined: set[str] = set()

    def check(self) -> None:
        """Look at every line that begins with #, whether a build reads it or not.

        Raises:
            RefusedError: one that the generator never writes.
        """
        is_header = self._name.endswith(".h")
        patterns = [re.compile(text) for text in (HEADER if is_header else SOURCE)]
        if is_header:
            self._check_guard()
        for line in self._lines:
            if any(token.text == "#" for token in line[1:]):
                raise refuse(line, "a # within a line")
            if line[0].text != "#":
                self._take_code(line)
                continue
            text = self._tell(line)
            if not any(pattern.fullmatch(text) for pattern in patterns):
                raise refuse(line, f"'{_join(line)}'")
            if self._open and self._open[0] != "volatile":  # of assembly; others may be a macro's
                raise refuse(line, "a line that begins with # within brackets")
            self._follow(line, text)
        if self._groups:
            raise refuse(self._lines[-1], "the end of the file before an #endif")

    def _tell(self, line: Line) -> str:
        """Return a line with numbers, texts and the model's prefix in their general form."""
        lower, upper = f"{self._prefix}_", f"{self._prefix.upper()}_"
        words = []
        for token in line:
            word = token.text
            if token.kind == NUMBER:
                word = "N" + "u" * word.endswith("u") + "x" * word.startswith("0x")
            elif token.kind == TEXT:
                word = "S"
            elif word.startswith(upper):
                word = f"P_{word.removeprefix(upper)}"
            elif word.startswith(lower):
                word = f"p_{word.removeprefix(lower)}"
            words.append(word)
        return " ".join(words)

    def _check_guard(self) -> None:
        """The whole header stands between #ifndef PREFIX_H, #define PREFIX_H and #endif."""
        name, lines = f"{self._prefix.upper()}_H", self._lines
        found = [_join(lines[k]) for k in (0, 1, -1)] if len(lines) > 2 else []
        if found != [f"# ifndef {name}", f"# define {name}", "# endif"]:
            raise RefusedError(f"{self._name}:1:1: a header without its {name} around all. {AGAIN}")

    def _take_code(self, line: Line) -> None:
        for token in line:
            if token.text == "(":
                self._open.append(self._before)
            elif token.text == ")" and self._open:
                self._open.pop()
            self._before = token.text
        if not self._groups:
            return
        group = self._groups[-1]
        group.lines += 1
        alone = group.behind is Behind.CPLUSPLUS and _join(line) in CPLUSPLUS and group.lines == 1
        if not alone and group.behind not in (Behind.GUARD, Behind.WAY):
            raise refuse(line, f"code behind {group.behind.value}")

    def _follow(self, line: Line, text: str) -> None:
        word, group = line[1].text, self._groups[-1] if self._groups else Group(Behind.WAY)
        if word in ("if", "ifdef", "ifndef"):
            if group.behind not in (Behind.GUARD, Behind.WAY):
                raise refuse(line, f"a condition behind {group.behind.value}")
            self._groups.append(Group(self._find_kind(line, text)))
        elif not self._groups and word in ("elif", "else", "endif"):
            raise refuse(line, f"#{word} without its #if")
        elif word in ("elif", "else"):
            if group.behind is not Behind.WAY or group.ended:
                raise refuse(line, f"#{word} behind {group.behind.value}, or behind #else")
            group.ended = word == "else"
        elif word == "endif":
            if group.behind is Behind.GUARD and line is not self._lines[-1]:
                raise refuse(line, "the header's last #endif before its end")
            self._groups.pop()
        elif word == "error":
            group.lines += 1
            if group.behind is not Behind.NUMBER or group.lines > 1:
                raise refuse(line, "#error where no number is asked for")
        elif word == "define":
            self._define(line, group)
        elif group.behind is not Behind.GUARD and self._groups:
            raise refuse(line, "#include behind a condition")

    def _find_kind(self, line: Line, text: str) -> Behind:
        if text == "# ifndef P_H":
            if line is not self._lines[0]:
                raise refuse(line, "the header's guard a second time")
            return Behind.GUARD
        for kind, begin in ((Behind.CPLUSPLUS, "# ifdef __"), (Behind.OBSERVE, "# ifndef ZD_")):
            if text.startswith(begin):
                return kind
        is_number = re.match("# if (?:P_|ZD_RUNTIME_)", text)
        return Behind.NUMBER if is_number else Behind.WAY

    def _define(self, line: Line, group: Group) -> None:
        name, is_function = line[2].text, len(line) > 3 and not line[3].spaced
        if name in self._defined:
            raise refuse(line, f"{name} is defined again")
        if is_function != (name in FUNCTIONS):
            raise refuse(line, f"how {name} is defined")
        if name == "ZD_CLAIM" and tuple(token.text for token in line[8:]) != CLAIM:
            raise refuse(line, f"how {name} is defined")
        in_header = self._name.endswith(".h")
        wanted = Behind.GUARD if in_header else Behind.OBSERVE
        if name == "ZD_CLAIM":
            if self._groups:
                raise refuse(line, f"{name} is defined behind a condition")
        elif not self._groups or group.behind is not wanted:
            raise refuse(line, f"{name} is defined elsewhere than behind {wanted.value}")
        self._defined.add(name)


def _join(line: Line) -> str:
    return " ".join(token.text for token in line)


def refuse(line: Line, what: str) -> RefusedError:
    """Return the error of a line that the generator never writes."""
    return RefusedError(f"{line[0].place}: {what}. {AGAIN}")


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
